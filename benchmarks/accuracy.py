"""Accuracy of symseek beside its peers on shapes that nobody tuned on.

`python -m benchmarks.accuracy [--quick] [--tuning] [--methods NAME,...] [--out FILE.md|FILE.json]` prints
tables: medians and worst values, CPU seconds, failures (IoU below 0.9 or no answer), how many of them are
silent, and alarms without need. The seeds are fixed; `--tuning` takes others, to tune with.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from symseek.scenes.synthetic import KINDS, Sample, make
from symseek.sim.problem import Tube, View
from symseek.sim.reconstruct import reconstruct

from . import truth
from .peers import contour_peer, generalised_cylinder, inflation

FAILED = 0.9
"""Silhouettes that overlap less than this are failures."""


@dataclass(frozen=True)
class Seeds:
    """Which shapes: as many of each kind."""

    main: range
    varied: range
    mixed: range


UNSEEN = Seeds(range(21021, 21054), range(22022, 22033), range(23023, 23056))
TUNING = Seeds(range(0, 33), range(33, 44), range(44, 77))


@dataclass(frozen=True)
class Answer:
    """What a method says of one image: a mesh, an outline, or neither."""

    mesh: tuple[np.ndarray, np.ndarray] | None = None
    outline: np.ndarray | None = None
    trusted: bool = True


@dataclass(frozen=True)
class Case:
    """One image to be made."""

    seed: int
    look: dict[str, Any] = field(default_factory=dict)
    drawn: float = 1.0
    """Share of their distances from their middle to which the clicks are drawn together."""

    def sample(self) -> Sample:
        sample = make(self.seed, **self.look)
        middle = sample.clicks.mean(axis=0)
        return replace(sample, clicks=middle + self.drawn * (sample.clicks - middle))


@dataclass(frozen=True)
class Score:
    """One method on one case."""

    method: str
    case: Case
    kind: str
    errors: truth.Errors | None
    trusted: bool
    seconds: float

    @property
    def failed(self) -> bool:
        return self.errors is None or not self.errors.iou >= FAILED


def ours(sample: Sample) -> Answer:
    found = reconstruct([View(sample.image)], [Tube(sample.clicks)]).objects[0]
    return Answer(mesh=(found.vertices, found.faces), trusted=found.trusted)


def _solid(method: Callable) -> Callable[[Sample], Answer]:
    def run(sample: Sample) -> Answer:
        mesh = method(sample.image, sample.clicks)
        return Answer(mesh=mesh, trusted=mesh is not None)

    return run


def _line(method: Callable) -> Callable[[Sample], Answer]:
    return lambda sample: Answer(outline=method(sample.image, sample.clicks))


METHODS: dict[str, Callable[[Sample], Answer]] = {
    "symseek": ours,
    "generalised cylinder": _solid(generalised_cylinder.reconstruct),
    "inflation: Poisson": _solid(inflation.poisson),
    "inflation: balls": _solid(inflation.balls),
    "active contour": _line(contour_peer.plain),
    "helped active contour": _line(contour_peer.helped),
    "circles on the true axis": lambda sample: Answer(mesh=truth.circular_sections(sample)),
}
SOLIDS = ("symseek", "generalised cylinder", "inflation: Poisson", "inflation: balls")
STRONG = ("symseek", "generalised cylinder")
ORACLE = "circles on the true axis"


@dataclass(frozen=True)
class Lot:
    """Cases that share a heading, and who is tried on them."""

    title: str
    cases: Sequence[Case]
    methods: Sequence[str]


def lots(seeds: Seeds, quick: bool) -> list[Lot]:
    """Everything that is run."""
    some = 11 if quick else 33
    varied = seeds.varied[: 4 if quick else 11]
    outlines = ("helped active contour",) if quick else ("active contour", "helped active contour")
    out = [Lot("all kinds, 512 px, noise 0.01", [Case(s) for s in seeds.main[:some]], SOLIDS + outlines)]
    for title, look in {
        "noise 0.05": {"noise": 0.05},
        "dark on bright": {"contrast": "dark"},
        "ambient light 0.35": {"ambient": 0.35},
        "256 px": {"size": 256},
        "1024 px": {"size": 1024},
        "clicks off by 10 px": {"click_error": 10.0},
    }.items():
        out.append(Lot(title, [Case(s, look) for s in varied], STRONG))
    out.append(Lot("clicks drawn together to half", [Case(s, drawn=0.5) for s in varied], STRONG))
    level = [s for s in varied if KINDS[s % len(KINDS)] != "tilted"]
    for amount in (0.03, 0.05):
        cases = [Case(s, {"out_of_round": amount}) for s in level]
        out.append(Lot(f"sections {100 * amount:.0f} % out of round", cases, (*STRONG, ORACLE)))
    out.append(Lot("mixed lot", [_mixed(s) for s in seeds.mixed[:some]], SOLIDS))
    return out


def _mixed(seed: int) -> Case:
    """A solid out of round, one in four also tilted, under a light and noise by chance."""
    rng = np.random.default_rng(seed)
    tilt = rng.uniform(4, 12) if rng.random() < 0.25 else None
    return Case(
        seed,
        {
            "out_of_round": rng.uniform(0, 0.05),
            "tilt": tilt,
            "noise": rng.uniform(0.005, 0.05),
            "ambient": rng.uniform(0.35, 0.7),
            "contrast": str(rng.choice(["bright", "dark"])),
            "click_error": rng.uniform(2, 8),
        },
    )


def parts(title: str, scores: list[Score]) -> list[tuple[str, list[Score]]]:
    """A lot's scores, and for the main lot those of some kinds once more."""
    out = [(title, scores)]
    if title.startswith("all kinds"):
        out.append(("of these exact sweeps in the image plane", [s for s in scores if s.kind != "tilted"]))
        ends = ("bottle", "vase", "banana", "carrot")
        out.append(("of these flat ends, rims and pointed tips", [s for s in scores if s.kind in ends]))
    return out


def score(method: str, case: Case, sample: Sample) -> Score:
    """Run one method on one sample and compare it with the truth."""
    start = time.process_time()
    answer = METHODS[method](sample)
    seconds = time.process_time() - start
    errors = None
    if answer.mesh is not None:
        errors = truth.compare(*answer.mesh, sample)
    elif answer.outline is not None:
        errors = truth.compare_outline(answer.outline, sample)
    return Score(method, case, sample.kind, errors, answer.trusted, seconds)


COLUMNS = (
    "method",
    "n",
    "IoU median",
    "worst",
    "contour px",
    "worst",
    "3D %",
    "worst",
    "volume %",
    "worst",
    "CPU s",
    "failed",
    "silently",
    "needless alarms",
)


def table(scores: list[Score]) -> list[list[str]]:
    """One line a method, under COLUMNS; medians and worst values are over the answers that were given."""
    lines = []
    for method in dict.fromkeys(s.method for s in scores):
        own = [s for s in scores if s.method == method]
        given = [s.errors for s in own if s.errors is not None]
        cells = [method, str(len(own))]
        cells += _median_and_worst([e.iou for e in given], 4, min)
        cells += _median_and_worst([e.contour for e in given], 2, max)
        cells += _median_and_worst([e.surface for e in given], 3, max)
        cells += _median_and_worst([abs(e.volume) for e in given], 2, max)
        cells.append(f"{np.median([s.seconds for s in own]):.2f}")
        cells.append(str(sum(s.failed for s in own)))
        cells.append(str(sum(s.failed and s.trusted for s in own)))
        cells.append(str(sum(not s.failed and not s.trusted for s in own)))
        lines.append(cells)
    return lines


def _median_and_worst(values: list[float], digits: int, worst: Callable) -> list[str]:
    if not values or np.isnan(values).all():
        return ["-", "-"]
    return [f"{pick(values):.{digits}f}" for pick in (np.median, worst)]


def ratio_to_oracle(scores: list[Score]) -> list[str]:
    """How the 3D error of each method compares with the best circles on the true axis, shape by shape."""
    best = {s.case.seed: s.errors.surface for s in scores if s.method == ORACLE and s.errors}
    out = []
    for method in dict.fromkeys(s.method for s in scores if s.method != ORACLE and best):
        ratios = [s.errors.surface / best[s.case.seed] for s in scores if s.method == method and s.errors]
        if ratios:
            out.append(
                f"{method}: 3D error over that of the circles on the true axis: "
                f"median {np.median(ratios):.2f}, worst {max(ratios):.2f}"
            )
    return out


def as_text(lines: list[list[str]], markdown: bool) -> str:
    rows = [list(COLUMNS), *lines]
    widths = [max(len(row[k]) for row in rows) for k in range(len(COLUMNS))]
    text = []
    for first, *others in rows:
        text.append([first.ljust(widths[0]), *(c.rjust(w) for c, w in zip(others, widths[1:], strict=True))])
    if not markdown:
        return "\n".join("  ".join(row) for row in text)
    text.insert(1, ["-" * widths[0], *("-" * max(w - 1, 1) + ":" for w in widths[1:])])
    return "\n".join("| " + " | ".join(row) + " |" for row in text)


def report(results: list[tuple[str, list[Score]]], markdown: bool) -> str:
    """All tables; failures are named below theirs."""
    pieces = []
    for title, lot in results:
        for heading, scores in parts(title, lot):
            pieces.append(("### " if markdown else "") + heading + "\n")
            pieces.append(as_text(table(scores), markdown) + "\n")
        notes = ratio_to_oracle(lot)
        for s in lot:
            if s.failed:
                notes.append(f"{s.method} fails on {s.kind} {s.case.seed}{' silently' if s.trusted else ''}")
        pieces += [f"{'- ' if markdown else '  '}{note}" for note in notes] + [""]
    return "\n".join(pieces)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.accuracy", description="Accuracy beside the peers.")
    parser.add_argument("--quick", action="store_true", help="a third of the shapes, no slow peer")
    parser.add_argument("--tuning", action="store_true", help="other seeds, to tune with")
    parser.add_argument("--methods", help="only these, with commas between: " + ", ".join(METHODS))
    parser.add_argument("--out", type=Path, help="file for the tables (.md) or every score (.json)")
    chosen = parser.parse_args(arguments)
    names = [name.strip() for name in chosen.methods.split(",")] if chosen.methods else list(METHODS)
    if unknown := [name for name in names if name not in METHODS]:
        parser.error(f"unknown methods: {', '.join(unknown)}")
    if "symseek" in names:
        ours(make(0))  # compiles the kernels
    results = []
    for lot in lots(TUNING if chosen.tuning else UNSEEN, chosen.quick):
        results.append((lot.title, _run(lot, [m for m in lot.methods if m in names])))
        print(report(results[-1:], markdown=False), flush=True)
    if chosen.out is not None:
        _write(chosen.out, results)
    return 0


def _run(lot: Lot, methods: list[str]) -> list[Score]:
    scores = []
    for k, case in enumerate(lot.cases):
        if sys.stderr.isatty():
            print(f"\r{lot.title}: {k + 1} of {len(lot.cases)}\x1b[K", end="\r", file=sys.stderr, flush=True)
        sample = case.sample()
        scores += [score(m, case, sample) for m in methods]
    return scores


def _write(path: Path, results: list[tuple[str, list[Score]]]) -> None:
    if path.suffix == ".json":
        scores = {title: [dataclasses.asdict(s) for s in lot] for title, lot in results}
        path.write_text(json.dumps(scores, indent=1))
    else:
        path.write_text(report(results, markdown=True))


if __name__ == "__main__":
    sys.exit(main())
