"""The elastic solve of one ADI step beside its peers.

`python -m benchmarks.lines [--quick] [--out FILE.md]` prints microseconds, best of many runs, each peer in the same run
on the same work (a fresh right side is copied in each time), and what memory and arithmetic of this machine would allow.
Worth as much as the machine was quiet.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence

import numba
import numpy as np
import warp as wp

from symseek.sim.model import Model, State
from symseek.sim.solvers import make_solver

from .peers.line_solvers import Interleaved, Lapack, LineByLine, SparseFactors, Step
from .tables import Headed, command, headed, machine

STEPS = (Step(25, 25), Step(64, 64), Step(128, 128), Step(512, 512), Step(25, 25, 43), Step(25, 25, 1000))
LARGEST = 30_000
"""Most nodes for which the whole step is factored in a benchmark that is to end."""
SECONDS = 0.5
"""Spent on each timing."""
BYTES, FLOPS = 84, 66
"""Least of each for a node of one step: both sweeps read and write positions and read factors; one flop is one operation."""
PEERS = {"numba, by line": LineByLine, "numba, interleaved": Interleaved, "LAPACK pbtrs": Lapack, "splu": SparseFactors}


def best(run: Callable[[], object], seconds: float) -> float:
    """Microseconds of the fastest of the runs that fit into some seconds."""
    run()
    times = []
    end = time.perf_counter() + seconds
    while len(times) < 3 or time.perf_counter() < end:
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return 1e6 * min(times)


def ours(step: Step) -> Callable[[], np.ndarray]:
    """The line solves of our ADI step, as a captured graph; a run returns D, shape (T N_s N_x, 3)."""
    model = Model([(step.nx, step.ns)] * step.tubes, [False] * step.tubes, 1, 4, "cpu")
    model.w20.fill_(step.w20)
    model.w02.fill_(step.w02)
    solver = make_solver("adi", model, step.dt, None, 0.0)
    state = State(model)
    fresh = wp.array(right_side(step).reshape(-1, 3), dtype=wp.vec3, device="cpu")
    with wp.ScopedCapture(device="cpu") as capture:
        wp.copy(state.delta, fresh)
        solver.solve_lines(state)

    def run() -> np.ndarray:
        wp.capture_launch(capture.graph)
        return state.delta.numpy()

    return run


def right_side(step: Step) -> np.ndarray:
    """Shape (T, N_s, N_x, 3), float32."""
    return np.random.default_rng(0).normal(size=(step.tubes, step.ns, step.nx, 3)).astype(np.float32)


def peer(kind: type, step: Step) -> Callable[[], None]:
    """One peer's solve."""
    solver, fresh = kind(step), right_side(step)
    if kind is Interleaved:
        fresh = np.ascontiguousarray(fresh.transpose(2, 1, 3, 0))
    v = fresh.copy()

    def run() -> None:
        np.copyto(v, fresh)  # what is solved again and again decays into denormals, which are slow
        solver.solve(v)

    return run


@numba.njit(fastmath=True)
def _chain(x: np.ndarray, turns: int) -> None:
    for _ in range(turns):
        for i in range(len(x)):
            x[i] = x[i] * np.float32(0.999) + np.float32(0.001)


def rates(seconds: float) -> tuple[float, float]:
    """What one thread moves [bytes a microsecond] and computes with float32 numbers in its cache [flops a microsecond]."""
    big, other = np.ones(1 << 24, np.float32), np.ones(1 << 24, np.float32)
    moved = 2 * big.nbytes / best(lambda: np.copyto(other, big), seconds)
    x = np.ones(4096, np.float32)
    return moved, 2 * len(x) * 100 / best(lambda: _chain(x, 100), seconds)


def measure(quick: bool) -> Headed:
    """Headings and tables, head first."""
    seconds = SECONDS / 5 if quick else SECONDS
    moved, computed = rates(seconds)
    head = ["grid", "ours", *PEERS, "least by memory", "least by arithmetic"]
    table = [head]
    for step in STEPS[:3] if quick else STEPS:
        nodes = step.tubes * step.nx * step.ns
        row = [f"{step.nx} x {step.ns}" + (f", {step.tubes} tubes" if step.tubes > 1 else "")]
        row.append(f"{best(ours(step), seconds):.1f}")
        for kind in PEERS.values():
            fits = kind is not SparseFactors or step.nx * step.ns <= LARGEST
            row.append(f"{best(peer(kind, step), seconds):.1f}" if fits else "-")
        table.append([*row, f"{BYTES * nodes / moved:.1f}", f"{FLOPS * nodes / computed:.1f}"])
    note = f"{moved / 1e3:.1f} GB/s, {computed / 1e3:.1f} Gflop/s on one thread"
    return [(f"Elastic solve of one ADI step, microseconds ({note})", table)]


def main(arguments: Sequence[str] | None = None) -> int:
    def run(quick: bool) -> Callable[[bool], str]:
        on, tables = machine(), measure(quick)
        return lambda markdown: headed(tables, on, markdown)

    return command(arguments, "lines", "The elastic solve beside its peers.", "small grids, shorter timings", run)


if __name__ == "__main__":
    sys.exit(main())
