"""The studio's session and files: random actions can all be undone and kept; nothing outside the folder is touched."""

import json
import os
import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import symseek
from symseek import cli
from symseek.sim.problem import Settings
from symseek.sim.spring import Spring
from symseek.studio.keep import ALPHA, AUTOSAVE, Folder, toml
from symseek.studio.session import Session
from symseek.studio.state import PALETTE, Item, State
from tests import test_cameras

RNG = np.random.default_rng(5)
PIXELS = RNG.uniform(0.2, 0.8, (48, 64))
BEGIN = State({"name": "made", "view": [{"image": PIXELS}]})
EYES = [{"name": n, "image": PIXELS, "projection": "stereo", "alpha": a} for n, a in (("left", 0.2), ("right", -0.2))]
BEGINS = (BEGIN, State({"name": "made", "view": EYES}))
AXIS = [[10, 20], [30, 24], [50, 22]]


@pytest.fixture
def folder(tmp_path):
    Image.fromarray((255 * PIXELS).astype(np.uint8)).save(tmp_path / "photo.png")
    return Folder(tmp_path)


def drawn(folder: Folder, *points) -> tuple[Session, int]:
    session, _ = folder.open("photo.png")
    uid = session.add()
    for point in points:
        session.add_point(uid, point)
    return session, uid


number = st.floats(-20, 90, width=32) | st.floats(width=32)
point = st.tuples(st.floats(0, 63, width=32), st.floats(0, 47, width=32)) | st.tuples(number, number)
uid = st.integers(0, 4)
spring = st.fixed_dictionaries(
    {"anchor": point, "start": st.integers(-1, 300)},
    optional={
        "view": st.sampled_from(["front", "right"]),
        "stop": st.integers(0, 400),
        "point": st.tuples(number, number),
        "reach": number,
        "stiffness": number,
    },
)
weight = st.fixed_dictionaries({}, optional={"w2": number, "b": number | st.none(), "L1": number, "closed": st.booleans()})
action = st.one_of(
    st.tuples(st.just("add")),
    *(st.tuples(st.just(name), uid) for name in ("remove", "clear")),
    st.tuples(st.just("rename"), uid, st.sampled_from(["pear", "pear", "object 1", "a/b", ""])),
    st.tuples(st.just("recolour"), uid, st.sampled_from(PALETTE)),
    st.tuples(st.just("move"), uid, st.integers(-3, 3)),
    st.tuples(st.just("add_point"), uid, point),
    st.tuples(st.just("add_point"), uid, point, st.integers(0, 3)),
    st.tuples(st.just("add_point"), uid, point, st.none(), st.integers(0, 1)),
    st.tuples(st.just("move_point"), uid, st.integers(-1, 4), point, st.integers(0, 1)),
    st.tuples(st.just("remove_point"), uid, st.integers(-1, 4), st.integers(0, 1)),
    st.tuples(st.just("set_radius"), uid, number | st.none()),
    st.tuples(st.just("set_weight"), uid, weight),
    st.tuples(st.just("break_at"), uid, point, st.sampled_from(["tangent", "position"])),
    st.tuples(st.just("mark"), uid, point, st.integers(0, 1)),
    st.tuples(st.just("paint"), uid, st.lists(st.tuples(st.integers(-1, 25), st.integers(0, 25)), max_size=3)),
    st.tuples(st.just("record"), uid, st.lists(spring, max_size=2)),
    *(st.tuples(st.just(name)) for name in ("forget_pulls", "undo", "redo", "end_of_drag")),
)
two_drawn = [("add",), ("add",), *(("add_point", u, (x, y + 12 * u)) for u in (1, 2) for x, y in AXIS[::2])]
session_actions = st.tuples(st.booleans(), st.lists(action, min_size=5, max_size=40)).map(lambda t: two_drawn * t[0] + t[1])
begins = st.sampled_from(BEGINS)


@settings(max_examples=200, derandomize=True, database=None, deadline=None)
@given(begins, session_actions)
def test_whatever_is_done_can_be_undone_and_kept(tmp_path_factory, begin, actions):
    """200 random sequences: only the input's faults are refused, and they change nothing; every state comes back."""
    session = Session(begin, tmp_path_factory.getbasetemp(), "made")
    seen, done = [session.state], 0
    for name, *arguments in actions:
        before = session.state
        try:
            getattr(session, name)(*arguments)
            done += 1
        except symseek.SceneError:
            assert session.state is before
        seen.append(session.state)
        items = session.state.items
        assert len({i.uid for i in items}) == len(items)
        for item in items:
            assert item.table == json.loads(json.dumps(item.table)), "as its file would hold it"
            tube = session.tube(item)
            steps = np.linalg.norm(np.diff(np.reshape(item.table.get("spine", []), (-1, 2)), axis=0), axis=1)
            assert (tube is not None) == (item.finished and steps.sum() >= 10) or len(session.views) > 1
        complete = [i for i in items if session.tube(i) is not None]
        if complete and len(complete) == len(items):
            tables = {k: v for k, v in session.tables().items() if k != "view"}
            assert tomllib.loads(toml(tables)) == json.loads(json.dumps(tables))
    last, count = session.state, 0
    while session.undo():
        assert session.state in seen
        count += 1
    assert session.state == begin and count <= done
    while session.redo():
        assert session.state in seen
    text = State({**session.state.top, "view": []}, session.state.items).text()
    assert State.of(text).items == session.state.items
    if not any(name in ("undo", "redo") for name, *_ in actions):
        assert session.state == last


value = st.recursive(
    st.text(st.characters(codec="utf-8"), max_size=8)
    | st.booleans()
    | st.integers(-(2**60), 2**60)
    | st.floats(allow_nan=False),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=200, derandomize=True, database=None, deadline=None)
@given(st.dictionaries(st.text(max_size=5), value, max_size=4))
def test_what_is_written_as_toml_is_read_as_it_was(data):
    assert tomllib.loads(toml(data)) == data


def test_a_drag_is_one_step(folder):
    session, uid = drawn(folder, *AXIS)
    for x in range(51, 60):
        session.move_point(uid, 2, (x, 22))
    session.end_of_drag()
    session.move_point(uid, 2, (40, 30))
    assert session.axis(uid)[2] == [40, 30] and session.can_undo == "moving a point"
    session.undo()
    assert session.axis(uid)[2] == [59, 22]
    session.undo()
    assert session.axis(uid) == AXIS and session.can_undo == "a point" and session.can_redo == "moving a point"


def test_what_cannot_be_is_refused_with_its_reason(folder):
    session, uid = drawn(folder, *AXIS)
    state = session.state
    for wrong, text in (
        (lambda: session.add_point(uid, (200, 20)), "lies outside the image of 64 x 48"),
        (lambda: session.add_point(uid, (30, 24.01)), "crosses itself|are both"),
        (lambda: session.set_radius(uid, -3.0), "out of bounds"),
        (lambda: session.set_weight(uid, {"w2": -1.0}), "w2: .*does not fit"),
        (lambda: session.rename(uid, "a/b"), "cannot be a file name"),
        (lambda: session.remove(9), "no longer there"),
        (lambda: session.record(uid, [{"anchor": [1, 1], "point": [0, 2.0]}]), "does not fit"),
    ):
        with pytest.raises(symseek.SceneError, match=text):
            wrong()
        assert session.state is state


def test_the_order_of_depth(folder):
    """Objects that lay level come to lie one behind the other, and move past each other."""
    session, first = drawn(folder, *AXIS)
    others = [session.add() for _ in range(2)]
    for k, other in enumerate(others):
        for x, y in AXIS:
            session.add_point(other, (x, y + 10 * k - 5))

    def order():
        return [i.uid for i in sorted(session.state.items, key=lambda i: i.table.get("depth", 0.0))]

    session.move(first, 1)
    assert order() == [others[0], first, others[1]]
    depths = sorted(i.table.get("depth", 0.0) for i in session.state.items)
    assert np.diff(depths).min() > 5
    session.move(first, 5)
    assert order() == [*others, first]
    session.undo()
    session.undo()
    assert all("depth" not in i.table for i in session.state.items)


def test_what_a_run_can_go_on_from(folder):
    session, uid = drawn(folder, *AXIS)
    before = session.item(uid).structure()
    session.set_weight(uid, {"w2": 1e-5})
    session.rename(uid, "pear")
    session.record(uid, [{"anchor": [30, 10], "point": [0.25, 0.5], "start": 7, "stop": 9}])
    assert session.item(uid).structure() == before
    session.set_weight(uid, {"closed": False})
    assert session.item(uid).structure() != before
    assert "spring" not in session.item(uid).table, "it was pulled on the way of another object"


def test_after_the_last_spring_there_is_time_to_rest(folder):
    session, uid = drawn(folder, *AXIS)
    session.record(uid, [{"anchor": [30, 10], "point": [0.25, 0.5], "start": 9000, "stop": 9900}])
    assert session.settings().iterations == 9900 + Settings.iterations == session.tables()["solver"]["iterations"]
    session.undo()
    assert session.settings().iterations == Settings.iterations and "solver" not in session.tables()


def test_a_scene_whose_cameras_stand_in_a_file(tmp_path):
    """Views that bend, listed by the file: what is drawn in them made straight is saved as the bent images have it."""
    (tmp_path / "images" / "left").mkdir(parents=True)
    for name in test_cameras.NAMES:
        Image.fromarray(RNG.integers(0, 255, (480, 640), np.uint8)).save(tmp_path / "images" / name)
    test_cameras.colmap_text(tmp_path, test_cameras.BEND)
    (tmp_path / "ring.toml").write_text(f'cameras = "."\n[[object]]\nspine = {test_cameras.POINTS[:2].tolist()}\n')
    folder = Folder(tmp_path)
    session, _ = folder.open("ring.toml")
    session.remove(1)
    uid, lens = session.add(), session.views[0].lens
    points = [test_cameras.seen(k, test_cameras.BEND)[:2] - 0.5 for k in (1, 0)]
    for v in (0, 1):
        for point in session.views[v].camera.project(test_cameras.POINTS[:2]):
            session.add_point(uid, point, view=v)
    assert lens is not None
    for v, name in enumerate(("b", "left_a")):
        np.testing.assert_allclose(session.item(uid).table["spines"][name], points[v], atol=0.01)
        np.testing.assert_allclose(session.axis(uid, v), session.views[v].camera.project(test_cameras.POINTS[:2]), atol=0.02)
    assert np.abs(points[0] - session.axis(uid, 0)).max() > 1, "it does bend"
    session.mark(uid, (100, 50))
    session.record(uid, session.written([Spring((200.0, 100.0), (0.25, 0.5), view=1, start=3, stop=9)]))
    tube, saved = session.tube(session.item(uid)), symseek.load(folder.save(session, "made"))
    assert tube is not None and "view" not in tomllib.loads((tmp_path / "made.toml").read_text())
    assert np.array_equal(tube.spine, saved.tubes[0].spine) and tube.springs == saved.tubes[0].springs
    np.testing.assert_allclose(tube.springs[0].anchor, (200, 100), atol=1e-6)
    np.testing.assert_allclose(np.asarray(tube.not_here), [[100, 50]], atol=0.02)
    for name in ("../x", "/etc"):
        (tmp_path / "evil.toml").write_text(
            f'cameras = "."\nimages = "{name}"\n[[object]]\nspine = [[0, 0, 0], [1, 0, 0]]\n'
        )
        with pytest.raises(symseek.SceneError, match="lies outside"):
            folder.open("evil.toml")
    (tmp_path / "images.txt").write_text((tmp_path / "images.txt").read_text().replace(" b.png", " ../../b.png"))
    with pytest.raises(symseek.SceneError, match="lies outside"):
        folder.open("ring.toml")


@pytest.mark.parametrize("name", sorted(cli.demos()))
def test_a_scene_file_is_kept_as_it_is(name):
    """Opened and saved without a change, it means the same."""
    scene = cli.demos()[name]
    folder = Folder(scene.parent)
    session, restored = folder.open("scene.toml")
    assert not restored
    saved = tomllib.loads(toml(session.tables()))
    given_ = tomllib.loads(scene.read_text())
    given_["object"] = [{"name": name, **o} for o in given_["object"]]
    assert saved == {"name": name, **given_}


def test_what_is_drawn_in_a_perspective_view_lies_beside_the_first_object(folder, tmp_path):
    (tmp_path / "near.toml").write_text(
        '[[view]]\nimage = "photo.png"\nprojection = "perspective"\nK = [[90, 0, 32], [0, 90, 24], [0, 0, 1]]\n'
        "R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nt = [0, 0, 5]\n[[object]]\nspine = [[-1, 0, 0], [0, 0, 1], [1, 0, 2]]\n"
    )
    session, _ = folder.open("near.toml")
    assert session.depth == 6
    uid = session.add()
    session.add_point(uid, (10, 10))
    session.add_point(uid, (40, 20))
    tube = session.tube(session.item(uid))
    assert tube is not None and tube.depth == 6


def test_save_and_autosave(folder, tmp_path):
    session, uid = drawn(folder, *AXIS)
    full = folder.save(session, "made")
    scene = symseek.load(full)
    assert scene.tubes[0].spine.tolist() == AXIS and scene.views[0].image.shape == (48, 64)
    folder.save(session, "made")  # its own may be written again
    with pytest.raises(symseek.SceneError, match="is there already; choose another name"):
        Folder(tmp_path).save(session, "made")
    with pytest.raises(symseek.SceneError, match="cannot be a file name"):
        folder.save(session, "../made")
    folder.autosave("photo.png", session)
    again, restored = folder.open("photo.png")
    assert restored and again.state == session.state
    (tmp_path / AUTOSAVE / "photo.png.json").write_text("{}")
    assert folder.open("photo.png")[1] is False
    session.remove(uid)
    with pytest.raises(symseek.SceneError, match="there is none yet"):
        folder.save(session, "empty")


def test_nothing_outside_the_folder_is_read_or_written(folder, tmp_path):
    outside = tmp_path.parent / "outside.png"
    Image.fromarray((255 * PIXELS).astype(np.uint8)).save(outside)
    os.symlink(outside, tmp_path / "link.png")
    (tmp_path / "evil.toml").write_text('[[view]]\nimage = "../outside.png"\n[[object]]\nspine = [[1, 1], [40, 40]]\n')
    (tmp_path / "home.toml").write_text('[[view]]\nimage = "$HOME/x.png"\n[[object]]\nspine = [[1, 1], [40, 40]]\n')
    for name, value in (("moves", '"../outside*.png"'), ("listed", '["photo.png", "../outside.png"]')):
        (tmp_path / f"{name}.toml").write_text(f"[[view]]\nframes = {value}\n[[object]]\nspine = [[1, 1], [40, 40]]\n")
    files = [f"{name}.toml" for name in ("evil", "home", "moves", "listed")]
    for path in ("../outside.png", str(outside), "link.png", *files, "/etc/passwd"):
        with pytest.raises(symseek.SceneError, match="lies outside"):
            folder.open(path)
    session, _ = drawn(folder, *AXIS)
    with pytest.raises(symseek.SceneError, match="lies outside"):
        folder.write(session, "../x.html", "")
    assert not (tmp_path.parent / "x.html").exists()
    assert set(folder.listing()) == {"photo.png", "link.png", *files}


def test_files_at_fault_are_refused(folder, tmp_path):
    (tmp_path / "broken.png").write_bytes(b"not a picture")
    (tmp_path / "broken.toml").write_text("[[view]\n")
    (tmp_path / "large.toml").write_bytes(b"#" * 100_000_000)
    (tmp_path / "large.png").write_bytes(b"\0" * 100_000_000)
    for name, text in (
        ("broken.png", "not an image"),
        ("broken.toml", "not valid TOML"),
        ("large.toml", "100 MB"),
        ("large.png", "not an image"),
        ("none.png", "does not exist"),
    ):
        with pytest.raises(symseek.SceneError, match=text):
            folder.open(name)


def test_an_autosave_of_something_else_is_refused():
    for text in ("[]", '{"top": {}, "items": [1]}', "x"):
        with pytest.raises(ValueError):
            State.of(text)
    state = State({"name": "x"}, (Item(1, {"name": "a"}, "#ffffff"),))
    assert State.of(state.text()) == state


def test_an_axis_is_drawn_view_by_view(folder, tmp_path):
    """In the first of a stereo pair it is one at a guessed depth, in both of them the triangulated one."""
    Image.fromarray((255 * PIXELS).astype(np.uint8)).save(tmp_path / "right.png")
    session, _ = folder.open("photo.png + right.png")
    assert [v.name for v in session.views] == ["left", "right"]
    uid, shift = session.add(), 3.0
    for x, y in AXIS:
        session.add_point(uid, (x, y))
    assert session.item(uid).table["spine"] == AXIS
    tubes = []
    for x, y in AXIS:
        session.add_point(uid, (x - shift, y), view=1)
        tubes.append(session.tube(session.item(uid)))
    assert [tube is None for tube in tubes] == [True, False, False], "one point is no axis"
    tube = tubes[-1]
    assert session.axis(uid, 0) == AXIS and session.axis(uid, 1)[0] == [AXIS[0][0] - shift, AXIS[0][1]]
    depth = shift / (2 * ALPHA)  # (15): what the two columns differ by is 2 alpha Z
    assert tube is not None and np.abs(np.asarray(tube.spine)[:, 2] - depth).max() < 0.02 * depth
    with pytest.raises(symseek.SceneError, match="several views tell it"):
        session.move(uid, 1)
    with pytest.raises(symseek.SceneError, match="outside the image"):
        session.add_point(uid, (80, 10), view=1)
    full = folder.save(session, "pair")
    assert symseek.load(full).tubes[0].spine.tolist() == np.asarray(tube.spine).tolist()
    for k in (2, 1, 0):
        session.remove_point(uid, k, 1)
    assert "spines" not in session.item(uid).table and session.item(uid).table["spine"] == AXIS


def test_an_axis_in_views_from_around_waits_for_the_second_view():
    session, _ = Folder(cli.demos()["squash_ring"].parent).open("scene.toml")
    given_ = session.item(1).axes("view1")
    session.remove(1)
    uid = session.add()
    for point in given_["view1"]:
        session.add_point(uid, point)
    assert session.tube(session.item(uid)) is None, "its depth would be a guess that the others do not see"
    with pytest.raises(symseek.SceneError):
        session.tables()
    for point in given_["view3"]:
        session.add_point(uid, point, view=2)
    assert session.tube(session.item(uid)) is not None and session.tables()["object"][0]["spines"] == given_


def test_a_crease_is_painted(folder):
    session, uid = drawn(folder, *AXIS)
    session.paint(uid, [(3, 10), (3, 11)])
    session.paint(uid, [(4, 12)])
    material = session.item(uid).table["material"]
    zero = np.argwhere(np.array(material["w02"]) == 0).tolist()
    assert zero == [[3, 10], [3, 11], [4, 12]] and np.array(material["w02"]).shape == (25, 25)
    assert set(material) == {"w02"}, "rings stay round"
    session.undo()
    assert "material" not in session.item(uid).table, "one stroke and what follows at once are one step"
    session.set_weight(uid, {"w11": 1e-7})
    session.paint(uid, [(3, 10)])
    assert np.argwhere(np.array(session.item(uid).table["material"]["w11"]) == 0).tolist() == [[3, 10]]
