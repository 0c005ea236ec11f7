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
from symseek.sim.bend import linearised
from symseek.sim.problem import Settings, Tube, View
from symseek.sim.result import ObjectResult
from symseek.sim.surface import refine
from symseek.sim.track import Shown, Tracking, track

from . import tables, truth

FIRST = "first"
"""Iterations for the first frame, where they are not the default's; all else is of `Finger`."""
SEQUENCES: dict[str, dict] = {
    "round finger": {"cut": False, "out_of_round": 0.0},
    "round, 40 iterations for its first frame": {"cut": False, "out_of_round": 0.0, FIRST: 40},
    "round, base cut by the border": {"out_of_round": 0.0},
    "3 % out of round": {"cut": False},
    "3 %, base cut": {},
    "3 %, perspective, base cut": {"perspective": True},
    "3 %, twice as fast": {"cut": False, "speed": 2.0},
    "3 %, twice as fast, base cut": {"speed": 2.0},
    "3 %, along the line between the eyes": {"cut": False, "along": True},
}
Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices (V, 3) and faces (F, 3)."""
SEEDS = (21, 22, 23)
"""Of the fingers; the constants were chosen on others, 0, 11 and 41 to 47."""
BENDING = 0.02
"""Share of its flexion that the nearly rigid finger makes; it sways as fast as the others bend."""
COUNTS = (1, 2, 5, 10, 20, 40, 80)
"""Iterations a frame that it is followed by."""
EVERY = 13
"""Of how many frames one is looked at for what a round tube could do."""
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
    round_surface: float
    """3D error of the best round tube, see `rounded`, and its depth error."""
    round_depth: float


@dataclass(frozen=True)
class Pace:
    """What a frame takes."""

    rate: float
    """frames a second: maps, potentials and solver, two cores at most."""
    cpu: float
    """[ms], all threads."""
    solver: float
    """[ms] of CPU, the solver's alone."""


def counts(finger: Finger, points: np.ndarray) -> np.ndarray:
    """Which points (n, 3) both images hold, their borders left out."""
    sides = [c.project(points) for c in finger.cameras]
    return np.all([((p > MARGIN) & (p < [640 - MARGIN, 480 - MARGIN])).all(axis=1) for p in sides], axis=0)


def apart(finger: Finger, one: Mesh, other: Mesh) -> float:
    """Mean distance of two surfaces, as far as both images hold them [% of the finger's length]."""
    mine, theirs = (truth.spread_over(v[f].astype(float), 4000) for v, f in (one, other))
    mine, theirs = mine[counts(finger, mine)], theirs[counts(finger, theirs)]
    return 50 * (truth.to_surface(mine, other).mean() + truth.to_surface(theirs, one).mean()) / finger.length


def rounded(finger: Finger, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """The true finger with circles for sections, as both eyes' true outlines tell them; and how far its axis is off.

    Outlines tell a section's middle and width across each line of sight, and of a section out of round no more: two
    middles meet at a point that is not its centre. No round tube can do better by outlines.
    """
    axis = frame.spine[1:-1]
    rings = frame.vertices[1:-1].reshape(len(axis), -1, 3)
    tangent = np.gradient(axis, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    sides, heights, half = [tangent], [(tangent * axis).sum(axis=1)], []
    for camera in finger.cameras:
        _, slope = linearised(camera, axis)
        along = np.einsum("nij,nj->ni", slope, tangent)
        across = np.einsum("ni,nij->nj", np.stack([-along[:, 1], along[:, 0]], axis=1), slope)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        place = np.einsum("nkj,nj->nk", rings, across)
        sides.append(across)
        heights.append(0.5 * (place.max(axis=1) + place.min(axis=1)))
        half.append(0.5 * np.ptp(place, axis=1))
    centre = np.linalg.solve(np.stack(sides, axis=1), np.stack(heights, axis=1)[..., None])[..., 0]
    spoke = rings - axis[:, None]
    spoke *= (np.mean(half, axis=0)[:, None] / np.linalg.norm(spoke, axis=2))[..., None]
    vertices = frame.vertices.copy()
    vertices[1:-1] = (centre[:, None] + spoke).reshape(-1, 3)
    return vertices, centre - axis


def score(finger: Finger, frames: Sequence[Frame], o: ObjectResult) -> Score:
    """Errors of a followed finger."""
    ious, surfaces, depths, best = [], [], [], []
    total, wrong, across = 0.0, 0.0, 0.0
    for i, (frame, tube, spine) in enumerate(zip(frames, o.tube, o.spine, strict=True)):
        mesh, true = refine(tube), (frame.vertices, finger.faces)
        pairs = zip(finger.cameras, frame.coverages, strict=True)
        ious.append(min(truth.silhouette_iou(*mesh, camera, cover) for camera, cover in pairs))
        surfaces.append(apart(finger, mesh, true))
        if i % EVERY == 0:
            vertices, off = rounded(finger, frame)
            off = off[counts(finger, frame.spine[1:-1]), 2]
            best.append((apart(finger, (vertices, finger.faces), true), 100 * np.abs(off).mean() / finger.length))
        seen = spine[counts(finger, spine)]
        near = KDTree(frame.spine[:, :2]).query(seen[:, :2])[1]
        depths.append(100 * np.abs(seen[:, 2] - frame.spine[near, 2]).mean() / finger.length)
        points = tube.reshape(-1, 3)
        inside = counts(finger, points)
        own = frame.velocity[KDTree(frame.vertices).query(points)[1]]
        error = (o.velocity[i].reshape(-1, 3) - own)[inside]
        normal = np.cross(np.roll(tube, -1, axis=0) - np.roll(tube, 1, axis=0), np.gradient(tube, axis=1)).reshape(-1, 3)
        normal = (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))[inside]
        total += (own[inside] ** 2).sum()
        wrong += (error**2).sum()
        across += ((error * normal).sum(axis=1) ** 2).sum()
    lost = sum(note.startswith("lost") for note in o.notes)
    return Score(
        min(ious), max(surfaces), max(depths), 100 * float(np.sqrt(wrong / total)), 100 * float(np.sqrt(across / total)),
        lost, *np.max(best, axis=0).tolist(),
    )  # fmt: skip


def follow(
    finger: Finger, frames: Sequence[Frame], tracking: Tracking | None = None, settings: Settings | None = None
) -> tuple[ObjectResult, Pace]:
    """A finger followed with defaults, its frames handed over one at a time; and what that took."""
    clocks: list[np.ndarray] = []

    def stream() -> Iterator[list[np.ndarray]]:
        for frame in frames:
            yield frame.images

    names = ("left", "right")
    views = [View(image, c, n) for image, c, n in zip(frames[0].images, finger.cameras, names, strict=True)]
    tube = Tube(finger.rough, "finger")

    def note(_: Shown) -> None:
        clocks.append(np.array([time.perf_counter(), time.process_time(), time.thread_time()]))

    found = track(stream(), views, [tube], settings, tracking or Tracking(fps=finger.fps), callback=note)
    wall, cpu, own = ((clocks[-3] - clocks[0]) / (len(clocks) - 3)).tolist()  # the last two make no potentials
    return found.objects[0], Pace(1 / wall, 1e3 * cpu, 1e3 * own)


def savings(seeds: Sequence[int], frames: int) -> list[list[str]]:
    """A nearly rigid finger by numbers of iterations a frame, after each way to begin one: how far it is from the truth."""
    rows = [["begins with", *(f"{count} iterations" for count in COUNTS)]]
    made = [Finger(seed, cut=False, out_of_round=0.0, bending=BENDING) for seed in seeds]
    shown = [[finger.frame(i) for i in range(frames)] for finger in made]
    for first in ("none", "rigid", "rod"):
        row = [first]
        for count in COUNTS:
            off, lost = [], 0
            for finger, own in zip(made, shown, strict=True):
                o, _ = follow(finger, own, Tracking(count, finger.fps, first))
                pairs = zip(o.tube[1:], own[1:], strict=True)
                far = [KDTree(frame.vertices).query(tube.reshape(-1, 3))[0].mean() for tube, frame in pairs]
                off.append(100 * float(np.mean(far)) / finger.length)
                lost += sum(note.startswith("lost") for note in o.notes)
            row.append(f"{np.median(off):.3f} ({max(off):.3f})" + f", {lost} lost" * (lost > 0))
        rows.append(row)
        print("  ".join(row), flush=True)
    return rows


def measured(quick: bool) -> Callable[[bool], str]:
    """Follows all fingers; returns what writes the tables."""
    on = tables.machine()
    head = ["", "IoU", "3D %", "best round", "depth %", "best round", "velocity %", "normal %", "lost"]
    head += ["frames/s", "CPU ms", "solver ms"]
    rows, began = [head], time.perf_counter()
    for name, how in list(SEQUENCES.items())[: 2 if quick else None]:
        settings = Settings(iterations=how.get(FIRST, Settings.iterations))
        for seed in SEEDS[: 1 if quick else None]:
            finger = Finger(seed, **{key: value for key, value in how.items() if key != FIRST})
            frames = [finger.frame(i) for i in range(12 if quick else finger.frames)]
            o, pace = follow(finger, frames, settings=settings)
            s = score(finger, frames, o)
            rows.append(
                [
                    f"{name} ({seed})", f"{s.iou:.4f}", f"{s.surface:.3f}", f"{s.round_surface:.3f}", f"{s.depth:.3f}",
                    f"{s.round_depth:.3f}", f"{s.velocity:.1f}", f"{s.normal:.1f}", str(s.lost), f"{pace.rate:.1f}",
                    f"{pace.cpu:.0f}", f"{pace.solver:.0f}",
                ]
            )  # fmt: skip
            print("  ".join(rows[-1]), f"({time.perf_counter() - began:.0f} s)", flush=True)
    about = "Motion: least IoU, largest 3D and depth error of all frames, and of the best round tube; error of velocity"
    saved = savings(SEEDS[: 1 if quick else None], 6 if quick else 16)
    titles = [(about, rows), ("A nearly rigid finger: mean distance to the surface, % of the length: median (worst)", saved)]
    return lambda markdown: tables.headed(titles, on, markdown)


def main(arguments: Sequence[str] | None = None) -> int:
    return tables.command(arguments, "motion", "The finger followed through its frames.", "one finger, 12 frames", measured)


if __name__ == "__main__":
    raise SystemExit(main())
