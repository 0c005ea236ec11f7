"""Few solids beside a free mesh: ours, the visual hull, and Mitsuba 3 with large steps on the same views, in one run.

`python -m benchmarks.free_mesh [--quick] [--out FILE.md]`; needs `pip install 'symseek[peers]'` and an LLVM of 17 or later;
`DRJIT_LIBLLVM_PATH` names it where the loader finds another. A minute or more of CPU for each solid. Defaults; axes with
4 px of error; true masks for hull and mesh.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from symseek.scenes.views import Views
from symseek.sim.sights import triangulated

from . import tables
from .peers.large_steps import large_steps
from .views import SEEDS, Score, hull, lots, ours, row, score

SOLIDS = SEEDS[4:19:7]
KINDS_OF_VIEWS = ("perspective pair", "ring of 8, perspective")


def free_mesh(made: Views) -> Score:
    began, second = time.process_time(), max(1, len(made.cameras) // 4)
    rough = triangulated([made.clicks[v] for v in (0, second)], [made.cameras[v] for v in (0, second)])
    vertices, faces = large_steps(made, rough)
    return score(made, vertices, faces, None, time.process_time() - began, True)


def measured(quick: bool) -> Callable[[bool], str]:
    """Solves all; returns what writes the table."""
    on = tables.machine()
    rows = [["", "3D %", "volume %", "least IoU", "depth %", "CPU s", "not trusted"]]
    methods = {"symseek": ours, "visual hull": hull, "Mitsuba, large steps": free_mesh}
    for name in KINDS_OF_VIEWS:
        solids = [lots()[name](seed) for seed in (SOLIDS[:1] if quick else SOLIDS)]
        for method, solve in methods.items():
            rows.append(row(f"{name}: {method}", [solve(made) for made in solids]))
            print("  ".join(rows[-1]), flush=True)
    titles = [(f"Beside a free mesh, {1 if quick else len(SOLIDS)} solids each: median (worst)", rows)]
    return lambda markdown: tables.headed(titles, on, markdown)


def main(arguments: Sequence[str] | None = None) -> int:
    return tables.command(arguments, "free_mesh", "Several views beside a free mesh.", "one solid", measured)


if __name__ == "__main__":
    raise SystemExit(main())
