"""The studio in a real browser: a squash is drawn, run, pulled, undone and saved by mouse."""

from __future__ import annotations

import shutil
import time

import numpy as np
import pytest

import symseek
from symseek import cli
from symseek.sim.curve import evenly
from tests.browser import chromium, contour, gap, opened, pixels

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium: on Debian `make test` installs it")
SQUASH = cli.demos()["squash"]


def test_a_squash_is_drawn_run_pulled_undone_and_saved(tmp_path):
    shutil.copy(SQUASH.parent / "squash.jpg", tmp_path)
    given = symseek.load(SQUASH)
    known = symseek.reconstruct(given).objects[0]
    with opened(["squash.jpg"], tmp_path) as hand:
        page, engine = hand.studio.page, hand.studio.engine
        assert page.session is not None
        hand.shot("1-opened")
        for point in given.tubes[0].spine:
            hand.click(point)
        hand.wait(lambda: engine.snapshots)
        (item,) = page.session.state.items
        np.testing.assert_allclose(page.session.axis(item.uid), given.tubes[0].spine, atol=0.5)
        hand.shot("2-drawn")

        hand.press("Run")
        hand.at_rest()
        (rested,) = engine.snapshots.values()
        hand.shot("3-at rest")
        assert rested.converged
        before = contour(hand)
        truth = np.concatenate([evenly(p, 6000, False) for p in known.contour])
        assert gap(before, truth) < 0.2 and gap(truth, before) < 0.2

        hand.press("Pull")
        hand.wait(lambda: page.tool == "Pull")
        edge = before[np.linalg.norm(before - [330, 230], axis=1).argmin()]
        there = edge + 40 * np.array([0.37, -0.93])
        hand.drag(edge, there)
        hand.wait(lambda: np.linalg.norm(contour(hand, 500) - there, axis=1).min() < 2.0)
        hand.shot("4-pulled")
        hand.let_go()
        hand.wait(lambda: page.session and page.session.can_undo == "a pull")
        hand.at_rest()
        hand.shot("5-let go")
        after = contour(hand)
        assert gap(after, before) < 0.5 and gap(before, after) < 0.5
        pulled = next(iter(engine.snapshots.values()))
        assert pulled.converged and pulled.iteration > rested.iteration

        hand.press("Save")
        hand.wait(lambda: page.told[0] == "Saved")
        (found,) = symseek.reconstruct(symseek.load(tmp_path / "squash-studio.toml")).objects
        assert found.iterations == pulled.iteration and np.array_equal(found.tube[0], pulled.tube), (
            "played again, bit by bit"
        )
        solid = np.load(SQUASH.with_name("truth.npz"))
        for measure in ("volume", "length"):
            own, scenes = (abs(o.measures[measure] / float(solid[measure]) - 1) for o in (found, known))
            assert own < max(2 * scenes, 0.002), "as accurate as the scene's"

        hand.press("Undo")
        hand.wait(lambda: page.session and page.session.can_redo == "a pull")
        hand.at_rest()
        hand.shot("6-undone")
        (undone,) = engine.snapshots.values()
        assert np.array_equal(undone.tube, rested.tube)

        hand.press("Save")
        hand.wait(lambda: "spring" not in (tmp_path / "squash-studio.toml").read_text())
        out = tmp_path / "out"
        command = ["run", str(tmp_path / "squash-studio.toml"), "--out", str(out), "--quiet", "--no-video"]
        assert cli.main(command) == 0
        saved = np.load(out / "object 1.npz")["tube"]
        assert np.array_equal(saved[0], undone.tube)

        hand.press("Web page")
        hand.wait(lambda: page.told[0] == "Written")
        hand.press("In space")
        hand.wait(lambda: page.in_space)
        hand.shot("7-in space")
        hand.page.set_viewport_size({"width": 480, "height": 360})
        hand.page.goto((tmp_path / "squash-studio.html").as_uri())
        hand.page.wait_for_selector("canvas")
        hand.page.wait_for_timeout(1000)
        hand.shot("8-web page")
        red, green, blue = pixels(hand).T
        model = green[(blue > red + 60) & (blue > green)]
        assert len(model) > 3000 and np.ptp(np.percentile(model, [10, 90])) > 30, (
            "shaded, though it was seen through the camera"
        )


def test_two_windows_and_a_closed_one(tmp_path):
    """Both see the same session; what one drew stays when it is closed in the middle of a drag."""
    shutil.copy(SQUASH.parent / "squash.jpg", tmp_path)
    with opened(["squash.jpg"], tmp_path) as hand:
        page = hand.studio.page
        for point in symseek.load(SQUASH).tubes[0].spine:
            hand.click(point)
        hand.press("Run")
        hand.at_rest()
        hand.press("Pull")
        hand.wait(lambda: page.tool == "Pull")
        edge = contour(hand)[3000]
        hand.drag(edge, edge - np.array([0, 20]))
        second = hand.page.context.new_page()
        second.goto(hand.studio.address)
        hand.wait(lambda: len(hand.studio.server.get_clients()) == 2)
        hand.page.close()
        hand.page = second
        hand.wait(lambda: len(hand.studio.server.get_clients()) == 1)
        hand.wait(lambda: page.session and page.session.can_undo == "a pull")
        second.wait_for_selector("canvas")
        assert second.get_by_text("Pull", exact=True).count() >= 1
        second.get_by_role("button", name="Undo", exact=True).click()
        hand.wait(lambda: page.session and page.session.can_redo == "a pull")
        time.sleep(0.1)
        hand.at_rest()
