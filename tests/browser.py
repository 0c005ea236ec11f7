"""A studio with a page in a real browser, for tests and timings: headless Chromium, WebGL in software."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from PIL import Image

from symseek.sim.curve import evenly
from symseek.sim.surface import occluding_contour
from symseek.studio.serve import Studio

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PICTURES = os.environ.get("SYMSEEK_PICTURES")
"""A folder for screenshots of each step of the tests."""
WINDOW = {"width": 1000, "height": 640}


def chromium() -> str | None:
    """Path of the browser, None without one or without playwright."""
    try:
        import playwright  # noqa: F401
    except ImportError:
        return None
    return next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)


class Hand:
    """A person at the page.

    Args:
        studio: that serves it.
        page: of playwright.
    """

    def __init__(self, studio: Studio, page: Any):
        self.studio, self.page = studio, page

    def at(self, place: Sequence[float] | np.ndarray) -> tuple[float, float]:
        """Where in the window an image point (column, row) lies, through the camera."""
        camera = next(iter(self.studio.server.get_clients().values())).camera
        box = self.page.locator("canvas").first.bounding_box()
        zoom = box["height"] / (2 * abs(camera.position[2]) * np.tan(camera.fov / 2))
        x, y = (np.asarray(place) - camera.position[:2]) * zoom
        return box["x"] + box["width"] / 2 + x, box["y"] + box["height"] / 2 + y

    def click(self, place: Sequence[float] | np.ndarray) -> None:
        """Clicks on an image point, and waits until that is a step of the session."""
        session = self.studio.page.session
        assert session is not None
        before = session.state
        self.page.mouse.click(*self.at(place))
        self.wait(lambda: session.state is not before)
        with self.studio.page.lock:  # the engine has heard of it
            pass
        self.page.wait_for_timeout(250)  # two clicks at once are a double click

    def in_space(self, point: Sequence[float] | np.ndarray) -> tuple[float, float]:
        """Where in the window a point of the viewer's space lies."""
        camera = next(iter(self.studio.server.get_clients().values())).camera
        box = self.page.locator("canvas").first.bounding_box()
        eye, up = np.array(camera.position), np.array(camera.up_direction)
        ahead = camera.look_at - eye
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, up)
        right /= np.linalg.norm(right)
        way = np.asarray(point) - eye
        zoom = box["height"] / (2 * np.tan(camera.fov / 2)) / (way @ ahead)
        x, y = zoom * (way @ right), -zoom * (way @ np.cross(right, ahead))
        return box["x"] + box["width"] / 2 + x, box["y"] + box["height"] / 2 + y

    def steady(self) -> None:
        """Waits until the eye stands where the panel leaves it room."""
        fitted = self.studio.page.eyes.fitted
        camera = next(iter(self.studio.server.get_clients().values())).camera
        box, same = self.page.locator("canvas").first, 0

        def stands() -> bool:
            nonlocal same
            size, (aspect, _) = box.bounding_box(), next(iter(fitted.values()), (0.0, None))
            fits = abs(size["width"] / size["height"] - camera.aspect) < 0.01 and abs(aspect - camera.aspect) < 0.02
            same = same + 1 if fits else 0
            return same > 10

        self.wait(lambda: not self.studio.page.session or stands())

    def press(self, button: str) -> None:
        """Clicks a button by its words."""
        self.page.get_by_role("button", name=button, exact=True).click()

    def drag(
        self, a: Sequence[float] | np.ndarray, b: Sequence[float] | np.ndarray, steps: int = 20, space: bool = False
    ) -> None:
        """Takes the mouse from one image point, or point in space, to another and holds it there."""
        where = self.in_space if space else self.at
        a, b = np.array(where(a)), np.array(where(b))
        self.page.mouse.move(*a)
        self.page.mouse.down()
        for k in range(1, steps + 1):
            self.page.mouse.move(*(a + (b - a) * k / steps))
            time.sleep(0.02)

    def let_go(self) -> None:
        """Lets the mouse go."""
        self.page.mouse.up()

    def wait(self, until: Callable[[], Any], seconds: float = 30.0) -> None:
        """Waits for something to be so.

        Raises:
            TimeoutError: it is not in time.
        """
        end = time.monotonic() + seconds
        while not until():
            if time.monotonic() > end:
                raise TimeoutError(f"after {seconds} s: {self.studio.page.told}")
            self.page.wait_for_timeout(30)

    def shot(self, name: str) -> None:
        """A picture of the page, where somebody wants to look at them."""
        if PICTURES:
            self.page.wait_for_timeout(500)
            self.page.screenshot(path=Path(PICTURES, f"{name}.png"))

    def choose(self, label: str, option: str) -> None:
        """Takes an option of a dropdown."""
        field = self.page.get_by_label(label, exact=True).or_(self.page.get_by_role("textbox", name=label)).first
        field.click()
        chosen = self.page.get_by_role("option", name=option, exact=True)
        chosen.click()
        chosen.wait_for(state="hidden")
        self.wait(lambda: field.input_value() == option)
        self.steady()

    def at_rest(self) -> None:
        """Waits until all models have been told to run and nothing moves."""
        engine = self.studio.engine
        with self.studio.page.lock:  # the engine has heard of what was done last
            pass
        self.wait(lambda: engine.snapshots and all(part.go for part in list(engine._parts.values())))
        self.wait(lambda: not engine.call(engine.going).result(60), 60.0)


@contextmanager
def opened(paths: Sequence[str], root: Path, script: str = "", **window: Any) -> Iterator[Hand]:
    """A studio and its page, ready to be used.

    Args:
        paths: what to open.
        root: folder of the studio.
        script: to run in the page before its own.
        window: options of playwright's new_context.
    """
    from playwright.sync_api import sync_playwright

    studio = Studio(paths, root, port=0)
    try:
        with sync_playwright() as p, mock.patch.object(studio.page, "tell", wraps=studio.page.tell) as told:
            browser = p.chromium.launch(executable_path=chromium(), args=FLAGS)
            page = browser.new_context(**{"viewport": WINDOW, **window}).new_page()
            page.add_init_script(script)
            page.goto(studio.address)
            hand = Hand(studio, page)
            hand.wait(lambda: studio.server.get_clients())
            page.wait_for_selector("canvas")
            # viser's own warning of software rendering lies over the picture
            page.locator(".mantine-Notification-closeButton").first.click()
            hand.steady()
            yield hand
            browser.close()
            assert not [said for said in told.call_args_list if "fault" in said.args[0]]
    finally:
        studio.close()


def contour(hand: Hand, fine: int = 6000, v: int = 0) -> np.ndarray:
    """Points of the model's contour in view v, close together."""
    session = hand.studio.page.session
    assert session is not None
    (s,) = hand.studio.engine.snapshots.values()
    return np.concatenate([evenly(p, fine, False) for p, _ in occluding_contour(s.tube, session.views[v].camera)])


def gap(a: np.ndarray, b: np.ndarray) -> float:
    """Longest way [px] from a point of a to the next of b."""
    return float(max(np.linalg.norm(p - b, axis=1).min() for p in a[::20]))


def pixels(hand: Hand) -> np.ndarray:
    """The page's picture, shape (h, w, 3)."""
    return np.asarray(Image.open(BytesIO(hand.page.locator("canvas").first.screenshot())).convert("RGB")).astype(int)
