"""How little the surface depends on how it is computed: grid, size of the image.

`python -m benchmarks.invariance [--quick] [--out FILE.md]` prints, over one shape of each kind, the mean distance between
two surfaces of the same scene in % of the object's length: other grids against 25 x 25, other image sizes against 512 px.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import numpy as np

from symseek.scenes.synthetic import KINDS, make
from symseek.sim.problem import Tube, View
from symseek.sim.reconstruct import reconstruct

from . import truth
from .tables import as_text, command

SEEDS = range(5001, 5001 + len(KINDS))
"""One shape of each kind; in no other benchmark."""
SIZE, GRID = 512, (25, 25)
SIZES, GRIDS = (256, 1024), ((49, 49), (64, 32))


def surface(seed: int, size: int, grid: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, in pixels of the image of SIZE, and faces found from the same clicks in an image of `size`."""
    factor = size / SIZE
    clicks = (make(seed, size=SIZE).clicks + 0.5) * factor - 0.5
    image = make(seed, size=size).image
    found = reconstruct([View(image)], [Tube(clicks, grid=grid)]).objects[0]
    shift = np.array([0.5, 0.5, 0.0])
    return (found.vertices + shift) / factor - shift, found.faces


def measure(quick: bool) -> list[list[str]]:
    """A line for each change, head first: median and largest over the shapes."""
    changes = [(f"{nx} x {ns} nodes", SIZE, (nx, ns)) for nx, ns in GRIDS] + [(f"{size} px", size, GRID) for size in SIZES]
    apart: dict[str, list[float]] = {name: [] for name, *_ in changes}
    for seed in SEEDS[:3] if quick else SEEDS:
        plain, length = surface(seed, SIZE, GRID), make(seed, size=SIZE).length
        for name, size, grid in changes:
            apart[name].append(truth.surface_error(*surface(seed, size, grid), *plain, length))
    table = [["changed", "median %", "largest %"]]
    return table + [[name, f"{np.median(a):.3f}", f"{max(a):.3f}"] for name, a in apart.items()]


def main(arguments: Sequence[str] | None = None) -> int:
    def run(quick: bool) -> Callable[[bool], str]:
        table = measure(quick)
        return lambda markdown: as_text(table, markdown)

    return command(arguments, "invariance", "Dependence on grid and image size.", "three shapes", run)


if __name__ == "__main__":
    sys.exit(main())
