"""What each of our changes is worth against the paper's own form.

`python -m benchmarks.ablation [--quick] [--out FILE.md]` prints a table: medians and worst values over one shape of each
kind, with one thing changed in each row. Unbalanced expansion needs a c: the best of `EXPANSIONS` on other shapes is taken.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from symseek.scenes.synthetic import KINDS, Sample, make
from symseek.sim.material import Material
from symseek.sim.problem import Settings, Tube, View
from symseek.sim.reconstruct import reconstruct

from . import truth
from .accuracy import FAILED
from .tables import as_text, command

SEEDS = range(4001, 4001 + len(KINDS))
"""One shape of each kind; in no other benchmark."""
SEARCH = (4101, 4104)
"""Shapes on which c is chosen."""
EXPANSIONS = (0.003, 0.01, 0.03)
COLUMNS = (
    "changed", "IoU median", "worst", "contour px", "worst", "3D %", "worst", "volume %", "worst", "iterations", "at rest",
    "failed",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One line of the table: what differs from the defaults."""

    name: str
    settings: dict[str, Any] = field(default_factory=dict)
    material: dict[str, Any] = field(default_factory=dict)

    choose_c: bool = False
    """whether c is to be chosen on other shapes."""

    def choices(self) -> list[Row]:
        """This row with every c that may suit it; alone where nothing is to be chosen."""
        if self.choose_c:
            return [replace(self, name=f"{self.name}, c = {c:g}", material=self.material | {"c": c}) for c in EXPANSIONS]
        return [self]


@dataclass(frozen=True)
class Outcome:
    """One run."""

    errors: truth.Errors | None
    iterations: int = 0
    converged: bool = False

    @property
    def failed(self) -> bool:
        return self.errors is None or not self.errors.iou >= FAILED


ROWS = (
    Row("nothing: all defaults"),
    Row('contour = "switch"', {"contour": "switch"}),
    Row('contour = "switch", tau = 0.1', {"contour": "switch", "tau": 0.1}),
    Row('force = "paper"', {"force": "paper"}),
    Row('potential = "brightness"', {"potential": "brightness"}),
    Row("c_balance = 0", material={"c_balance": 0.0}),
    Row("c_balance = 0", material={"c_balance": 0.0}, choose_c=True),
    Row("reaction = 1", material={"reaction": 1.0}),
    Row("d = 0", material={"d": 0.0}),
    Row("centre = 0", material={"centre": 0.0}),
    Row("momentum = 0", {"momentum": 0.0}),
    Row("slow = 1", {"slow": 1.0}),
    Row("w2 x 100", material={"w2": 100 * Material().w2}),
    Row(
        "near-literal paper, c = 0.001",
        {"contour": "switch", "force": "paper", "potential": "brightness"},
        {"c_balance": 0.0, "reaction": 1.0, "d": 0.0, "centre": 0.0, "c": 0.001},
    ),
)


def attempt(row: Row, sample: Sample) -> Outcome:
    """One row on one shape."""
    tube = Tube(sample.clicks, material=Material(**row.material))
    try:
        found = reconstruct([View(sample.image)], [tube], Settings(**row.settings)).objects[0]
        if not np.isfinite(found.vertices).all():
            return Outcome(None)
        errors = truth.compare(found.vertices, found.faces, sample)
    except (ArithmeticError, IndexError, RuntimeError, ValueError) as problem:
        # an exception counts as a failure: some of these forms blow up
        print(f"  {row.name} on {sample.kind} {sample.seed}: {type(problem).__name__}: {problem}", file=sys.stderr)
        return Outcome(None)
    return Outcome(errors, found.iterations, found.converged)


def chosen(row: Row, samples: Sequence[Sample]) -> Row:
    """That of the row's choices whose mean IoU over the samples is best."""

    def merit(tried: Row) -> float:
        outcomes = (attempt(tried, sample) for sample in samples)
        return float(np.mean([o.errors.iou if o.errors else 0.0 for o in outcomes]))

    choices = row.choices()
    return max(choices, key=merit) if len(choices) > 1 else row


def line(name: str, outcomes: list[Outcome]) -> list[str]:
    """Cells under COLUMNS; medians and worst values over what gave a mesh."""
    given = [o.errors for o in outcomes if o.errors is not None]
    cells = [name]
    for values, digits, worst in (
        ([e.iou for e in given], 4, min),
        ([e.contour for e in given], 2, max),
        ([e.surface for e in given], 3, max),
        ([abs(e.volume) for e in given], 2, max),
    ):
        cells += [number(pick(values), digits) if values else "-" for pick in (np.median, worst)]
    ran = [o.iterations for o in outcomes if o.errors is not None]
    cells.append(f"{np.median(ran):.0f}" if ran else "-")
    cells += [str(sum(o.converged for o in outcomes)), str(sum(o.failed for o in outcomes))]
    return cells


def number(value: float, digits: int) -> str:
    """Short also where something blew up."""
    if not np.isfinite(value):
        return "inf"
    return f"{value:.{digits}f}" if abs(value) < 1000 else f"{value:.0e}"


def measure(quick: bool = False) -> list[list[str]]:
    """Every row of the table, head first; in a quick run four shapes."""
    samples = [make(seed) for seed in (SEEDS[:4] if quick else SEEDS)]
    search = [make(seed) for seed in (SEARCH[:1] if quick else SEARCH)]
    attempt(ROWS[0], samples[0])  # compiles the kernels
    table = [list(COLUMNS)]
    for row in ROWS:
        best = chosen(row, search)
        table.append(line(best.name, [attempt(best, sample) for sample in samples]))
        print("  ".join(table[-1]), file=sys.stderr, flush=True)
    return table


def report(table: list[list[str]], count: int, markdown: bool) -> str:
    """The table under its heading."""
    head = f"What each change is worth: {count} shapes of {count} kinds, 512 px, five clicks off by 4 px, 25 x 25"
    below = (
        f"Failed: an exception, or an IoU below {FAILED:g}. At rest: runs that converged. A c beside c_balance = 0 is the "
        f"best of {', '.join(f'{c:g}' for c in EXPANSIONS)} on other shapes."
    )
    return f"{'### ' if markdown else ''}{head}\n\n{as_text(table, markdown)}\n\n{below}\n"


def main(arguments: Sequence[str] | None = None) -> int:
    def run(quick: bool) -> Callable[[bool], str]:
        table, count = measure(quick), 4 if quick else len(SEEDS)
        return lambda markdown: report(table, count, markdown)

    return command(arguments, "ablation", "What each of our changes is worth.", "four shapes", run)


if __name__ == "__main__":
    sys.exit(main())
