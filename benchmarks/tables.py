"""How benchmarks print: tables as text or Markdown, the machine they ran on, the command line that all share."""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import warp as wp

from symseek.device import start_quietly

Headed = list[tuple[str, list[list[str]]]]
"""Headings and tables, whose first row is their head."""


def command(
    arguments: Sequence[str] | None, name: str, about: str, quick: str, run: Callable[[bool], Callable[[bool], str]]
) -> int:
    """Runs a benchmark from the command line: `--quick`, and `--out FILE.md` for its tables.

    Args:
        arguments: of the command line; None: the process' own.
        name, about: of the benchmark.
        quick: what `--quick` leaves out.
        run: measures, quickly or not, and returns what writes the report, as Markdown or as text.

    Returns:
        exit status.
    """
    parser = argparse.ArgumentParser(prog=f"benchmarks.{name}", description=about)
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--out", type=Path, help="file for the tables (.md)")
    chosen = parser.parse_args(arguments)
    start_quietly()
    report = run(chosen.quick)
    print(report(False), flush=True)
    if chosen.out is not None:
        chosen.out.write_text(report(True) + "\n")
    return 0


def as_text(rows: Sequence[Sequence[str]], markdown: bool) -> str:
    """A table whose first row is its head; the first column is text, the others are numbers."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    text = [[row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))] for row in rows]
    if not markdown:
        return "\n".join("  ".join(row) for row in text)
    text.insert(1, ["-" * widths[0], *("-" * max(w - 1, 1) + ":" for w in widths[1:])])
    return "\n".join("| " + " | ".join(row) + " |" for row in text)


def headed(tables: Headed, on: str, markdown: bool) -> str:
    """All tables under their headings, and the machine above them."""
    pieces = [on, ""]
    for heading, table in tables:
        pieces += [("### " if markdown else "") + heading, "", as_text(table, markdown), ""]
    return "\n".join(pieces)


def machine() -> str:
    """What timings were taken on; to be asked for before a benchmark's own work raises the load."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [x.partition(":")[2].strip() for x in info.read_text().splitlines() if x.startswith("model name")]
        name = models[0] if models else name
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    load = f", load before {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return (
        f"{name}, {cores} cores, OMP_NUM_THREADS {threads}{load}; "
        f"Python {platform.python_version()}, Warp {wp.config.version}, numpy {np.__version__}"
    )
