"""What a break is worth where an object has snapped.

`python -m benchmarks.breaks [--quick] [--out FILE.md]` prints a table: the same clicks with a break at the place, and with
a mark in gaps wider than `MARKED`, and without.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from symseek.device import start_quietly
from symseek.scenes import raster
from symseek.scenes.broken import Snapped, snapped
from symseek.sim.material import Break
from symseek.sim.problem import Tube, View
from symseek.sim.reconstruct import reconstruct

SEEDS = range(5001, 5033)
MARKED = 6.0
"""Gap above which a user would mark it with `not_here` [px]."""


def attempt(sample: Snapped, broken: bool) -> tuple[float, bool, int]:
    """IoU of the silhouettes, whether the result is trusted, iterations."""
    place = (float(sample.place[0]), float(sample.place[1]))
    mark = sample.place[None] if broken and sample.gap > MARKED else None
    tube = Tube(sample.clicks, breaks=(Break(place),) if broken else (), not_here=mark)
    found = reconstruct([View(sample.image)], [tube]).objects[0]
    cover = raster.coverage(found.vertices[:, :2], found.faces, sample.image.shape[:2])
    iou = np.minimum(cover, sample.coverage).sum() / np.maximum(cover, sample.coverage).sum()
    return float(iou), found.trusted, found.iterations


def table(seeds: Sequence[int]) -> str:
    """Markdown: median and worst over the seeds."""
    samples = [snapped(seed) for seed in seeds]
    lines = ["| | IoU median | worst | trusted | iterations |", "|---|---|---|---|---|"]
    for name, broken in (("with its break", True), ("without", False)):
        iou, trusted, iterations = zip(*(attempt(sample, broken) for sample in samples), strict=True)
        cells = [name, f"{np.median(iou):.4f}", f"{min(iou):.4f}", f"{sum(trusted)} of {len(iou)}"]
        cells.append(f"{np.median(iterations):.0f}")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.breaks", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="four solids only")
    parser.add_argument("--out", metavar="FILE.md", type=Path, help="write the table there too")
    options = parser.parse_args(arguments)
    start_quietly()
    text = table(SEEDS[:4] if options.quick else SEEDS)
    print(text)
    if options.out:
        options.out.write_text(text + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
