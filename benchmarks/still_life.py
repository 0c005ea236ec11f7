"""One object behind another: accuracy of what is seen and of what is hidden, with visibility and without.

`python -m benchmarks.still_life [--quick] [--tuning] [--out FILE.md]` prints medians and worst values over pictures of
scenes/still_life.py that nobody tuned on. Of the hidden object: contour error where it is seen [px], IoU of the whole
silhouette and of its hidden part, 3D error [% of length]; of the front one IoU and 3D error, and those of a run alone.
Last, how often the depth order is found from the image.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from symseek.device import start_quietly
from symseek.render.visibility import DepthPass
from symseek.scenes import still_life
from symseek.scenes.still_life import StillLife
from symseek.sim.order import in_order
from symseek.sim.problem import Settings, Tube, View
from symseek.sim.reconstruct import ObjectResult, reconstruct

from . import truth
from .tables import as_text

SEEDS = range(31031, 31053)
TUNING = range(0, 22)
NEAR = 3.0
"""Outline this near to where the front object covers the back one is none of its own [px]."""


@dataclass(frozen=True)
class Score:
    """One picture by one way."""

    name: str
    hidden: float
    contour: float
    whole: float
    covered: float
    surface: float
    front: float
    front_surface: float
    front_contour: float
    trusted: bool


def solve(life: StillLife, visibility: str, depth_pass: DepthPass | None = None) -> list[ObjectResult]:
    """Front and back object, the order given."""
    tubes = [Tube(life.front.clicks, name="front"), Tube(life.back.clicks, name="back", depth=life.depth)]
    return reconstruct([View(life.image)], tubes, Settings(visibility=visibility), depth_pass=depth_pass).objects


def score(life: StillLife, found: Sequence[ObjectResult]) -> Score:
    """Errors of front and back object."""
    front, back = found
    errors, own = truth.compare(back.vertices, back.faces, life.back), truth.compare(front.vertices, front.faces, life.front)
    silhouette = truth.silhouette(back.vertices, back.faces, life.back.camera, life.back.coverage.shape)
    # the hidden part: of the true silhouette and of the one found, what lies below the front object
    below = life.front.coverage > 0.5
    covered = truth.overlap(silhouette * below, life.back.coverage * below)
    name = f"{life.back.seed} {life.back.kind} behind {life.front.kind}"
    return Score(
        name, life.hidden, seen_contour_error(silhouette, life), errors.iou, covered, errors.surface, own.iou, own.surface,
        own.contour, back.trusted,
    )  # fmt: skip


def seen_contour_error(silhouette: np.ndarray, life: StillLife) -> float:
    """Mean distance of the true outline of the back object, where it is seen, from the outline found [px]."""
    true, ours = truth.outline_segments(life.back.coverage).mean(1), truth.outline_segments(silhouette)
    column, row = np.rint(true).astype(int).T
    seen = ndimage.distance_transform_edt(life.front.coverage < 0.5)[row, column] > NEAR  # pyright: ignore
    return float(truth.to_segments(true[seen], ours).mean()) if len(ours) else np.inf


def beside_alone(lives: Sequence[StillLife], scores: Sequence[Score]) -> list[list[str]]:
    """Medians of the front object's errors, of those of its tube alone, and of their ratios.

    A row for that picture, and one for the same without the other object.
    """
    rows = []
    for name, what in (("image", "its tube alone"), ("lone", "the other object taken away")):
        alone = []
        for life in lives:
            (o,) = reconstruct([View(getattr(life, name))], [Tube(life.front.clicks)]).objects
            alone.append(truth.compare(o.vertices, o.faces, life.front))
        pairs = [
            ([s.front_contour for s in scores], [e.contour for e in alone]),
            ([s.front_surface for s in scores], [e.surface for e in alone]),
        ]
        rows.append([what, *(f"{np.median(v):.3f}" for with_, own in pairs for v in (with_, own, np.divide(with_, own)))])
    return rows


def order(lives: Sequence[StillLife]) -> list[str]:
    """How often `depth = "auto"` finds the order, does not know it, or is wrong without knowing."""
    told = []
    for life in lives:
        tubes = [Tube(o.clicks, name=n, find_depth=True) for n, o in (("front", life.front), ("back", life.back))]
        (front, back), (found, _) = in_order(View(life.image), tubes)
        assert found is not None
        told.append("unknown" if found.unsure else "right" if front.depth < back.depth else "wrong")
    return [str(len(lives)), *(str(told.count(word)) for word in ("right", "unknown", "wrong"))]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.still_life", description="One object behind another.")
    parser.add_argument("--quick", action="store_true", help="half the pictures")
    parser.add_argument("--tuning", action="store_true", help="other seeds, to tune with")
    parser.add_argument("--out", type=Path, help="file for the tables (.md)")
    given = parser.parse_args(arguments)
    start_quietly()
    text, orders = [], [["", "n", "right", "does not know", "wrong"]]
    fronts = [["front object, medians", "beside", "contour, px", "alone", "ratio", "3D, %", "alone", "ratio"]]
    lots = {
        "A pear behind a potato": {"kinds": ("egg", "pear")},
        "Any solid behind any that is roundish": {},
    }
    for title, look in lots.items():
        tables: dict[str, list[Score]] = {"with visibility": [], "off": []}
        seeds = (TUNING if given.tuning else SEEDS)[: 11 if given.quick else None]
        lives = [still_life.make(seed, **look) for seed in seeds]
        orders.append([title, *order(lives)])
        print("  ".join(orders[-1]), file=sys.stderr, flush=True)
        for life in lives:
            with DepthPass() as depth_pass:
                for way, visibility in zip(tables, ("depth", "off"), strict=True):
                    tables[way].append(score(life, solve(life, visibility, depth_pass)))
                    print(_line(tables[way][-1], way), file=sys.stderr, flush=True)
        rows = [["", "seen contour, px", "IoU, whole", "hidden part", "3D, %", "front IoU", "front 3D, %", "trusted"]]
        for way, scores in tables.items():
            for what, pick in (("median", np.median), ("worst", None)):
                values = [
                    float((pick or worst)([getattr(s, name) for s in scores]))
                    for name, worst in (
                        ("contour", np.max), ("whole", np.min), ("covered", np.min), ("surface", np.max),
                        ("front", np.min), ("front_surface", np.max),
                    )
                ]  # fmt: skip
                trusted = f"{sum(s.trusted for s in scores)} of {len(scores)}" if pick else ""
                rows.append([f"{way}, {what}", *(f"{v:.3f}" for v in values), trusted])
        text.append((title, rows))
        fronts += [[title, *row] for row in beside_alone(lives, tables["with visibility"])]
    text.append(("The front object beside what it reaches alone", fronts))
    text.append(("Depth order, where it is left to be found", orders))
    for markdown in (False, True):
        report = "\n\n".join(f"{'### ' * markdown}{title}\n\n{as_text(rows, markdown)}" for title, rows in text)
        if markdown and given.out is not None:
            given.out.write_text(report + "\n")
        elif not markdown:
            print(report, flush=True)
    return 0


def _line(s: Score, way: str) -> str:
    values = (s.hidden, s.contour, s.whole, s.covered, s.surface, s.front, s.front_surface)
    return f"{s.name}, {way}: " + "  ".join(f"{v:.3f}" for v in values) + ("" if s.trusted else "  not trusted")


if __name__ == "__main__":
    sys.exit(main())
