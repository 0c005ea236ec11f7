"""The finger followed through its frames: silhouettes, surface, depth and velocity against the truth, frames a second.

`python -m benchmarks.motion [--quick] [--out FILE.md]`
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from symseek.scenes.finger import Finger, Frame
from symseek.sim.problem import Tube, View
from symseek.sim.result import ObjectResult
from symseek.sim.surface import refine
from symseek.sim.track import Tracking, track

from . import tables, truth

SEQUENCES: dict[str, dict] = {
    "round finger": {"cut": False, "out_of_round": 0.0},
    "round, base cut by the border": {"out_of_round": 0.0},
    "3 % out of round": {"cut": False},
    "3 %, base cut": {},
    "3 %, perspective, base cut": {"perspective": True},
    "3 %, twice as fast": {"cut": False, "speed": 2.0},
    "3 %, twice as fast, base cut": {"speed": 2.0},
    "3 %, along the line between the eyes": {"cut": False, "along": True},
}
SEEDS = (21, 22, 23)
"""Of the fingers; the constants were chosen on others, 0 and 11."""
MARGIN = 3.0
"""What lies nearer to the image's border, or beyond it, does not count [px]."""


@dataclass(frozen=True)
class Score:
    """Of one sequence; lengths in % of the finger's."""

    iou: float
    """least over frames and views."""
    surface: float
    """largest over frames, of mean distances between surfaces."""
    depth: float
    """largest over frames, of mean depth errors of the spine."""
    velocity: float
    """root mean square of its error over that of its size [%]."""
    normal: float
    """the same of its part across the surface."""
    lost: int
    """frames."""
    rate: float
    """frames a second: maps, potentials and solver."""
    solver: float
    """frames a second of the solver alone."""


def score(finger: Finger, frames: Sequence[Frame], o: ObjectResult, seconds: dict[str, float]) -> Score:
    """Errors of a followed finger."""
    ious, surfaces, depths = [], [], []
    total, wrong, across = 0.0, 0.0, 0.0

    def counts(points: np.ndarray) -> np.ndarray:
        sides = [c.project(points) for c in finger.cameras]
        return np.all([((p > MARGIN) & (p < [640 - MARGIN, 480 - MARGIN])).all(axis=1) for p in sides], axis=0)

    for i, (frame, tube, spine) in enumerate(zip(frames, o.tube, o.spine, strict=True)):
        mesh, true = refine(tube), (frame.vertices, finger.faces)
        pairs = zip(finger.cameras, frame.coverages, strict=True)
        ious.append(min(truth.silhouette_iou(*mesh, camera, cover) for camera, cover in pairs))
        mine, theirs = (truth.spread_over(v[f].astype(float), 4000) for v, f in (mesh, true))
        mine, theirs = mine[counts(mine)], theirs[counts(theirs)]
        surfaces.append(50 * (truth.to_surface(mine, true).mean() + truth.to_surface(theirs, mesh).mean()) / finger.length)
        seen = spine[counts(spine)]
        near = KDTree(frame.spine[:, :2]).query(seen[:, :2])[1]
        depths.append(100 * np.abs(seen[:, 2] - frame.spine[near, 2]).mean() / finger.length)
        points = tube.reshape(-1, 3)
        inside = counts(points)
        own = frame.velocity[KDTree(frame.vertices).query(points)[1]]
        error = (o.velocity[i].reshape(-1, 3) - own)[inside]
        normal = np.cross(np.roll(tube, -1, axis=0) - np.roll(tube, 1, axis=0), np.gradient(tube, axis=1)).reshape(-1, 3)
        normal = (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))[inside]
        total += (own[inside] ** 2).sum()
        wrong += (error**2).sum()
        across += ((error * normal).sum(axis=1) ** 2).sum()
    lost = sum(note.startswith("lost") for note in o.notes)
    followed = len(frames) - 1
    return Score(
        min(ious), max(surfaces), max(depths), 100 * float(np.sqrt(wrong / total)), 100 * float(np.sqrt(across / total)),
        lost, followed / seconds["frames"], followed / seconds["solve"],
    )  # fmt: skip


def follow(
    finger: Finger, frames: Sequence[Frame], tracking: Tracking | None = None
) -> tuple[ObjectResult, dict[str, float]]:
    """A finger followed with defaults, its frames handed over one at a time; and the seconds that took."""

    def stream() -> Iterator[list[np.ndarray]]:
        for frame in frames:
            yield frame.images

    names = ("left", "right")
    views = [View(image, c, n) for image, c, n in zip(frames[0].images, finger.cameras, names, strict=True)]
    tube = Tube(finger.rough, "finger")
    found = track(stream(), views, [tube], tracking=tracking or Tracking(fps=finger.fps))
    return found.objects[0], found.seconds


def measured(quick: bool) -> Callable[[bool], str]:
    """Follows all fingers; returns what writes the tables."""
    on = tables.machine()
    head = ["", "IoU", "3D %", "depth %", "velocity %", "normal %", "lost", "frames/s", "solver/s"]
    rows, began = [head], time.perf_counter()
    for name, how in list(SEQUENCES.items())[: 2 if quick else None]:
        for seed in SEEDS[: 1 if quick else None]:
            finger = Finger(seed, **how)
            frames = [finger.frame(i) for i in range(12 if quick else finger.frames)]
            s = score(finger, frames, *follow(finger, frames))
            rows.append(
                [
                    f"{name} ({seed})", f"{s.iou:.4f}", f"{s.surface:.3f}", f"{s.depth:.3f}", f"{s.velocity:.1f}",
                    f"{s.normal:.1f}", str(s.lost), f"{s.rate:.1f}", f"{s.solver:.0f}",
                ]
            )  # fmt: skip
            print("  ".join(rows[-1]), f"({time.perf_counter() - began:.0f} s)", flush=True)
    titles = [("Motion: least IoU, largest 3D and depth error of all frames; error of velocity", rows)]
    return lambda markdown: tables.headed(titles, on, markdown)


def main(arguments: Sequence[str] | None = None) -> int:
    return tables.command(arguments, "motion", "The finger followed through its frames.", "one finger, 12 frames", measured)


if __name__ == "__main__":
    raise SystemExit(main())
