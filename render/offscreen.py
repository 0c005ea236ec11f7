"""The one place that touches pyrender and OpenGL: coloured triangles in, pixels out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from .platform import REMEDY, RenderError, choose

EYE = 4.0  # distance of the eye from the origin; near and far planes lie 3 either side of the origin
_NEAR, _FAR = EYE - 3.0, EYE + 3.0


class Surface:
    """An off-screen drawing surface of a fixed size in pixels, with an orthographic camera on the z axis.

    Raises:
        RenderError: no OpenGL context can be had; the message names the platform and the remedy.
    """

    def __init__(self, width: int, height: int):
        name = choose()
        self.width, self.height = width, height
        try:
            self._platform = _context(name, width, height)
            self._open()
        except Exception as error:  # each way of lacking OpenGL raises an exception of its own
            raise RenderError(f"no OpenGL on platform {name!r} ({type(error).__name__}: {error}). {REMEDY}") from error

    def _open(self) -> None:
        import pyrender
        from pyrender.renderer import Renderer

        self._platform.init_context()
        self._platform.make_current()
        self._renderer = Renderer(self.width, self.height)
        self._renderer._program_cache = _programs()
        self._framebuffer = self._platform.supports_framebuffers()
        self._flags = pyrender.RenderFlags.FLAT
        if self._framebuffer:
            self._flags |= pyrender.RenderFlags.OFFSCREEN | pyrender.RenderFlags.RGBA
        self._scene = pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 0.0])
        self._camera = pyrender.OrthographicCamera(1.0, 1.0, znear=_NEAR, zfar=_FAR)
        pose = np.eye(4)
        pose[2, 3] = EYE
        self._scene.add(self._camera, pose=pose)
        self._material = pyrender.MetallicRoughnessMaterial(baseColorFactor=[1.0, 1.0, 1.0, 1.0])

    def draw(self, positions: np.ndarray, colours: np.ndarray, triangles: np.ndarray, reach: float) -> Image.Image:
        """Draw triangles that turn counter-clockwise to the eye.

        Args:
            positions: shape (V, 3), x right, y up, z toward the eye; seen where |z| < 3.
            colours: shape (V, 3), in [0, 1].
            triangles: shape (F, 3).
            reach: from the middle of the picture to its nearer edge.

        Returns:
            Colours premultiplied by coverage, mode "RGBa".
        """
        import pyrender

        opaque = np.column_stack([colours, np.ones(len(colours))])
        primitive = pyrender.Primitive(
            positions=positions, color_0=opaque, indices=triangles, mode=4, material=self._material
        )
        node = self._scene.add(pyrender.Mesh([primitive]))
        # pyrender takes ymag and the picture's aspect; xmag follows
        self._camera.ymag = reach * max(1.0, self.height / self.width)
        try:
            self._platform.make_current()
            drawn = self._renderer.render(self._scene, self._flags)
        finally:
            self._scene.remove_node(node)
        self._drawn_depth = drawn[1] if self._framebuffer else None
        pixels = drawn[0] if self._framebuffer else self._read_colours()
        return Image.frombuffer("RGBa", (self.width, self.height), np.ascontiguousarray(pixels), "raw", "RGBa", 0, 1)

    def depth(self) -> np.ndarray:
        """Distances of the last drawing, shape (H, W): z below the origin's plane, infinite where nothing is."""
        self._platform.make_current()
        raw = self._renderer.read_depth_buf() if self._drawn_depth is None else self._drawn_depth
        # pyrender unrolls the buffer as if for a perspective camera: take that back, then unroll it for ours
        with np.errstate(divide="ignore"):
            buffer = (_FAR + _NEAR - 2 * _FAR * _NEAR / raw) / (_FAR - _NEAR)
        return np.where(raw == 0, np.inf, _NEAR + (_FAR - _NEAR) * (buffer + 1) / 2 - EYE)

    def identity(self) -> tuple[str, str]:
        """GL_VENDOR and GL_RENDERER."""
        from OpenGL import GL

        self._platform.make_current()
        return GL.glGetString(GL.GL_VENDOR).decode(), GL.glGetString(GL.GL_RENDERER).decode()

    def close(self) -> None:
        """Free the context and all it holds."""
        self._platform.make_current()
        self._renderer.delete()
        self._platform.delete_context()

    def _read_colours(self) -> np.ndarray:
        from OpenGL import GL

        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, 0)
        raw = GL.glReadPixels(0, 0, self.width, self.height, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE)
        return np.frombuffer(raw, np.uint8).reshape(self.height, self.width, 4)[::-1]


def _context(name: str, width: int, height: int) -> Any:
    """pyrender's own platform object."""
    if name == "osmesa":
        from pyrender.platforms.osmesa import OSMesaPlatform

        return OSMesaPlatform(width, height)
    if name == "egl":
        from pyrender.platforms.egl import EGLPlatform

        return EGLPlatform(width, height)
    raise ValueError("only osmesa and egl draw without a window")


def _programs() -> Any:
    """A cache of shader programs that hits.

    pyrender's own is keyed by the OpenGL context, which under OSMesa is a ctypes pointer and never equals itself:
    every frame compiles its shaders again, takes longer and leaks 3 MB. One renderer has one context: leave it out.
    """
    from pyrender.shader_program import ShaderProgram, ShaderProgramCache

    class Programs(ShaderProgramCache):
        def get_program(
            self, vertex_shader: str, fragment_shader: str, geometry_shader: str | None = None, defines: Any = None
        ) -> Any:
            key = (vertex_shader, fragment_shader, geometry_shader, *sorted((defines or {}).items()))
            if key not in self._program_cache:
                files = [
                    shader and str(Path(self.shader_dir) / shader)
                    for shader in (vertex_shader, fragment_shader, geometry_shader)
                ]
                self._program_cache[key] = ShaderProgram(*files, defines=defines)
            return self._program_cache[key]

    return Programs()
