"""Choice of pyrender's OpenGL platform; call `choose` before pyrender or OpenGL is imported."""

from __future__ import annotations

import ctypes
import os
import sys
from ctypes.util import find_library
from dataclasses import dataclass

VARIABLE = "PYOPENGL_PLATFORM"
OFFSCREEN = ("osmesa", "egl")
"""The platforms that draw without a window."""

REMEDY = (
    "Install Mesa's off-screen library (Debian, Ubuntu: apt install libosmesa6; Mesa 25.1 and later have EGL "
    f"only: apt install libegl1 libgl1-mesa-dri), or set {VARIABLE} to osmesa or egl. Shapes and measures "
    "need no OpenGL, only the shaded pictures and the video do."
)


class RenderError(RuntimeError):
    """OpenGL is not to be had; the message says why and what to do about it."""

    def __init__(self, problem: str, remedy: str = REMEDY):
        super().__init__(f"{problem}. {remedy}")
        self.problem, self.remedy = problem, remedy


@dataclass(frozen=True)
class PlatformReport:
    """What OpenGL there is on this machine."""

    name: str
    """value of PYOPENGL_PLATFORM in force, "osmesa" or "egl" unless the user set another."""
    works: bool
    """whether a context could be made."""
    vendor: str
    """GL_VENDOR, empty if none works."""
    renderer: str
    """GL_RENDERER, empty if none works."""
    problem: str
    """what went wrong, empty if it works."""
    remedy: str
    """what to do about it, empty if it works."""


def choose() -> str:
    """Set the platform and return its name: the user's own, else osmesa where its library loads, else egl."""
    if not os.environ.get(VARIABLE):
        os.environ[VARIABLE] = "osmesa" if _loads("OSMesa") else "egl"
    return os.environ[VARIABLE]


def check_bound(name: str) -> None:
    """Make sure that PyOpenGL, if it was imported already, took this platform: it never changes its mind.

    Raises:
        RenderError: it took another one.
    """
    loaded = sys.modules.get("OpenGL.platform")
    taken = type(getattr(loaded, "PLATFORM", None)).__name__.removesuffix("Platform").lower()
    if loaded is not None and taken != name:
        remedy = f"Set {VARIABLE}={name} in the environment, or call symseek.render.platform.choose() first."
        raise RenderError(f"OpenGL was imported earlier, on platform {taken!r} instead of {name!r}", remedy)


def describe() -> PlatformReport:
    """Try to draw on the chosen platform and say what was found; never raises."""
    from .raster import Renderer

    name = choose()
    try:
        with Renderer(16, 16) as renderer:
            vendor, model = renderer.identity()
    except RenderError as error:
        return PlatformReport(name, False, "", "", error.problem, error.remedy)
    return PlatformReport(name, True, vendor, model, "", "")


def _loads(library: str) -> bool:
    """Whether PyOpenGL will find a library: it tries these names in turn, so a bare libOSMesa.so.8 counts."""
    if sys.platform.startswith("linux"):
        names = [f"lib{library}.so", *(f"lib{library}.so.{version}" for version in range(9, -1, -1))]
    else:
        names = [found] if (found := find_library(library)) else []
    return any(_opens(name) for name in names)


def _opens(name: str) -> bool:
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True
