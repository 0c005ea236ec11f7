"""Where the windows' eyes stand: through a scene's camera, or beside the models in space."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import viser

from .drawing import WINDOW

if TYPE_CHECKING:
    from .page import Page

FOV = 0.4
"""Of the viewer's eye through the scene's camera [rad]."""
MARGIN = 1.06
"""Of the view around the photograph."""
ASIDE = 1.15 * np.array([0.55, -0.35, -0.76])
"""From the photograph's middle to the eye that sees the models in space, beside its distance through the camera."""
TALL = 0.7
"""Aspect of a window from which on a photograph stands at its top: on a telephone the panel lies over the lower part."""


def away(size: np.ndarray, aspect: float) -> float:
    """How far before a photograph (width, height) an eye sees all of it."""
    width, height = size
    return float(MARGIN * max(height, width / aspect) / (2 * np.tan(FOV / 2)))


def middle(size: np.ndarray) -> np.ndarray:
    """Of a photograph (width, height), in the viewer's space."""
    return np.array([*(np.asarray(size) - 1) / 2, 0.0])


class Eyes:
    """Of all windows.

    Args:
        page: with the drawing that they look at.

    Attributes:
        fitted: for which aspect each window's eye was put where.
    """

    def __init__(self, page: Page):
        self.page = page
        self.fitted: dict[int, tuple[float, np.ndarray]] = {}

    def welcome(self, client: viser.ClientHandle) -> None:
        """Puts a new window's eye in its place and keeps it there while the window changes its shape."""
        self.page.attempt(lambda: self.through_camera(client))
        self.page.refresh()

        @client.camera.on_update
        async def _(camera: viser.CameraHandle) -> None:
            set_for, place = self.fitted.get(client.client_id, (camera.aspect, camera.position))
            untouched = np.abs(camera.position - place).max() < 1e-3 * np.abs(place).max()
            if (
                untouched and not self.page.in_space and abs(camera.aspect / set_for - 1) > 0.01
            ):  # a panel takes its room, say
                self.page.attempt(lambda: self.through_camera(client))
            self._sees(camera)

    def _sees(self, camera: viser.CameraHandle) -> None:
        """Has lines drawn as thick as they are to be for an eye."""
        drawing = self.page.drawing
        if drawing is not None and drawing.seen_from(camera.position, camera.fov, camera.image_height or WINDOW):
            self.page.draw_anew()

    def through_camera(self, client: viser.ClientHandle) -> None:
        """Puts a window's eye where the whole photograph fills it; of a tall one the upper part."""
        drawing = self.page.drawing
        if drawing is None:
            return
        aspect = client.camera.aspect or 1.5
        out, at = away(drawing.size, aspect), middle(drawing.size)
        if aspect < TALL:
            at[1] += max(0.0, out * np.tan(FOV / 2) - 0.5 * MARGIN * drawing.size[1])
        with client.atomic():
            camera = client.camera
            camera.near, camera.far, camera.fov = 0.01 * out, 20 * out, FOV
            camera.up_direction = (0.0, -1.0, 0.0)
            camera.position, camera.look_at = at - [0, 0, out], at
        self.fitted[client.client_id] = aspect, at - [0, 0, out]
        self._sees(client.camera)

    def look(self, client: viser.ClientHandle, in_space: bool) -> None:
        """Through the camera, or at the models in space before the photograph."""
        self.through_camera(client)
        if in_space and self.page.drawing is not None:
            with client.atomic():
                at = client.camera.look_at
                client.camera.position = at + np.linalg.norm(at - client.camera.position) * ASIDE
                client.camera.look_at = at
