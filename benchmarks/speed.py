"""Timings: an iteration, a batch of models, a photograph to a mesh by phase, and the start.

`python -m benchmarks.speed [--quick] [--out FILE.md]` prints medians. Wall-clock times: they are worth as much as the
machine was quiet.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import repeat

import numpy as np

import symseek
from symseek import cli
from symseek.scene import Scene
from symseek.sim.assembly import Assembly, maps_of
from symseek.sim.force import add_forces
from symseek.sim.loop import Loop
from symseek.sim.reconstruct import REFRESH, reconstruct
from symseek.sim.relax import FIRM, LEAST_SHARE

from .tables import Headed, command, headed, machine

RUNS = 5
BATCH, BATCHES = 200, 9
"""Iterations timed together, and how often."""
GRIDS = ((25, 25), (49, 49))
MODELS = 1000
STARTS = {
    "symseek --version": ["-m", "symseek", "--version"],
    "import symseek": ["-c", "import symseek"],
    "import symseek.reconstruct": ["-c", "from symseek import reconstruct"],
    "python alone": ["-c", ""],
}


def squash() -> Scene:
    """The scene that ships with the package, read anew."""
    return symseek.load(cli.demos()["squash"])


def iteration(scene: Scene, grid: tuple[int, int]) -> tuple[float, float]:
    """Microseconds of one iteration of one tube at the finest scale: as plain launches, as a captured graph."""
    tubes = [replace(tube, grid=grid) for tube in scene.tubes]
    laid = Assembly(scene.views, tubes, scene.settings, "cpu", maps_of(scene.views, tubes))
    space = laid.spaces[0][0]
    laid.set_potentials([[space.at(space.sigmas[-1], finest=True)]])
    laid.hold_depth()
    laid.hold_shares(FIRM)
    laid.set_material(LEAST_SHARE)
    loop = Loop(laid, careful=False)
    settings = scene.settings

    def launches() -> None:
        add_forces(laid.model, laid.state, settings.contour, settings.force == "paper", settings.tau)
        loop.solver.step(laid.state)

    start = laid.positions()
    times = []
    for step in (launches, loop.run):
        laid.rewind(start)
        times.append(1e6 * _each(step))
    return times[0], times[1]


def batch(scene: Scene, count: int, steps: int) -> list[list[str]]:
    """Microseconds an iteration and model of many models, each with a graph of its own, on one thread and on two."""
    maps = maps_of(scene.views, scene.tubes)
    space = Assembly(scene.views, scene.tubes, scene.settings, "cpu", maps).spaces[0][0]
    potential = space.at(space.sigmas[-1], finest=True)
    loops = []
    for _ in range(count):
        laid = Assembly(scene.views, scene.tubes, scene.settings, "cpu", maps)
        laid.set_potentials([[potential]])
        laid.hold_depth()
        laid.hold_shares(FIRM)
        laid.set_material(LEAST_SHARE)
        loops.append(Loop(laid, careful=False))
    times, ends = [], []
    start = loops[0].scene.positions()
    for threads in (1, 2):
        for loop in loops:
            loop.scene.rewind(start)
        began = time.perf_counter()
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(Loop.run, loops, repeat(steps)))
        times.append(1e6 * (time.perf_counter() - began) / count / steps)
        ends.append([loop.scene.positions()[0] for loop in loops])
    same = all(np.array_equal(a, b) for a, b in zip(*ends, strict=True))
    head = ["models of 25 x 25, microseconds an iteration each", "one thread", "two", "gain", "same bits"]
    return [head, [f"{count}", *(f"{t:.1f}" for t in times), f"{times[0] / times[1]:.2f}", "yes" if same else "no"]]


def _each(step: Callable[[], None]) -> float:
    """Median seconds of a step, after a batch to warm up."""
    batches = []
    for _ in range(BATCHES + 1):
        start = time.perf_counter()
        for _ in range(BATCH):
            step()
        batches.append((time.perf_counter() - start) / BATCH)
    return float(np.median(batches[1:]))


def phases(runs: int) -> dict[str, float]:
    """Median seconds of each phase from photograph to mesh, kernels loaded before; "whole" is the median of the sums."""
    every: list[dict[str, float]] = []
    for _ in range(runs + 1):
        scene = squash()
        every.append({"read": scene.seconds, **reconstruct(scene.views, scene.tubes, scene.settings).seconds})
        every[-1]["whole"] = sum(every[-1].values())
    return {name: float(np.median([run[name] for run in every[1:]])) for name in every[0]}


def start(arguments: Sequence[str], runs: int) -> float:
    """Median seconds of a fresh Python with these arguments, after one to warm the disk up."""
    times = []
    for _ in range(runs + 1):
        began = time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        times.append(time.perf_counter() - began)
    return float(np.median(times[1:]))


def measure(quick: bool = False) -> Headed:
    """Headings and tables, head first."""
    runs = 3 if quick else RUNS
    scene = squash()
    reconstruct(scene.views, scene.tubes, scene.settings)  # compiles and loads the kernels
    iterations = [["one tube, microseconds an iteration", "launches", "captured graph"]]
    for grid in GRIDS:
        iterations.append([f"{grid[0]} x {grid[1]}", *(f"{t:.0f}" for t in iteration(scene, grid))])
    many = batch(scene, 100 if quick else MODELS, REFRESH)
    found = phases(runs)
    by_phase = [["squash, photograph to mesh", "seconds"], *([name, f"{t:.3f}"] for name, t in found.items())]
    starts = [["start", "seconds"], *([name, f"{start(arguments, runs):.3f}"] for name, arguments in STARTS.items())]
    return [
        ("An iteration", iterations),
        (f"A batch, {REFRESH} iterations of each in turn", many),
        (f"By phase, median of {runs} warm runs", by_phase),
        (f"Start, median of {runs}", starts),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    def run(quick: bool) -> Callable[[bool], str]:
        on, tables = machine(), measure(quick)
        return lambda markdown: headed(tables, on, markdown)

    return command(arguments, "speed", "Timings.", "fewer runs", run)


if __name__ == "__main__":
    sys.exit(main())
