"""`symseek doctor`: what this machine has, and what to do about what it lacks."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from tempfile import TemporaryDirectory

from . import device

PACKAGES = [
    "warp-lang",
    "numpy",
    "scipy",
    "scikit-image",
    "pyrender-maintained",
    "PyOpenGL",
    "trimesh",
    "threadpoolctl",
    "av",
    "pillow",
    "manifold3d",
]


class Missing(Exception):
    """Something is not there; the text says what to do about it."""


def examine() -> int:
    """Print a line for each thing looked at; 0 if all that is needed is there, else 1."""
    checks: list[tuple[str, Callable[[], str]]] = [
        ("Python", _python),
        ("packages", _packages),
        ("Warp", _warp),
        ("Warp's kernel cache", _cache),
        ("OpenGL", _opengl),
        ("video", _video),
        ("text on pictures", _text),
    ]
    lacks = 0
    for name, check in checks:
        try:
            print(f"ok       {name}: {check()}", flush=True)
        except Exception as problem:  # whatever breaks, the other lines are wanted too
            lacks += 1
            print(f"MISSING  {name}: {problem if isinstance(problem, Missing) else repr(problem)}", flush=True)
    print("All that symseek needs is there." if not lacks else f"{lacks} of {len(checks)} need a hand; see above.")
    return 1 if lacks else 0


def versions() -> dict[str, str]:
    """Installed version of each package that symseek stands on, "" where it is not there."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = ""
    return found


def _python() -> str:
    return f"{sys.version.split()[0]} at {sys.executable}"  # an older one could not have imported this


def _packages() -> str:
    found = versions()
    absent = [name for name, number in found.items() if not number]
    if absent:
        raise Missing(f"{', '.join(absent)}; install them: pip install {' '.join(absent)}")
    return ", ".join(f"{name} {number}" for name, number in found.items())


def _warp() -> str:
    import warp as wp

    device.start_quietly()
    return ", ".join(f"{d.alias} ({d.name})" for d in wp.get_devices())


def _cache() -> str:
    folder = device.cache()
    try:
        with TemporaryDirectory(dir=folder):
            pass
    except OSError as problem:
        raise Missing(f"{folder} cannot be written ({problem.strerror}); set WARP_CACHE_PATH to a folder that can") from None
    return f"{folder}, {len(list(folder.iterdir()))} modules"


def _opengl() -> str:
    from .render.platform import describe

    found = describe()
    if not found.works:
        raise Missing(f"{found.problem} {found.remedy}")
    return f"{found.name}: {found.renderer} ({found.vendor})"


def _video() -> str:
    import av
    import numpy as np

    from .render.video import write_mp4

    if "libx264" not in av.codecs_available:
        raise Missing("PyAV has no libx264; install its own wheel: pip install --force-reinstall av")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "trial.mp4"
        write_mp4(path, [np.zeros((32, 32, 3), np.uint8)] * 3)
        return f"H.264 by libx264 in PyAV {av.__version__}, trial of {path.stat().st_size} bytes"


def _text() -> str:
    from PIL import features

    if not features.check("freetype2"):
        raise Missing("Pillow has no FreeType; install its own wheel: pip install --force-reinstall pillow")
    return f"Pillow's own font, FreeType {features.version('freetype2')}"
