"""Section 5's claim about its schemes: iterations and time to one residual, by grid and rigidity; steps against theory.

`python -m benchmarks.solvers [--quick] [--out FILE.md]`. The task is the paper's own: a tube round a spine, coupled by
(7), (8) and upright rings, drawn by springs along the two sides that one view sees to a bent, wavy shape.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from symseek.sim.assembly import LINE_LOAD
from symseek.sim.camera import Camera
from symseek.sim.force import add_forces
from symseek.sim.material import Material
from symseek.sim.model import Model, State
from symseek.sim.solvers import SCHEMES, Solver
from symseek.sim.solvers.bounds import STRETCH

from .tables import command, headed, machine

GRIDS = (25, 64, 128)
RIGIDITIES = (1, 10, 100)
TARGET = 1e-3
"""Residual over that of the start at which a tube counts as at rest."""
MOST = 2000
"""Iterations after which a scheme is given up."""
PATIENCE = 40.0
"""Seconds after which a scheme is given up at one setting."""
STEPS = (0.4, 1.6, 6.4, 25.6)
OMEGAS = (1.5, 1.9)
"""Over-relaxation factors that are tried."""
RADIUS = 0.1


@wp.kernel(enable_backward=False)
def draw(
    # model
    load: wp.array[float],
    target: wp.array[wp.vec3],
    # state in
    tube_in: wp.array[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds springs of stiffness `load` to `target`."""
    i = wp.tid()
    force_out[i] = force_out[i] + load[i] * (target[i] - tube_in[i])


def shape(n: int, bent: bool) -> tuple[np.ndarray, np.ndarray]:
    """Tube (n, n, 3), ring after ring, and its spine: a straight cylinder, or bent and wavy."""
    s, angle = np.linspace(0, 1, n), 2 * np.pi * np.arange(n) / n
    spine = np.stack([0.1 * np.sin(3 * s) * bent, s, 0 * s], -1)
    radius = RADIUS + bent * 0.04 * np.sin(5 * s)
    ring = np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], -1)
    return spine[:, None] + radius[:, None, None] * ring, spine


def boundless(scheme: str) -> type[Solver]:
    """A scheme that takes any step that it is told to."""
    return type(scheme, (SCHEMES[scheme],), {"bears": lambda self, dt: True})


class Task:
    """A straight tube, drawn to a shape by springs on two opposite meridians, `load` by unit of s."""

    def __init__(self, n: int, rigidity: float, bent: bool = True, load: float = LINE_LOAD, mu: float = 0.0):
        self.n, material = n, Material()
        self.model = m = Model([(n, n)], [False], 1, 4, "cpu")
        m.set_cameras([Camera.orthographic()])
        for key, scale in (("w20", rigidity), ("w02", rigidity), ("w2", rigidity)):
            getattr(m, key).fill_(getattr(material, key) * scale)
        lap = (2 * np.sin(np.pi / n) * n) ** 2
        balance = material.w20 * rigidity * lap**2
        row = [material.a, material.a * material.reaction, material.b, 0, balance, material.d, 0, material.depth, 0]
        m.coupling.assign(np.tile(np.array(row, np.float32), (n, 1)))
        m.image_load[:] = load / STRETCH  # these springs are what they are
        self.state = State(m)
        sides = np.zeros((n, n))
        sides[:, [0, n // 2]] = load * n
        sides[[0, -1]] *= 0.5
        self.load = wp.array(sides.ravel().astype(np.float32), dtype=float, device="cpu")
        self.target = wp.array(shape(n, bent)[0].reshape(-1, 3).astype(np.float32), dtype=wp.vec3, device="cpu")
        # what a residual is measured with: the way that an implicit step of 1 would go, in float64
        self.exact = boundless("direct")(m, 1.0, 1.0, 0.0)
        m.mu.fill_(mu)
        m.spine_mu.fill_(mu)
        self.reset()

    def reset(self) -> None:
        """Back to the straight tube, at rest."""
        tube, spine = shape(self.n, bent=False)
        self.state.tube.assign(tube.reshape(-1, 3).astype(np.float32))
        self.state.spine.assign(spine.astype(np.float32))
        for array in (self.state.velocity, self.state.spine_velocity, self.state.age):
            array.zero_()

    def forces(self) -> None:
        """All forces of (10), the springs in place of an image's."""
        add_forces(self.model, self.state, "subnode", False, 0.05)
        wp.launch(draw, self.model.nodes, inputs=[self.load, self.target, self.state.tube], outputs=[self.state.force])

    def residual(self) -> float:
        """|(M + K)^-1 R|, root mean square over nodes: forces by the way that they still have to move the tube."""
        self.forces()
        right = np.concatenate([self.state.force.numpy(), self.state.low.numpy()]).astype(float)
        right[self.model.nodes :] = 0
        return float(np.sqrt((self.exact.factor.solve(right)[: self.model.nodes] ** 2).sum(axis=1).mean()))

    def iteration(self, solver: Solver) -> Iteration:
        """Forces and step as a graph."""
        return Iteration(self, solver)


class Iteration:
    """Forces and a scheme's step, as a graph as far as the scheme allows."""

    def __init__(self, task: Task, solver: Solver):
        self.task, self.solver = task, solver
        with wp.ScopedCapture(device="cpu") as capture:
            task.forces()
            if solver.captured:
                solver.step(task.state)
        self.graph = capture.graph

    def __call__(self) -> None:
        wp.capture_launch(self.graph)
        if not self.solver.captured:
            self.solver.step(self.task.state)


def rest(task: Task, solver: Solver, most: int) -> tuple[int | None, float, float]:
    """Iterations to rest (None: given up), seconds they took without looking, and the share of the residual that is left."""
    task.reset()
    first, step, seconds = task.residual(), task.iteration(solver), 0.0
    for count in range(1, most + 1):
        began = time.perf_counter()
        step()
        seconds += time.perf_counter() - began
        if count < 20 or count % max(1, count // 20) == 0:
            left = task.residual() / first
            if left < TARGET:
                return count, seconds, left
            if not left < 1e3 or seconds > PATIENCE:
                break
    return None, seconds, left


def best(task: Task, scheme: str, plain: bool, most: int) -> tuple[int | None, float, float, str]:
    """The setting of a scheme that rests in fewest iterations: their count, seconds, residual left, setting."""
    cls, found = SCHEMES[scheme], []
    for omega in OMEGAS if scheme == "sor" else (None,):
        for step in (None,) if scheme == "euler" else (None, *STEPS):
            made = type(scheme, (cls,), {} if omega is None else {"omega": omega})
            try:
                solver = made(task.model, step, 1.0 if plain else None, 0.0 if plain else 0.9)
            except ValueError:
                continue  # longer than it bears
            count, seconds, left = rest(task, solver, most)
            said = f"dt {solver.dt:.2g}" + (f", omega {omega:g}" if omega else "")
            # by counts, which no other work on the machine changes
            found.append((count is None, count or left, seconds, left, said))
    missed, _, seconds, left, said = best_of = min(found)
    count = None if missed else int(best_of[1])
    return count, seconds, left, said


def claim(plain: bool, grids: Sequence[int], rigidities: Sequence[float], most: int) -> list[list[str]]:
    """Rows by grid and rigidity, a column a scheme: iterations, seconds, setting."""
    table = [["grid, rigidity", *SCHEMES]]
    for n in grids:
        for rigidity in rigidities:
            task, row = Task(n, rigidity), [f"{n} x {n}, x {rigidity:g}"]
            for scheme in SCHEMES:
                count, seconds, left, said = best(task, scheme, plain, most)
                row.append(f"{count}, {seconds:.2g} s ({said})" if count else f"- (left {left:.1g}; {said})")
            table.append(row)
            print("  ".join(row), flush=True)
    return table


def stable(task: Task, scheme: str, dt: float, steps: int = 400) -> bool:
    """Whether a tube at rest that is shaken stays there."""
    solver = boundless(scheme)(task.model, dt, 1.0, 0.0)
    task.reset()
    noise = np.random.default_rng(1).normal(size=(task.model.nodes, 3))
    task.state.tube.assign(task.state.tube.numpy() + 1e-5 * noise.astype(np.float32))
    step = task.iteration(solver)
    for _ in range(steps):
        step()
    moved = np.abs(task.state.tube.numpy() - task.target.numpy()).max()
    return bool(moved < 1e-2)  # a NaN is not


def steps_against_theory(n: int) -> list[list[str]]:
    """Rows by scheme, mass, rigidity and load: the step that the scheme says it bears, and the longest that it did."""
    table = [["scheme", "mu", "rigidity", "springs", "says", "largest stable"]]
    for mu in (0.0, 0.1):
        for scheme, cls in SCHEMES.items():
            if mu and not cls.bears_mass:
                continue
            for rigidity, load in ((1, 1), (1, 40), (100, 40)):
                task = Task(n, rigidity, bent=False, load=load * LINE_LOAD, mu=mu)
                says = cls(task.model, None, 1.0, 0.0).longest_step()
                low, high = (1.0, 1e3) if not np.isfinite(says) else (0.25 * says, 16 * says)
                if stable(task, scheme, high):
                    low = high
                else:
                    for _ in range(9):
                        middle = float(np.sqrt(low * high))
                        low, high = (middle, high) if stable(task, scheme, middle) else (low, middle)
                found = f"above {low:.3g}" if low == high else f"{low:.3g}"
                said = f"{says:.3g}" if np.isfinite(says) else "any"
                table.append([scheme, f"{mu:g}", f"x {rigidity}", f"x {load}", said, found])
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    def run(quick: bool) -> Callable[[bool], str]:
        on = machine()
        grids, rigidities, most = ((25, 64), (1, 100), 500) if quick else (GRIDS, RIGIDITIES, MOST)
        tables = [
            ("Plain (slow 1, momentum 0): iterations and time to a residual of 1e-3", claim(True, grids, rigidities, most)),
            ("With slow modes and momentum (each scheme's own)", claim(False, grids, rigidities, most)),
            ("Largest steps at 25 x 25", steps_against_theory(25)),
        ]
        return lambda markdown: headed(tables, on, markdown)

    return command(arguments, "solvers", "The schemes of section 5.", "two grids, fewer iterations", run)


if __name__ == "__main__":
    sys.exit(main())
