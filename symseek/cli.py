"""The command line: `symseek run`, `symseek batch`, `symseek demo`, `symseek studio`, `symseek doctor`.

Exit status 0 done, 2 the input is at fault, 1 anything else. Heavy imports wait until a command needs them.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from . import __version__

if TYPE_CHECKING:
    from .pipeline import Result
    from .sim.reconstruct import Progress
    from .sim.track import Shown

DEMOS = Path(__file__).resolve().parent / "scenes"
DEMO_DEFAULT = "squash"
MANY = 4
"""Objects above which the summary has a line for each rather than a column."""
_interrupted = threading.Event()
IMAGES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".npy"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, of the process or as given; returns the exit status."""
    if arguments is None:  # the process is ours: a plain kill cleans up as ^C does
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, interrupt)
    options = _parser().parse_args(arguments)
    try:
        if options.command == "doctor":
            from .doctor import examine

            return examine()
        if options.command == "batch":
            return _batch(options)
        if options.command == "studio":
            return _studio(options)
        return _demo(options) if options.command == "demo" else _run(options, options.scene)
    except KeyboardInterrupt:
        print("\nsymseek: interrupted, nothing written", file=sys.stderr)
        return 1
    except BrokenPipeError:  # the reader of our output has gone
        sys.stderr.close()
        return 1


def interrupt(number: int, frame: FrameType | None) -> None:
    """Ends the run, now or, where a destructor swallows the exception, at the next `Show.progress`."""
    _interrupted.set()
    raise KeyboardInterrupt


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="symseek",
        description="From a photograph and a rough axis to a watertight, measured 3D model.",
        epilog="Exit status: 0 done, 2 the input is at fault, 1 anything else.",
    )
    parser.add_argument("--version", action="version", version=f"symseek {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    run = commands.add_parser("run", help="reconstruct a scene file", description="Reconstruct a scene file.")
    run.add_argument("scene", metavar="SCENE", help="a TOML file, or a folder that holds scene.toml")
    batch = commands.add_parser(
        "batch",
        help="reconstruct many images by one scene file",
        description="Reconstruct the objects of a scene file in each of many images; measures go to DIR/batch.csv.",
    )
    batch.add_argument("scene", metavar="SCENE", help="a TOML file; each image takes the place of its first view's")
    batch.add_argument("images", metavar="IMAGE", nargs="+", type=Path, help="images, or folders of them")
    batch.add_argument("--axes", metavar="FILE", type=Path, help="CSV of rough axes: image,object,x,y, a line a point")
    batch.add_argument("--processes", metavar="N", type=int, help="how many at a time (default: one a core)")
    demo = commands.add_parser(
        "demo", help="run a scene that ships with symseek", description="Run a scene that ships with symseek."
    )
    demo.add_argument("scene", metavar="NAME", nargs="?", default=DEMO_DEFAULT, help=f"default: {DEMO_DEFAULT}")
    demo.add_argument("--list", action="store_true", help="list the scenes and stop")
    studio = commands.add_parser(
        "studio",
        help="draw, pull and watch models in the browser",
        description="Draw axes over an image in the browser, watch models grow onto it, pull them and keep the scene.",
    )
    studio.add_argument(
        "paths",
        metavar="SCENE | IMAGE",
        nargs="*",
        help="what to open, two images as a stereo pair; below the working folder",
    )
    studio.add_argument("--host", default="127.0.0.1", help="listen elsewhere, then with a token (default: 127.0.0.1)")
    studio.add_argument("--port", type=int, default=8080, help="default: 8080, or the next that is free")
    studio.add_argument("--device", default="cpu", help="Warp device: cpu, cuda:0 (default: cpu)")
    for command in (run, demo, batch):
        command.add_argument("--out", metavar="DIR", type=Path, help="folder for the results (default: out/NAME)")
        command.add_argument("--device", default="cpu", help="Warp device: cpu, cuda:0 (default: cpu)")
        command.add_argument(
            "--set",
            metavar="KEY=VALUE",
            action="append",
            default=[],
            help="change a key of the scene file, like solver.scheme=euler; may be repeated",
        )
        command.add_argument("--quiet", action="store_true", help="print nothing but errors")
    for command in (run, demo):
        command.add_argument("--no-video", action="store_true", help="leave the video out")
        command.add_argument(
            "--resume", action="store_true", help="go on with a moving scene from the last whole frame of a stopped run"
        )
    commands.add_parser("doctor", help="what this machine has and lacks", description="Say what this machine has and lacks.")
    return parser


def demos() -> dict[str, Path]:
    """Scene files that ship with the package, by name."""
    return {path.parent.name: path for path in sorted(DEMOS.glob("*/scene.toml"))}


def _demo(options: argparse.Namespace) -> int:
    known = demos()
    if options.list:
        for name, path in known.items():
            print(f"{name:12} {_about(path)}")
        return 0
    if options.scene not in known:
        print(f"symseek: there is no demo {options.scene!r}; choose one of {', '.join(known)}", file=sys.stderr)
        return 2
    return _run(options, str(known[options.scene]))


def _about(path: Path) -> str:
    """The first comment of a scene file."""
    first = path.read_text(encoding="utf-8").split("\n", 1)[0]
    return first.lstrip("# ").strip() if first.startswith("#") else ""


def _run(options: argparse.Namespace, scene: str) -> int:
    overrides = options.set + (["output.video=false"] if options.no_video else [])
    show = Show(options.quiet)
    show.line(f"symseek {__version__}: {scene}")
    from . import device
    from .checks import SceneError
    from .pipeline import run

    device.start_quietly()
    if not device.kernels_compiled():
        show.line("compiling kernels, once on this machine ...")
    try:
        result = run(
            scene,
            options.out,
            options.device,
            overrides=overrides,
            callback=show.progress,
            every=10,
            tell=show.line,
            resume=options.resume,
        )
    except SceneError as problem:
        show.end()
        print(f"symseek: {problem}", file=sys.stderr)
        return 2
    except (OSError, MemoryError, RuntimeError) as problem:  # the machine's; a fault of ours is shown whole
        show.end()
        print(f"symseek: {type(problem).__name__}: {problem}; see `symseek doctor`", file=sys.stderr)
        return 1
    show.end()
    if not options.quiet:
        print(summary(result))
    for name, reason in result.skipped.items():
        print(f"symseek: {name} was not written: {reason}", file=sys.stderr)
    return 1 if result.skipped else 0


def _batch(options: argparse.Namespace) -> int:
    from .checks import SceneError
    from .many import Entry, batch

    images: list[Path] = []
    for path in options.images:
        images += sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGES) if path.is_dir() else [path]

    def tell(entry: Entry) -> None:
        if entry.error:
            print(f"symseek: {entry.error}", file=sys.stderr, flush=True)
        elif not options.quiet:
            doubts = [f"{row['object']}: {row['warnings']}" for row in entry.objects if not row["trusted"]]
            print(f"{entry.image}: {'DO NOT TRUST ' + ' / '.join(doubts) if doubts else 'done'}", flush=True)

    try:
        if not images:
            raise SceneError(str(options.images[0]), "", "holds no image", f"images end in {', '.join(sorted(IMAGES))}")
        found = batch(
            options.scene, images, options.out, options.device,
            axes=options.axes, overrides=options.set, processes=options.processes, callback=tell,
        )  # fmt: skip
    except SceneError as problem:
        print(f"symseek: {problem}", file=sys.stderr)
        return 2
    if not options.quiet:
        bad = sum(bool(entry.error) for entry in found)
        print(f"{len(found) - bad} of {len(found)} images reconstructed, {sum(e.trusted for e in found)} of them trusted")
    return 2 if any(entry.error for entry in found) else 0


def _studio(options: argparse.Namespace) -> int:
    try:
        import viser  # noqa: F401
    except ImportError:
        print("symseek: the studio needs viser: pip install 'symseek[studio]'", file=sys.stderr)
        return 1
    from .checks import SceneError
    from .studio.serve import serve

    try:
        serve(options.paths, options.host, options.port, options.device, lambda text: print(text, flush=True))
    except SceneError as problem:
        print(f"symseek: {problem}", file=sys.stderr)
        return 2
    return 0


class Show:
    """Progress: one moving line on a terminal, a plain line for each stage elsewhere."""

    def __init__(self, quiet: bool):
        self.quiet = quiet
        self.terminal = sys.stdout.isatty()
        self.stage: object = None
        self.last = 0.0
        self.open = False

    def progress(self, p: Progress | Shown) -> None:
        if _interrupted.is_set():
            raise KeyboardInterrupt
        if self.quiet:
            return
        from .sim.track import Shown

        if isinstance(p, Shown):
            self._frame(p)
            return
        text = f"stage {p.stage + 1}, sigma {p.sigma:.1f} px: iteration {p.iteration}"
        if p.residual < math.inf:
            text += f", residual {p.residual:.1e}"
        now = time.monotonic()
        if self.terminal and now - self.last > 0.05:
            self.last, self.open = now, True
            filled = round(20 * min(1.0, p.iteration / max(p.total, 1)))
            print(f"\r[{'#' * filled}{'-' * (20 - filled)}] {text}\x1b[K", end="", flush=True)
        elif not self.terminal and p.stage != self.stage:
            self.stage = p.stage
            print(text, flush=True)

    def _frame(self, p: Shown) -> None:
        lost = ", ".join(f.scene.tubes[0].name for f in p.followers if f.lost)
        text = f"frame {p.frame}{f': {lost} lost' * bool(lost)}"
        if self.terminal:
            self.open = True
            print(f"\r{text}\x1b[K", end="", flush=True)
        elif lost or p.frame % 10 == 0:
            print(text, flush=True)

    def line(self, text: str) -> None:
        self.end()
        if not self.quiet:
            print(text, flush=True)

    def end(self) -> None:
        """Leave the moving line."""
        if self.open:
            print()
            self.open = False


def summary(result: Result) -> str:
    """Measures, times, warnings and files of a run, as text for a terminal."""
    unit = result.scene.units
    objects = [*result.objects, *result.lines]
    rows = {"": [o.name for o in objects]}
    for title, key, form in (
        ("length", "length", f"{{:.5g}} {unit}"),
        ("largest radius", "radius", f"{{:.5g}} {unit}"),
        ("surface area" if result.objects else "area", "area", f"{{:.5g}} {unit}^2"),
        ("volume", "volume", f"{{:.5g}} {unit}^3"),
        ("asymmetry", "asymmetry", "{:.2%}"),
        ("contour to edge, mean", "contour_residual_px", "{:.2f} px"),
        ("contour supported", "supported_share", "{:.0%}"),
    ):
        cells = [_cell(o.measures, key, form) for o in objects]
        if any(cells):
            rows[title] = cells
    rows["iterations"] = [f"{o.iterations}{'' if o.converged else ' (not at rest)'}" for o in objects]
    rows["trusted"] = ["yes" if o.trusted else "NO" for o in objects]
    table = [[title, *cells] for title, cells in rows.items()]
    if len(objects) > MANY:
        table = list(zip(*table, strict=True))
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lined = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
    lines = ["", *lined, ""]
    for f in result.figures:
        solid = "one solid" if len(f.pieces) == 1 else f"NOT one solid, {len(f.pieces)} pieces"
        lines.append(f"{f.name}: {len(f.tubes)} tubes, {solid}, volume {f.volume:.5g} {unit}^3, area {f.area:.5g} {unit}^2")
        lines += [f"    {f.name}: {warning}" for warning in f.warnings]
    lines.append("seconds: " + ", ".join(f"{phase} {s:.2f}" for phase, s in result.seconds.items()))
    for o in objects:
        if not o.trusted:
            lines += ["", f"*** DO NOT TRUST {o.name!r} ***"]
        lines += [f"    {o.name}: {warning}" for warning in o.warnings]
    if result.files:
        folder = result.files[0].parent
        names, more = [f.name for f in result.files], len(result.files) - 8 * MANY
        names = [*names[: 8 * MANY], *([f"and {more} more"] if more > 0 else [])]
        lines += ["", f"written to {folder}: {', '.join(names)}"]
    return "\n".join(lines)


def _cell(measures: dict[str, Any], key: str, form: str) -> str:
    """A measure as text: the largest of a list, the mean where there are several; empty where there is none."""
    value = measures.get(key)
    if isinstance(value, dict):
        value = value["mean"]
    return "" if value is None else form.format(max(value) if isinstance(value, list) else value)
