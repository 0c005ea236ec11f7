"""Moving scenes in the studio: frames by number, tubes that are put right on the way, and the same by `symseek run`."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from PIL import Image

import symseek
from symseek import cli
from symseek.checks import Table
from symseek.frames import Frames, together
from symseek.scene import build
from symseek.sim.track import track
from symseek.studio.engine import Engine
from symseek.studio.film import CACHED, Reel
from symseek.studio.keep import AUTOSAVE, Folder
from symseek.studio.serve import Studio
from symseek.studio.session import Session
from symseek.studio.shelf import Shelf
from tests.test_studio_engine import show

FINGER = cli.demos()["finger"]
COUNT = 5


def frames(value, base) -> Frames:
    return Frames(Table({"frames": value}, "test", "view", ["frames"]), base)


def test_frames_by_number_are_those_in_turn(tmp_path):
    """Of videos and of files, in any order; no more than a few are held, and one at fault says so."""
    rng = np.random.default_rng(1)
    video = [frames(name, FINGER.parent) for name in ("left.mp4", "right.mp4")]
    assert len(video[0]) == len(list(video[0])) == 40
    for k in range(6):
        Image.fromarray(rng.integers(0, 255, (20, 30), np.uint8)).save(tmp_path / f"{k}.png")
    (tmp_path / "3.png").write_bytes(b"nothing")
    Image.fromarray(np.zeros((20, 31), np.uint8)).save(tmp_path / "4.png")
    files = [frames("*.png", tmp_path)]
    for sources in (video, files):
        reel, wanted = Reel(sources), list(together(sources))
        assert reel.length == len(wanted)
        for k in (0, 1, 2, reel.length - 1, *rng.integers(0, reel.length, 12)):
            found = reel.at(int(k))
            if isinstance(wanted[k], str):
                assert found == wanted[k]
            else:
                assert all(np.array_equal(a, b) for a, b in zip(found, wanted[k], strict=True))
        assert len(reel._known) <= CACHED
    assert [reel.known(k) is None for k in range(6)] != [True] * 6


def wait(engine: Engine) -> None:
    while engine.call(engine.going).result(60):
        pass


def states(engine: Engine, session: Session, count: int = COUNT) -> np.ndarray:
    """Tubes in the first frames, which are gone through where they have not been."""
    film = engine.film
    assert film is not None

    def some() -> None:
        film.reel.length = count

    engine.call(some).result(60)
    engine.track().result(60)
    wait(engine)
    assert film.count == count
    found = []
    for k in range(count):
        engine.see(k).result(60)
        found.append(engine.snapshots[1].tube)
    return np.stack(found)


def again(session: Session, count: int = COUNT) -> np.ndarray:
    """The same as `symseek run` finds it."""
    scene = build(session.tables(), session.base, "again")
    shown = together(session.frames)
    return track(shown, scene.views, scene.tubes, scene.settings, scene.tracking, callback=lambda s: s.frame == count - 1)\
        .objects[0].tube  # fmt: skip


def test_a_frame_is_put_right_and_the_film_goes_on(engine):
    """What is pulled in a later frame is kept, taken back, and played again by a run, to the bit."""
    session = Folder(FINGER.parent).open("scene.toml")[0]
    show(engine, session, fresh=True)
    first = states(engine, session)
    assert np.array_equal(first, again(session)) and engine.snapshots[1].frame == COUNT - 1

    engine.see(3).result(60)
    camera, tube = session.views[1].camera, engine.snapshots[1].tube
    seen = camera.project(tube[:, 12])
    at = int(seen[:, 1].argmax())
    engine.grab(1, (at / 25, 0.5), seen[at], view=1).result(60)
    for k in range(8):
        engine.drag(1, seen[at] + [0.0, 3.0 * k]).result(60)
    while camera.project(engine.snapshots[1].tube[at, 12])[1] < seen[at, 1] + 19:
        engine.call(lambda: None).result(60)
    assert engine.film is not None and engine.film.count == 4, "what came after is another film's"
    session.record(1, session.written(engine.let_go(1).result(60)))
    assert {(s["frame"], s["view"]) for s in session.item(1).table["spring"]} == {(3, "right")}
    assert session.settings().iterations == symseek.Settings.iterations, "the first frame has no longer to go"
    show(engine, session)
    wait(engine)
    assert engine.film.count == 4 and engine.frame == 3 and engine.snapshots[1].note == ""
    second = states(engine, session)
    assert np.array_equal(second[:3], first[:3]) and np.abs(second[3] - first[3]).max() > 1e-3
    assert np.array_equal(second, again(session))

    session.undo()
    show(engine, session)
    assert engine.film.count == 4 and np.array_equal(engine.snapshots[1].tube, first[3])
    session.redo()
    show(engine, session)
    assert np.array_equal(engine.snapshots[1].tube, second[3])
    session.undo()
    session.set_weight(1, {"b": 0.2})
    show(engine, session)
    assert engine.frame == 0 and not engine.film.begun, "another first frame is another film"


def test_a_studio_that_is_opened_again_goes_on_where_it_was(tmp_path):
    """A frame put right and one after it come back to the bit, and the next is what a run finds; after a reset none do."""
    shutil.copytree(FINGER.parent, tmp_path, dirs_exist_ok=True)
    found: list[list[np.ndarray]] = []
    for _ in range(2):
        studio = Studio(["scene.toml"], tmp_path, port=0)
        try:
            page, engine = studio.page, studio.engine
            wait(engine)
            film = engine.film
            assert film is not None and page.session is not None
            engine.speed = 1e6
            if not found:
                assert film.count == 1 and not film.begun
                film.reel.length = 3
                page.film("Track")
                wait(engine)
                tube = engine.snapshots[1].tube
                seen = page.session.view.camera.project(tube[:, 12])
                engine.grab(1, (0.0, 0.5), seen[0]).result(60)
                engine.drag(1, seen[0] + [5.0, 0.0]).result(60)
                page.record(1, engine.let_go(1).result(60))
                film.reel.length = 4
                page.film("Track")
                wait(engine)
            assert film.count == 4 and engine.frame == 3
            tubes = []
            for k in range(4):
                engine.see(k).result(60)
                tubes.append(engine.snapshots[1].tube)
            found.append(tubes)
            if len(found) == 2:
                assert np.array_equal(found[0], found[1])
                film.reel.length = 5
                page.film("Track")
                wait(engine)
                engine.see(4).result(60)
                assert np.array_equal([*tubes, engine.snapshots[1].tube], again(page.session, 5))
                page.run("Reset")
                engine.call(lambda: None).result(60)
                assert not (tmp_path / AUTOSAVE / "scene.toml.frames").exists()
        finally:
            studio.close()


def test_frames_of_another_state_are_not_taken_up(tmp_path):
    """Nor is what a studio that was killed has written by half."""
    shelf, kind = Shelf(tmp_path / "x" / "a.frames"), np.dtype([("place", "<f4", 3)])
    records = [np.full(1, k, kind) for k in range(4)]
    for count in (2, 3, 2, 4):
        shelf.keep("one", records[:count])
        assert shelf.records("one", kind) == records[:count] and not shelf.records("two", kind)
    shelf.keep("one", [*records[:2], np.full(1, 9, kind), records[3]])
    assert [r["place"][0, 0] for r in shelf.records("one", kind)] == [0, 1, 9, 3]
    shelf.path.write_bytes(shelf.path.read_bytes()[:-5])
    assert len(Shelf(shelf.path).records("one", kind)) == 3
    shelf.keep("two", records[:1])
    assert shelf.has("two") and not shelf.has("one")
    shelf.clear()
    assert not shelf.has("two") and list(tmp_path.glob("x/*")) == []


def test_springs_of_frames_belong_to_moving_scenes():
    spring = {"anchor": [30, 30], "point": [0.0, 0.5], "frame": 2}
    tube = {"name": "a", "spine": [[20, 30], [60, 30]], "spring": [spring]}
    view = {"image": np.random.default_rng(1).uniform(size=(60, 80)).astype(np.float32)}
    with pytest.raises(symseek.SceneError, match=r"object\[0\]\.spring: has a frame"):
        build({"view": [view], "object": [tube]}, FINGER.parent, "still")
    with pytest.raises(symseek.SceneError, match=r"spring\[0\]\.frame: -1 is no frame"):
        build({"view": [view], "object": [{**tube, "spring": [{**spring, "frame": -1}]}]}, FINGER.parent, "still")
