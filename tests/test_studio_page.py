"""The studio's page without a browser: whatever is done while models run, nothing fails and all can be undone."""

from __future__ import annotations

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import symseek
from symseek.studio.pace import NICE, yields
from symseek.studio.serve import Studio
from symseek.studio.session import Session
from tests.test_studio_session import AXIS, BEGIN, PIXELS, action

pull = st.tuples(st.just("pull"), st.floats(0, 1), st.floats(0, 1), st.floats(-10, 70), st.floats(-10, 60), st.booleans())
button = st.sampled_from(["Run", "Run", "Pause", "Step", "Reset", "Undo", "Redo"]).map(lambda b: ("button", b))


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    root = tmp_path_factory.mktemp("studio")
    Image.fromarray((255 * PIXELS).astype(np.uint8)).save(root / "photo.png")
    studio = Studio([], root, port=0)
    studio.engine.speed = 1e6
    yield studio
    studio.close()


@settings(max_examples=5, derandomize=True, database=None, deadline=None)
@given(st.lists(st.one_of(action, pull, button), min_size=5, max_size=15))
def test_whatever_is_done_while_models_run_can_be_undone(studio, actions):
    """Random sequences of steps, buttons and pulls: no fault is told, and the engine shows what the session holds."""
    page, engine = studio.page, studio.engine

    def shown() -> None:
        engine.call(lambda: None).result(60)
        drawn = {i.uid for i in page.session.state.items if page.session.tube(i) is not None}
        assert set(engine.snapshots) == drawn and engine.failed == ""
        assert all(np.isfinite(s.tube).all() for s in engine.snapshots.values())

    with mock.patch.object(page, "tell", wraps=page.tell) as told:
        page.open("photo.png")
        page.start_over()
        begun = page.session.state
        page.act(lambda session: setattr(page, "chosen", session.add()))
        for x, y in AXIS:
            page.act(lambda session, at=(x, y): session.add_point(page.chosen, at))
        shown()
        assert len(engine.snapshots) == 1
        page.run("Run")
        for name, *arguments in actions:
            if name == "button":
                (page.undo if arguments[0] in ("Undo", "Redo") else page.run)(*arguments)
            elif name == "pull":
                for uid in [*engine.snapshots][:1]:
                    x, s, *mouse, pin = arguments
                    engine.grab(uid, (x, s), mouse)
                    engine.drag(uid, [mouse[0] + 3, mouse[1] + 3])
                    page.record(uid, engine.let_go(uid, pin).result(60))
            else:
                if arguments and arguments[0] < 3:  # most of them of what is there
                    arguments[0] = page.chosen
                page.act(lambda session, name=name, arguments=arguments: getattr(session, name)(*arguments))
        shown()
        while page.session.can_undo:
            page.undo("Undo")
        shown()
        assert begun in (page.session.state, *(state for state, _ in page.session._future))
        assert not [said for said in told.call_args_list if "fault" in said.args[0]]
    page.run("Pause")


@pytest.mark.skipif(sys.platform != "linux", reason="threads have no priorities of their own")
def test_a_studio_that_was_started_with_little_priority_keeps_to_it():
    def priorities() -> list[int]:
        own, found = threading.get_native_id(), []
        found.append(os.getpriority(os.PRIO_PROCESS, own))
        yields()
        found.append(os.getpriority(os.PRIO_PROCESS, own))
        os.setpriority(os.PRIO_PROCESS, own, 15)
        yields()
        return [*found, os.getpriority(os.PRIO_PROCESS, own)]

    with ThreadPoolExecutor(1) as pool:
        first, second, third = pool.submit(priorities).result()
    assert second == max(first, NICE) and third == 15


def test_an_axis_may_be_short_while_it_is_drawn(tmp_path):
    """Two clicks close together are not refused, but no tube; a point twice at one place is."""
    session = Session(BEGIN, tmp_path, "made")
    uid = session.add()
    for point in ((10, 20), (14, 22)):
        session.add_point(uid, point)
    assert session.axis(uid) == [[10, 20], [14, 22]] and session.tube(session.item(uid)) is None
    with pytest.raises(symseek.SceneError, match="pixels long"):
        session.tables()
    with pytest.raises(symseek.SceneError, match="are both"):
        session.add_point(uid, (14, 22))
    session.add_point(uid, (40, 24))
    assert session.tube(session.item(uid)) is not None
