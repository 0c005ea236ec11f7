"""The one place that touches pyrender and OpenGL: coloured triangles in, pixels out."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from .platform import RenderError, check_bound, choose

EYE = 4.0  # distance of the eye from the origin; near and far planes lie 3 either side of the origin
_NEAR, _FAR = EYE - 3.0, EYE + 3.0

Box = tuple[int, int, int, int]
"""(left, top, right, bottom), px; the last two are not included."""


class Surface:
    """An off-screen drawing surface of a fixed size in pixels, with an orthographic camera on the z axis.

    Raises:
        RenderError: no OpenGL context can be had; the message names the platform and the remedy.
    """

    def __init__(self, width: int, height: int):
        name = choose()
        check_bound(name)
        self.width, self.height = width, height
        try:
            self._platform = _context(name, width, height)
            self._open()
        except Exception as error:  # each way of lacking OpenGL raises an exception of its own
            raise RenderError(f"no OpenGL on platform {name!r} ({type(error).__name__}: {error})") from error

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

    def draw(
        self,
        positions: np.ndarray,
        colours: np.ndarray,
        triangles: np.ndarray,
        reach: float,
        box: Box,
        culled: bool = True,
    ) -> np.ndarray:
        """Draw triangles that turn counter-clockwise to the eye.

        Args:
            positions: shape (V, 3), x right, y up, z toward the eye; seen where |z| < 3.
            colours: shape (V, 3), in [0, 1].
            triangles: shape (F, 3).
            reach: from the middle of the picture to its nearer edge.
            culled: leave out those that turn clockwise; else draw all.
            box: the part wanted, (left, top, right, bottom) px; reading all of it takes as long as drawing.

        Returns:
            Colours premultiplied by coverage, shape (bottom - top, right - left, 4), uint8.
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
            flags = self._flags if culled else self._flags | pyrender.RenderFlags.SKIP_CULL_FACES
            drawn: Any = self._renderer.render(self._scene, flags)
        finally:
            self._scene.remove_node(node)
        if not self._framebuffer:
            return self._read_colours(box)
        self._depth = drawn[1]
        left, top, right, bottom = box
        return drawn[0][top:bottom, left:right]

    def depth(self) -> np.ndarray:
        """-z of the last drawing, shape (H, W): how far behind the origin; infinite where nothing is."""
        self._platform.make_current()
        raw = self._depth if self._framebuffer else self._renderer.read_depth_buf()
        # pyrender unrolls the buffer as if for a perspective camera: take that back, then unroll it for ours
        with np.errstate(divide="ignore"):
            buffer = (_FAR + _NEAR - 2 * _FAR * _NEAR / raw) / (_FAR - _NEAR)
        return np.where(raw == 0, np.inf, _NEAR + (_FAR - _NEAR) * (buffer + 1) / 2 - EYE)

    def identity(self) -> tuple[str, str]:
        """GL_VENDOR and GL_RENDERER."""
        from OpenGL import GL

        self._platform.make_current()
        vendor, renderer = (GL.glGetString(name) or b"" for name in (GL.GL_VENDOR, GL.GL_RENDERER))
        return vendor.decode(), renderer.decode()

    def close(self) -> None:
        """Free the context and all it holds."""
        self._platform.make_current()
        self._renderer.delete()
        self._platform.delete_context()

    def _read_colours(self, box: Box) -> np.ndarray:
        from OpenGL import GL

        left, top, right, bottom = box
        pixels = np.empty((bottom - top, right - left, 4), np.uint8)
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, 0)
        low = self.height - bottom  # OpenGL counts rows from below
        GL.glReadPixels(left, low, right - left, bottom - top, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, array=pixels)
        return pixels[::-1]


def _context(name: str, width: int, height: int) -> Any:
    """Pyrender's own platform object."""
    if name == "osmesa":
        from pyrender.platforms.osmesa import OSMesaPlatform

        return OSMesaPlatform(width, height)
    if name == "egl":
        from pyrender.platforms.egl import EGLPlatform, get_device_by_index

        return EGLPlatform(width, height, get_device_by_index(int(os.environ.get("EGL_DEVICE_ID", "0"))))
    raise ValueError("only osmesa and egl draw without a window")


def _programs() -> Any:
    """A cache of shader programs that hits.

    pyrender's own is keyed by the OpenGL context, under OSMesa a new ctypes pointer at each call, equal to no
    other: every frame compiles its shaders again, takes longer and leaks 3 MB. One renderer has one context:
    leave it out.
    """
    from pyrender.shader_program import ShaderProgram, ShaderProgramCache

    class Programs(ShaderProgramCache):
        def get_program(self, vertex_shader, fragment_shader, geometry_shader=None, defines=None):
            shaders = (vertex_shader, fragment_shader, geometry_shader)
            key = (*shaders, *sorted((defines or {}).items()))
            if key not in self._program_cache:
                files = [shader and f"{self.shader_dir}/{shader}" for shader in shaders]
                self._program_cache[key] = ShaderProgram(*files, defines=defines)
            return self._program_cache[key]

    return Programs()
