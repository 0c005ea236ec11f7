"""Every tool of the studio by mouse in a real browser: what it does, and that one step of undo takes it back."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

import symseek
from symseek import cli
from symseek.studio.state import PALETTE
from tests.browser import Hand, chromium, contour, opened, pixels

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium: on Debian `make test` installs it")
SQUASH = cli.demos()["squash"]


def steps(hand: Hand) -> int:
    session = hand.studio.page.session
    assert session is not None
    return len(session._past)


@contextmanager
def one_step(hand: Hand, label: str) -> Iterator[None]:
    """What is done in the block is one step of that name, which is seen and then undone."""
    session = hand.studio.page.session
    assert session is not None
    before, count = session.state, steps(hand)
    yield
    hand.wait(lambda: session.can_undo == label and steps(hand) == count + 1)
    hand.shot(f"tool {label}")
    hand.press("Undo")
    hand.wait(lambda: session.state == before)
    session.end_of_drag()


def take(hand: Hand, tool: str) -> None:
    hand.press(tool)
    hand.wait(lambda: hand.studio.page.tool == tool)


def charts(hand: Hand) -> list[tuple[list[int], list[float]]]:
    """What the plots that are open hold: iterations and values of each."""
    return hand.page.evaluate(
        "Object.values(window.__viserTestpoints?.uplots ?? {}).map(u => u.chart.data.map(line => Array.from(line)))"
    )


def number(hand: Hand, slider: str, value: str) -> None:
    """Types a number beside a slider."""
    row = hand.page.get_by_text(slider, exact=True).first.locator("xpath=ancestor::*[.//input[not(@type='hidden')]][1]")
    field = row.locator("xpath=.//input[not(@type='hidden')]").first
    field.fill(value)
    field.press("Enter")


def test_what_is_drawn_is_put_right_by_mouse(tmp_path):
    """Chosen by the picker; points undone, moved, put between, deleted; the radius by its handle; objects in depth."""
    shutil.copy(SQUASH.parent / "squash.jpg", tmp_path)
    (tmp_path / "broken.png").write_bytes(b"nothing")
    spine = symseek.load(SQUASH).tubes[0].spine
    with opened([], tmp_path) as hand:
        page, engine = hand.studio.page, hand.studio.engine
        hand.choose("File", "squash.jpg")
        hand.wait(lambda: page.controls.files.value == "squash.jpg")
        hand.press("Open")
        hand.wait(lambda: page.session)
        hand.steady()
        session = page.session
        assert session is not None
        for point in spine:
            hand.click(point)
        (item,) = session.state.items
        uid, drawn = item.uid, session.axis(item.uid)
        hand.press("Undo")
        hand.wait(lambda: session.axis(uid) == drawn[:-1])
        hand.press("Redo")
        hand.wait(lambda: session.axis(uid) == drawn)
        with one_step(hand, "moving a point"):
            hand.drag(spine[2], spine[2] + [10, 30], 5)
            hand.let_go()
            hand.wait(lambda: np.allclose(session.axis(uid)[2], spine[2] + [10, 30], atol=0.6))
        with one_step(hand, "a point"):
            hand.click((spine[2] + spine[3]) / 2)
            assert len(session.axis(uid)) == 6 and np.allclose(session.axis(uid)[3], (spine[2] + spine[3]) / 2, atol=0.6)
        with one_step(hand, "deleting a point"):
            hand.page.keyboard.down("Shift")
            hand.click(spine[1])
            hand.page.keyboard.up("Shift")
            assert session.axis(uid) == [drawn[0], *drawn[2:]]

        hand.wait(lambda: engine.snapshots and page.handle() is not None)
        handle = page.handle()
        assert handle is not None
        foot, knob = handle
        start = np.linalg.norm(knob - foot)
        with one_step(hand, "the radius"):
            hand.drag(knob, foot + (knob - foot) * (1 + 20 / start), 6)
            hand.let_go()
            hand.wait(lambda: abs(session.item(uid).table.get("radius", 0) - start - 20) < 1.5)
            radius = session.item(uid).table["radius"]
            hand.wait(lambda: abs(np.ptp(engine.snapshots[uid].tube[:, 12, 2]) - 2 * radius) < 0.1 * radius)

        hand.press("New")
        hand.wait(lambda: len(session.state.items) == 2)
        for point in ([420, 120], [520, 160]):
            hand.click(point)
        hand.wait(lambda: len(engine.snapshots) == 2)
        other = page.chosen
        assert other is not None and other != uid and session.place(other) == (2, 2)
        with one_step(hand, "the order of depth"):
            number(hand, "In depth, 1: nearest", "1")
            hand.wait(lambda: session.place(other) == (1, 2))
        with one_step(hand, "the order of depth"):
            hand.press("Nearer")
            hand.wait(lambda: session.place(other) == (1, 2))
        with one_step(hand, f"deleting {session.item(other).name}"):
            hand.press("Delete")
        # last: its message lies over the image for a while
        hand.choose("File", "broken.png")
        hand.press("Open")
        hand.wait(lambda: "not an image" in page.told[1])
        hand.shot("tool bad file")


def test_a_model_is_run_and_shaped_by_mouse(tmp_path):
    """Run, paused, stepped, reset; pulled in space, pinned, pushed, creased, its weights turned."""
    shutil.copytree(SQUASH.parent, tmp_path, dirs_exist_ok=True)
    with opened(["scene.toml"], tmp_path) as hand:
        page, engine = hand.studio.page, hand.studio.engine
        session = page.session
        assert session is not None
        (uid,) = (item.uid for item in session.state.items)
        engine.speed = 100.0

        def iteration() -> int:
            return engine.snapshots[uid].iteration

        hand.press("Run")
        hand.wait(lambda: iteration() > 3)
        hand.press("Pause")
        hand.wait(lambda: not engine.going())
        engine.call(lambda: None).result(60)
        hand.shot("tool paused")
        at = iteration()
        hand.press("Step")
        hand.wait(lambda: iteration() == at + 1)
        hand.press("Reset")
        hand.wait(lambda: iteration() == 0)
        hand.page.get_by_text("Plots").click()
        hand.wait(lambda: len(charts(hand)) == 2)
        engine.speed = 300.0
        hand.press("Run")
        seen: dict[int, tuple[float, float | None]] = {}

        def rests() -> bool:
            s = engine.snapshots[uid]
            seen[s.iteration] = s.residual, s.support and s.support[0]
            return s.converged and s.done

        hand.wait(rests, 60)
        rested_at = max(seen)
        hand.wait(lambda: all(chart[0][-1] == rested_at for chart in charts(hand)))
        (plotted, residual), (same, error) = charts(hand)
        common = [k for k, i in enumerate(plotted) if i in seen]
        assert plotted == same and np.all(np.diff(plotted) > 0) and len(common) > 5
        np.testing.assert_allclose([residual[k] for k in common], [np.log10(seen[plotted[k]][0]) for k in common], atol=1e-6)
        assert residual[-1] == pytest.approx(np.log10(seen[rested_at][0])) and error[-1] == pytest.approx(seen[rested_at][1])
        hand.page.locator(".uplot").last.scroll_into_view_if_needed()
        hand.shot("tool plots")
        engine.speed = 1e6
        rested = engine.snapshots[uid].tube
        shown = pixels(hand)
        own = np.array([int(PALETTE[0][k : k + 2], 16) for k in (1, 3, 5)])
        assert (np.abs(shown - own).max(axis=-1) < 40).sum() > 300, "the contour has the object's colour"

        place = np.array([330, 230])
        edge = contour(hand)[np.linalg.norm(contour(hand) - place, axis=1).argmin()]
        out = np.array([0.37, -0.93])
        take(hand, "Pin")
        with one_step(hand, "a pull"):
            hand.drag(edge, edge + 25 * out, 8)
            hand.let_go()
            hand.wait(lambda: session.can_undo == "a pull")
            hand.at_rest()
            assert np.linalg.norm(contour(hand, 500) - edge - 25 * out, axis=1).min() < 3, "it stays"
        hand.at_rest()
        assert np.array_equal(engine.snapshots[uid].tube, rested)

        take(hand, "Push")
        tip, along = contour(hand)[np.linalg.norm(contour(hand) - [520, 380], axis=1).argmin()], np.array([0.85, 0.53])
        with one_step(hand, "a pull"):
            hand.drag(tip + 30 * along, tip + 10 * along, 8)
            hand.wait(lambda: np.linalg.norm(contour(hand, 500) - tip, axis=1).min() > 5)
            hand.shot("tool pushing")
            hand.let_go()
        hand.at_rest()

        take(hand, "Crease")
        middle = session.view.camera.project(engine.snapshots[uid].spine[12])
        with one_step(hand, "a painted crease"):
            hand.drag(middle, middle + np.array([30, 20]), 6)
            hand.let_go()
            hand.wait(lambda: "material" in session.item(uid).table)
            zero = np.argwhere(np.array(session.item(uid).table["material"]["w02"]) == 0)
            assert len(zero) >= 2
            hand.at_rest()
            assert engine.snapshots[uid].converged
        with one_step(hand, "a crease"):
            hand.click(middle)
        take(hand, "Gap")
        with one_step(hand, "a gap"):
            hand.click(middle)
        take(hand, "Not here")
        with one_step(hand, "a mark"):
            hand.click([60, 60])

        hand.page.get_by_text("Shape by hand").click()
        hand.page.get_by_text("Symmetry b").wait_for()
        with one_step(hand, "material b"):
            number(hand, "Symmetry b", "3")
            hand.wait(lambda: session.item(uid).table.get("material", {}).get("b") == 3)
        with one_step(hand, "material closed"):
            hand.page.get_by_label("Ends shut").click()
        hand.at_rest()

        take(hand, "Pull")
        hand.press("In space")
        hand.wait(lambda: page.in_space and page.drawing and page.drawing.in_space())
        hand.page.wait_for_timeout(800)
        drawing = page.drawing
        assert drawing is not None
        nodes = drawing.frame.shown(engine.snapshots[uid].tube)
        eye = next(iter(hand.studio.server.get_clients().values())).camera.position
        i = int(np.linalg.norm(nodes[:, 12] - eye, axis=1).argmin())
        before = engine.snapshots[uid].tube[i, 12]
        with one_step(hand, "a pull"):
            hand.drag(nodes[i, 12], nodes[i, 12] + [0, -40, 0], 10, space=True)
            hand.wait(lambda: np.linalg.norm(engine.snapshots[uid].tube[i, 12] - before) > 15)
            hand.shot("tool pulled in space")
            hand.let_go()
            hand.wait(lambda: session.can_undo == "a pull")
            assert all(len(s["anchor"]) == 3 for s in session.item(uid).table["spring"])
        hand.at_rest()
        hand.press("Results")
        hand.wait(lambda: page.told[0] in ("Done", "Not to be trusted"), 60)
        hand.shot("tool results")
        assert page.told[0] == "Done" and (tmp_path / "squash-studio" / "squash.ply").is_file()
