"""A stereo pair and a moving scene in a real browser: drawn and pulled in the second view, tracked, and put right."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from PIL import Image

import symseek
from symseek import cli
from tests.browser import Hand, chromium, contour, opened

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium: on Debian `make test` installs it")
FINGER = cli.demos()["finger"]


def right_edge(hand: Hand, v: int) -> np.ndarray:
    """The rightmost place of the model's middle in view v."""
    session = hand.studio.page.session
    assert session is not None
    (s,) = hand.studio.engine.snapshots.values()
    seen = session.views[v].camera.project(s.tube[:, 12])
    return seen[seen[:, 0].argmax()]


def rightmost(contour: np.ndarray, row: float) -> float:
    """Column of the contour's right side at a row."""
    return contour[np.abs(contour[:, 1] - row) < 1.0, 0].max()


def pull(hand: Hand, v: int, way: float) -> None:
    """Takes the right edge out by some pixels, sees it follow, and lets go."""
    session, edge = hand.studio.page.session, right_edge(hand, v)
    assert session is not None
    hand.drag(edge, edge + np.array([way, 0.0]), 8)
    hand.wait(lambda: right_edge(hand, v)[0] > edge[0] + 0.8 * way)
    hand.shot(f"{session.name}-pulled")
    hand.let_go()
    hand.wait(lambda: session.can_undo == "a pull")


def test_a_pair_and_then_a_film(tmp_path):
    scene = symseek.load(FINGER)
    for view in scene.views:
        Image.fromarray(np.rint(255 * view.image).astype(np.uint8)).save(tmp_path / f"{view.name}.png")
    shutil.copytree(FINGER.parent, tmp_path / "finger")
    axes = [view.camera.project(scene.tubes[0].spine[10::45]) for view in scene.views]
    with opened(["left.png", "right.png"], tmp_path) as hand:
        page, engine = hand.studio.page, hand.studio.engine
        pair = page.session
        assert pair is not None
        for point in axes[0]:
            hand.click(point)
        hand.choose("Through", "right")
        hand.wait(lambda: page.eye == 1)
        for point in axes[1]:
            hand.click(point)
        hand.wait(lambda: len(engine.snapshots) == 1)
        hand.shot("pair-drawn")
        (item,) = pair.state.items
        np.testing.assert_allclose(pair.axis(item.uid, 1), axes[1], atol=0.5)
        hand.press("Run")
        hand.at_rest()
        rested, place = contour(hand, v=1), right_edge(hand, 1)[1]
        hand.press("Pull")
        hand.wait(lambda: page.tool == "Pull")
        pull(hand, 1, 30)
        hand.at_rest()
        hand.shot("pair-let go")
        assert abs(rightmost(contour(hand, v=1), place) - rightmost(rested, place)) < 0.5
        assert {s["view"] for s in pair.item(item.uid).table["spring"]} == {"right"}

        hand.choose("File", "finger/scene.toml")
        hand.press("Open")
        hand.wait(lambda: page.session is not pair and engine.film is not None)
        hand.steady()
        film, session = engine.film, page.session
        assert film is not None and session is not None and session.moving and page.eye == 0
        hand.press("Track")
        hand.wait(lambda: film.count >= 3)
        hand.press("Stop")
        hand.wait(lambda: not film.tracking)
        hand.shot("film-tracked")
        last = engine.frame
        hand.press("Back")
        hand.wait(lambda: engine.frame == last - 1 and page._pictured[0] == last - 1)
        slider = hand.page.get_by_role("slider").first
        hand.wait(lambda: slider.get_attribute("aria-valuenow") == str(last - 1))
        hand.shot("film-back")
        pull(hand, 0, 12)
        hand.wait(lambda: not engine.going())
        assert {s["frame"] for s in session.item(1).table["spring"]} == {last - 1} and film.count == last
        hand.shot("film-put right")
        hand.press("Track")
        hand.wait(lambda: film.count > last)
        hand.press("Stop")
        hand.wait(lambda: not film.tracking)
        assert engine.snapshots[1].note == ""
