"""A state of rest: how far surface and poles move when a run goes on at its finest scale for as long again.

`python -m benchmarks.rest [--quick] [--tuning] [--times 1] [--out FILE.md]` prints a line a shape, in % of its length:
how far the surface moves across itself (largest and root mean square) and how far each pole moves in any direction.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from symseek.device import start_quietly
from symseek.scenes.synthetic import Sample, make
from symseek.sim.loop import Loop
from symseek.sim.problem import Settings, Tube, View
from symseek.sim.reconstruct import Progress, reconstruct
from symseek.sim.surface import refine

from . import truth
from .tables import as_text

SEEDS = range(24024, 24046)
"""Two shapes of each kind; in no other benchmark."""
TUNING = range(120, 142)
FINE = 192, 193
"""Vertices around and rows of the surfaces that are compared."""
COLUMNS = ("shape", "iterations", "at rest", "surface, most", "rms", "first pole", "last pole")


@dataclass(frozen=True)
class Rest:
    """One shape: what the run took, and what going on changed [% of the length]."""

    name: str
    iterations: int
    converged: bool
    most: float
    rms: float
    poles: tuple[float, float]


def measure(sample: Sample, times: float = 1.0, settings: Settings | None = None) -> Rest:
    """Runs as ever, then `times` as many iterations on at the finest scale, velocities as they are."""
    kept: list[Progress] = []
    found = reconstruct(
        [View(sample.image)], [Tube(sample.clicks)], settings, callback=lambda p: None if kept else kept.append(p)
    ).objects[0]
    scene = kept[0].parts[0].scene
    before = scene.world(0)[0]
    loop = Loop(scene, careful=False)
    for _ in range(round(times * found.iterations)):
        loop.run()
    after = scene.world(0)[0]
    share = 100 / sample.length
    # the refined surfaces, so that nodes which slide within them do not count; none is further off than its own way
    (now, _), then = refine(after, *FINE), refine(before, *FINE)
    there = np.minimum(truth.to_surface(now, then), np.linalg.norm(now - then[0], axis=1)) * share
    poles = np.linalg.norm((after - before)[0, [0, -1]], axis=1) * share
    name = f"{sample.kind} {sample.seed}"
    rms = float(np.sqrt((there**2).mean()))
    return Rest(name, found.iterations, found.converged, float(there.max()), rms, (float(poles[0]), float(poles[1])))


def table(rests: list[Rest]) -> list[list[str]]:
    """Head, a line a shape, and the worst of each column."""
    lines = [list(COLUMNS)]
    for r in rests:
        moved = [f"{v:.3f}" for v in (r.most, r.rms, *r.poles)]
        lines.append([r.name, str(r.iterations), "yes" if r.converged else "no", *moved])
    worst = np.max([[r.iterations, r.most, r.rms, *r.poles] for r in rests], axis=0)
    lines.append(["worst", f"{worst[0]:.0f}", "", *(f"{v:.3f}" for v in worst[1:])])
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.rest", description="How far going on moves what is at rest.")
    parser.add_argument("--quick", action="store_true", help="half the shapes")
    parser.add_argument("--tuning", action="store_true", help="other seeds, to tune with")
    parser.add_argument("--times", type=float, default=1.0, help="iterations more, over those of the run")
    parser.add_argument("--out", type=Path, help="file for the table (.md)")
    given = parser.parse_args(arguments)
    start_quietly()
    seeds = TUNING if given.tuning else SEEDS
    rests = []
    for seed in seeds[: 11 if given.quick else None]:
        rests.append(measure(make(seed), given.times))
        print("  ".join(table(rests[-1:])[1]), file=sys.stderr, flush=True)
    head = f"What {given.times:g} times the iterations more change, in % of the length"
    print(f"{head}\n\n{as_text(table(rests), markdown=False)}\n", flush=True)
    if given.out is not None:
        given.out.write_text(f"### {head}\n\n{as_text(table(rests), markdown=True)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
