"""The studio's engine and its guard, without a browser: what is seen is what `symseek run` finds, and who may ask."""

from __future__ import annotations

import http.client
import json
import shutil
import socket
import sys

import numpy as np
import pytest

import symseek
from symseek import cli
from symseek.scene import build
from symseek.sim.spring import Spring
from symseek.studio.engine import Engine
from symseek.studio.keep import Folder
from symseek.studio.page import Page
from symseek.studio.part import Wish
from symseek.studio.serve import Guard, Studio
from symseek.studio.session import Session

SQUASH = cli.demos()["squash"]


@pytest.fixture
def session() -> Session:
    return Folder(SQUASH.parent).open("scene.toml")[0]


def show(engine: Engine, session: Session, fresh: bool = False) -> None:
    wishes = {i.uid: Wish(i.structure(), tube) for i in session.state.items if (tube := session.tube(i)) is not None}
    how = session.scenery.tracking
    engine.show(session.views, session.settings(), wishes, fresh, session.frames, how).result(60)


def rest(engine: Engine) -> dict[int, np.ndarray]:
    """Tubes once nothing moves."""
    while engine.call(engine.going).result(60):
        pass
    return {uid: s.tube for uid, s in engine.snapshots.items()}


def again(session: Session) -> np.ndarray:
    """The first tube as `symseek run` finds it."""
    scene = build(session.tables(), session.base, "again")
    return symseek.reconstruct(scene).objects[0].tube[0]


def record(session: Session, springs: list[Spring]) -> None:
    session.record(1, session.written(springs))


def test_a_live_run_ends_where_symseek_run_does(engine, session):
    show(engine, session, fresh=True)
    assert engine.snapshots[1].iteration == 0 and not engine.going()
    engine.step(3).result(60)
    assert engine.snapshots[1].iteration == 3
    engine.run().result(60)
    assert np.array_equal(rest(engine)[1], again(session))
    assert engine.snapshots[1].converged and engine.at_rest()
    engine.reset().result(60)
    assert engine.snapshots[1].iteration == 0 and not engine.going()


def test_pulls_are_played_again_and_taken_back(engine, session):
    """A pull in the image, a pin in space, a push: the same in a run from the start; without them it is as before.

    At given iterations, each with some in between: where a person's mouse was at which one is another path every time.
    """

    def hold(*how, **more):
        engine.call(lambda: (engine._hold(1, *how, more.get("push", False), 0), engine._set_going(False))).result(60)
        engine.step(7).result(60)

    def let_go(pin=False):
        made = engine.let_go(1, pin).result(60)
        record(session, made)
        show(engine, session)
        return made

    show(engine, session, fresh=True)
    engine.run().result(60)
    first = rest(engine)[1]
    edge = first[6, 12]
    hold((0.24, 0.5), tuple(edge[:2]))
    for k in range(10):
        engine.drag(1, edge[:2] + k * np.array([1.5, -3.0])).result(60)
        engine.step(12).result(60)
    assert engine._parts[1].run.iteration == engine.snapshots[1].iteration and len(engine.snapshots[1].pulls) == 5
    assert len(let_go()) == 50, "five springs at each of ten places"
    engine.run().result(60)
    pulled = rest(engine)[1]
    assert engine.snapshots[1].pulls == []
    near = first[12, 6]
    hold((0.48, 0.25), tuple(near - np.array([0, 10, 15])))
    let_go(pin=True)
    hold((0.0, 0.0), (300.0, 360.0), push=True)
    engine.drag(1, (300.0, 350.0)).result(60)
    engine.step(20).result(60)
    let_go()
    engine.run().result(60)
    last = rest(engine)[1]
    assert np.abs(last - pulled).max() > 3 and engine.snapshots[1].converged
    assert np.array_equal(last, again(session))
    session.undo()
    session.undo()
    show(engine, session)
    assert np.array_equal(rest(engine)[1], pulled)
    session.undo()
    show(engine, session)
    assert np.array_equal(rest(engine)[1], first)
    session.redo()
    show(engine, session)
    assert np.array_equal(rest(engine)[1], pulled)


def test_a_pull_in_another_view_is_played_again(engine):
    """Views from around: the spring acts in the plane of the view that it was drawn in, live and in the saved scene."""
    session = Folder(cli.demos()["squash_ring"].parent).open("scene.toml")[0]
    show(engine, session, fresh=True)
    engine.run().result(60)
    first = rest(engine)[1]
    camera = session.views[2].camera
    seen = camera.project(first[:, 12])
    at = int(seen[:, 0].argmax())
    engine.grab(1, (at / 25, 0.5), seen[at], view=2)
    for k in range(10):
        engine.drag(1, seen[at] + k * np.array([2.0, 0.0])).result(60)
    while camera.project(engine.snapshots[1].tube[at, 12])[0] < seen[at, 0] + 9:
        engine.call(lambda: None).result(60)
    engine.step(2).result(60)
    (pull, *_) = engine.snapshots[1].pulls
    np.testing.assert_allclose(camera.project(pull)[1], seen[at] + [18.0, 0.0], atol=1e-3)
    engine.run().result(60)
    made = engine.let_go(1).result(60)
    record(session, made)
    assert {s["view"] for s in session.item(1).table["spring"]} == {"view3"}
    show(engine, session)
    assert np.array_equal(rest(engine)[1], again(session))


def test_a_lens_that_bends(engine, tmp_path):
    """The model grows onto the straight image, is pulled there, and the saved scene, in the bent one, gives the same."""
    shutil.copy(SQUASH.parent / "squash.jpg", tmp_path)
    points = symseek.load(SQUASH).tubes[0].spine.tolist()
    (tmp_path / "bent.toml").write_text(
        '[[view]]\nimage = "squash.jpg"\nprojection = "perspective"\nK = [[1000, 0, 320], [0, 1000, 240], [0, 0, 1]]\n'
        "R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nt = [0, 0, 0]\ndistortion = [-0.1, 0, 0, 0]\n"
        f"[[object]]\nspine = {points}\ndepth = 1000\n"
    )
    session = Folder(tmp_path).open("bent.toml")[0]
    show(engine, session, fresh=True)
    engine.run().result(60)
    first, camera = rest(engine)[1], session.view.camera
    edge = camera.project(first[6, 12])
    engine.grab(1, (0.24, 0.5), edge)
    for k in range(5):
        engine.drag(1, edge + k * np.array([1.5, -3.0])).result(60)
    record(session, engine.let_go(1).result(60))
    show(engine, session)
    assert np.array_equal(rest(engine)[1], again(session)) and engine.snapshots[1].converged


def test_a_grip_that_never_pulled_leaves_nothing(engine, session):
    """Taken hold of and let go between two iterations."""
    show(engine, session, fresh=True)
    engine.run().result(60)
    first = rest(engine)[1]

    def both():
        part = engine._parts[1]
        part.hold((0.2, 0.5), (200.0, 200.0), False)
        return part.let_go(False)

    assert engine.call(both).result(60) == []
    assert np.abs(rest(engine)[1] - first).max() < 0.05
    engine.settle().result(60)
    assert np.array_equal(rest(engine)[1], first)


def test_a_weight_changes_on_the_way_and_is_played_again(engine, session):
    """Live it goes on from where it is; `settle` makes of it what the saved scene gives."""
    show(engine, session, fresh=True)
    engine.run().result(60)
    first = rest(engine)[1]
    session.set_weight(1, {"w20": 1e-3, "b": 0.2})
    show(engine, session)
    assert engine.going()
    live, wanted = rest(engine)[1], again(session)
    assert np.abs(live - first).max() > 0.3
    engine.settle().result(60)
    assert np.array_equal(rest(engine)[1], wanted)
    session.set_weight(1, {"closed": False})
    show(engine, session)
    assert np.array_equal(rest(engine)[1], again(session)), "another structure goes on by itself"


def test_two_objects_run_side_by_side(engine, tmp_path):
    shutil.copy(cli.demos()["snake"].parent / "still_life.jpg", tmp_path)
    session = Folder(tmp_path).open("still_life.jpg")[0]
    for points in ([[198, 100], [198, 250], [198, 400]], [[400, 300], [480, 300], [560, 300]]):
        uid = session.add()
        for point in points:
            session.add_point(uid, point)
    show(engine, session, fresh=True)
    engine.run().result(60)
    tubes = rest(engine)
    assert set(tubes) == {1, 2}
    session.remove(1)
    show(engine, session)
    assert set(engine.snapshots) == {2} and np.array_equal(rest(engine)[2], tubes[2])


def test_objects_hide_each_other_in_their_order_of_depth(engine, tmp_path):
    """What the nearer one covers is hidden from the further one, and a saved scene says the same."""
    shutil.copy(SQUASH.parent / "squash.jpg", tmp_path)
    axes = symseek.load(SQUASH).tubes[0].spine.tolist(), [[270, 190], [290, 270], [300, 350]]
    objects = [f'[[object]]\nname = "{name}"\nspine = {axis}\n' for name, axis in zip("ab", axes, strict=True)]
    text = '[solver]\niterations = 200\n[[view]]\nimage = "squash.jpg"\n'
    (tmp_path / "two.toml").write_text("".join([text, *objects, "radius = 15.0\n"]))
    session = Folder(tmp_path).open("two.toml")[0]
    session.move(2, -1)
    show(engine, session, fresh=True)

    def hidden() -> list[bool]:
        return [engine._parts[uid].run.scene.hidden[0][0] is not None for uid in (1, 2)]

    engine.step(1).result(60)
    assert session.place(2) == (1, 2) and hidden() == [True, False]
    session.move(2, 1)
    show(engine, session)
    engine.step(1).result(60)
    assert session.place(2) == (2, 2) and hidden() == [False, True]
    engine.settle().result(60)
    objects = symseek.reconstruct(build(session.tables(), session.base, "again")).objects
    assert all(np.array_equal(engine.snapshots[uid].tube, objects[uid - 1].tube[0]) for uid in (1, 2))
    assert hidden() == [False, True]


def test_a_fault_in_the_thread_is_told_and_survived(engine, session):
    def fault():
        raise RuntimeError("broken")

    with pytest.raises(RuntimeError, match="broken"):
        engine.call(fault).result(60)
    show(engine, session, fresh=True)
    engine._parts[1].run.advance = lambda count: fault()
    engine.run().result(60)
    while not engine.failed:
        engine.call(lambda: None).result(60)
    assert "broken" in engine.failed and not engine.going()


def test_without_viser_the_command_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert cli.main(["studio"]) == 1
    assert "pip install 'symseek[studio]'" in capsys.readouterr().err


def test_a_file_outside_is_refused_by_the_command(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["studio", "../x.png", "--port", "0"]) == 2
    assert "lies outside" in capsys.readouterr().err
    assert cli.main(["studio", "x.png", "--port", "0"]) == 2
    assert "does not exist" in capsys.readouterr().err


class Request:
    def __init__(self, path="/", **headers):
        self.path, self.headers = path, {"Host": "127.0.0.1:8080", **headers}


def test_who_may_ask():
    own, far = Guard(""), Guard("secret")
    assert own.refuses(Request()) is None  # pyright: ignore
    assert own.refuses(Request(Host="localhost:1", Origin="http://localhost:1")) is None  # pyright: ignore
    assert own.refuses(Request(Host="evil.example:8080")) is not None, "a name that leads here"  # pyright: ignore
    assert own.refuses(Request(Origin="http://evil.example")) is not None  # pyright: ignore
    assert own.refuses(Request(Origin="http://127.0.0.1:9")) is not None, "another server of this machine"  # pyright: ignore
    assert far.refuses(Request("/?token=secret", Host="far:80")) is None  # pyright: ignore
    assert far.refuses(Request(Cookie="a=b; symseek-studio=secret", Host="far:80")) is None  # pyright: ignore
    for request in (Request(), Request("/?token=Secret"), Request("/?token="), Request(Cookie="symseek-studio=x"),
                    Request(Cookie="symseek-studio=secret", Origin="http://evil.example")):  # fmt: skip
        answer = far.refuses(request)  # pyright: ignore
        assert answer is not None and answer.status_code == 403


def _ask(port: int, path: str, **headers: str) -> tuple[int, bytes, str]:
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    try:
        link.request("GET", path, headers=headers)
        answer = link.getresponse()
        return answer.status, answer.read(), answer.getheader("Set-Cookie") or ""
    finally:
        link.close()


def test_the_server_serves_its_page_and_no_file(tmp_path):
    """By token on all addresses; files, paths out of the folder, floods and other pages are refused, and it lives on."""
    shutil.copy(SQUASH.parent / "squash.jpg", tmp_path)
    studio = Studio(["squash.jpg"], tmp_path, host="0.0.0.0", port=0)
    try:
        port = studio.server.get_port()
        assert f"?token={studio.token}" in studio.address and len(studio.token) > 20
        assert _ask(port, "/")[0] == 403
        assert _ask(port, "/?token=wrong")[0] == 403
        status, page, cookie = _ask(port, f"/?token={studio.token}")
        assert status == 200 and b"<html" in page and studio.token in cookie and "HttpOnly" in cookie
        known = {"Cookie": cookie.split(";")[0]}
        for path in ("/../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/squash.jpg", "//etc/passwd"):
            assert _ask(port, path, **known)[0] == 404
        upgrade = {
            "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        }  # fmt: skip
        assert _ask(port, "/", **upgrade)[0] == 403
        assert _ask(port, "/", **upgrade, **known, Origin="http://evil.example")[0] == 403
        with socket.create_connection(("127.0.0.1", port), 20) as link:
            try:
                link.sendall(b"GET /?token=" + b"x" * 100_000_000)
                assert b"200" not in link.recv(100)
            except OSError:  # it hung up
                pass
        assert _ask(port, "/", **known)[0] == 200
    finally:
        studio.close()


def test_a_flood_by_websocket_is_cut_off(tmp_path):
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    studio = Studio([], tmp_path, port=0)
    try:
        address = studio.address.replace("http", "ws")
        protocol = ["viser-v" + __import__("viser").__version__]
        with connect(address, subprotocols=protocol, compression=None, max_size=None) as link:  # pyright: ignore
            with pytest.raises(ConnectionClosed):
                link.send(b"\0" * 100_000_000)
                while True:
                    link.recv(timeout=20)
        with connect(address, subprotocols=protocol, max_size=None) as link:  # pyright: ignore
            assert link.recv(timeout=20)
    finally:
        studio.close()


def test_bad_files_are_messages_on_the_page(tmp_path):
    (tmp_path / "broken.png").write_bytes(b"nothing")
    shutil.copy(SQUASH.parent / "squash.jpg", tmp_path)
    studio = Studio(["squash.jpg"], tmp_path, port=0)
    try:
        page: Page = studio.page
        for path, text in (("broken.png", "not an image"), ("../x.png", "lies outside"), ("none.toml", "no such scene")):
            page.open(path)
            assert text in page.told[1] and page.path == "squash.jpg"
        page.save("../x")
        assert not (tmp_path.parent / "x.toml").exists()
        page.save("/etc/x")
        assert "fault" not in page.told[0]
        assert page.act(lambda session: session.add_point(1, (100, 100)))
        kept = json.loads((tmp_path / ".symseek-studio" / "squash.jpg.json").read_text())
        assert kept["items"][0]["table"]["spine"] == [[100.0, 100.0]], "kept at each step"
    finally:
        studio.close()
    with pytest.raises(symseek.SceneError, match="lies outside"):
        Studio(["../squash.jpg"], tmp_path, port=0)
