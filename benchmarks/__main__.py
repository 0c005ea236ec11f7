"""`python -m benchmarks [--quick] [--out DIR]`: accuracy, ablation, grid and size, rest, photographs, motion, timings."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from symseek.device import start_quietly

from . import (
    ablation,
    accuracy,
    breaks,
    dance,
    invariance,
    lines,
    motion,
    photographs,
    rest,
    snakes,
    solvers,
    speed,
    still_life,
    studio,
    views,
)  # fmt: skip

TABLES = {
    "accuracy": accuracy.main,
    "ablation": ablation.main,
    "invariance": invariance.main,
    "rest": rest.main,
    "breaks": breaks.main,
    "still_life": still_life.main,
    "dance": dance.main,
    "views": views.main,
    "motion": motion.main,
    "photographs": photographs.main,
    "snakes": snakes.main,
    "speed": speed.main,
    "lines": lines.main,
    "solvers": solvers.main,
    "studio": studio.main,
}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks", description="All tables, one after another.")
    parser.add_argument("--quick", action="store_true", help="fewer shapes and runs")
    parser.add_argument("--out", type=Path, help="folder for the tables as Markdown, a file each")
    chosen = parser.parse_args(arguments)
    start_quietly()
    if chosen.out is not None:
        chosen.out.mkdir(parents=True, exist_ok=True)
    for name, table in TABLES.items():
        print(f"== {name} ==\n", flush=True)
        options = ["--quick"] if chosen.quick else []
        options += [] if chosen.out is None else ["--out", str(chosen.out / f"{name}.md")]
        if status := table(options):
            return status
    return 0


if __name__ == "__main__":
    sys.exit(main())
