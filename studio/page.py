"""The page: what is clicked and dragged becomes a step of the session or a pull on the engine, and all of it is drawn."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import viser

from symseek.checks import SceneError
from symseek.pipeline import run as run_scene
from symseek.sim.initial import lift
from symseek.sim.spring import Spring

from .controls import Controls
from .drawing import Drawing, Frame
from .engine import Engine
from .eyes import ASIDE, FOV, Eyes, away, middle
from .handle import handle_of
from .keep import Folder
from .marks import marks_of
from .mouse import Mouse
from .part import Snapshot, Wish
from .session import Session
from .state import Item

RATE = 30
"""Most updates of the page a second; and at most half of a core's time goes into making them."""
KEPT = 400
"""Points of a running plot."""


class Page:
    """One session, the same in every window.

    Args:
        server: of viser.
        folder: that may be read and written.
        engine: that runs the models.
    """

    def __init__(self, server: viser.ViserServer, folder: Folder, engine: Engine):
        self.server, self.folder, self.engine = server, folder, engine
        self.lock, self._painting = threading.RLock(), threading.Lock()
        self.session: Session | None = None
        self.path = ""
        self.chosen: int | None = None
        self.tool, self.in_space, self.eye = "Draw", False, 0
        self.told, self._told_at = ("", ""), 0.0
        self.drawing: Drawing | None = None
        self.mouse = Mouse(self)
        self._plot: dict[int, list[tuple[int, float, float]]] = {}
        self._changed = True
        self.eyes = Eyes(self)
        self._pictured: list[int] = []
        """which frame each view's photograph shows."""
        self._closed = threading.Event()
        server.scene.set_up_direction("-y")  # first of all: turned later, it puts an eye set meanwhile in a wrong place
        self.controls = Controls(self)
        server.on_client_connect(self.eyes.welcome)
        self._thread = threading.Thread(target=self._keep_drawing, name="symseek-page", daemon=True)
        self._thread.start()

    # scenes

    def open(self, path: str) -> None:
        """Opens an image or a scene file; on a fault says so and stays where it is."""

        def do() -> None:
            session, restored = self.folder.open(path)
            frames = [Frame(view, depth) for view, depth in zip(session.views, session.depths(), strict=True)]
            with self.lock, self._painting:
                self.session, self.path = session, path
                self.drawing = Drawing(self.server.scene, session.views, frames)
                self._plot, self.in_space, self.eye = {}, False, 0
                items = session.state.items
                self.chosen = items[0].uid if items else session.add()
                self.mouse.listen(self.drawing)
                self._pictured = [0] * len(session.views)
                self.engine.show(
                    session.views, session.settings(), self._wishes(), True, session.frames, session.scenery.tracking,
                    self.folder.shelf(path), session.state.text(),
                )  # fmt: skip
            if restored:
                self.tell("Brought back", "what you had made of it before; Start over takes the file as it is.")
            for client in self.server.get_clients().values():
                self.eyes.through_camera(client)

        self.attempt(do, "Not opened")
        self.attempt(lambda: self.controls.list_files(True))
        self.refresh()

    def attempt(self, what: Callable[[], Any], title: str = "") -> bool:
        """Does something; a fault of the input becomes a message on the page, of some title. Whether it was done."""
        try:
            what()
            return True
        except SceneError as problem:
            text = f"{problem.problem}; {problem.remedy}".replace(f"{self.folder.root}/", "")
            self.tell(title or problem.field or "Not possible", text, "red")
        except Exception as problem:  # a dead server would lose what was made
            self.tell("A fault of the studio", f"{type(problem).__name__}: {problem}", "red")
        return False

    def tell(self, title: str, text: str, colour: Any = None) -> None:
        """A message in every window; of the same ones in a row only the first."""
        now = time.monotonic()
        if self.told == (title, text) and now - self._told_at < 3.0:
            return
        self.told, self._told_at = (title, text), now
        for client in self.server.get_clients().values():
            client.add_notification(title, text, color=colour, auto_close_seconds=8.0)

    def act(self, what: Callable[[Session], Any]) -> bool:
        """A step of the session, kept and shown."""

        def do() -> None:
            if self.session is None:
                raise SceneError("", "", "nothing is open", "choose a file and open it")
            what(self.session)

        with self.lock:  # the engine is to hear of steps in their order
            done = self.attempt(do)
            self.show()
        return done

    def show(self) -> None:
        """Hands the session's state to engine, autosave and controls."""

        def do() -> None:
            if self.session is None:
                return
            with self.lock:
                uids = [i.uid for i in self.session.state.items]
                if self.chosen not in uids:
                    self.chosen = uids[-1] if uids else None
                text = self.session.state.text()
                self.engine.show(self.session.views, self.session.settings(), self._wishes(), state=text)
                self.folder.autosave(self.path, self.session)

        self.attempt(do)
        self.refresh()

    def draw_anew(self) -> None:
        """Soon."""
        self._changed = True

    def refresh(self) -> None:
        """Brings controls and drawing up to date."""
        self._changed = True
        self.attempt(self.controls.update)

    def _wishes(self) -> dict[int, Wish]:
        assert self.session is not None
        tubes = [(item, self.session.tube(item)) for item in self.session.state.items]
        return {item.uid: Wish(item.structure(), tube) for item, tube in tubes if tube is not None}

    # the eye

    def look(self, client: viser.ClientHandle, in_space: bool, eye: int | None = None) -> None:
        """Through the camera of a view, by its number, or at the models in space before it."""
        with self.lock, self._painting:
            self.in_space, self.eye = in_space, self.eye if eye is None else eye
            if self.drawing is not None:
                self.drawing.look(self.eye, in_space)
        self.eyes.look(client, in_space)
        self.refresh()

    # runs

    def record(self, uid: int, springs: Sequence[Spring]) -> None:
        """What was pulled becomes a step."""
        if springs:
            self.act(lambda session: session.record(uid, session.written(springs)))

    def run(self, what: str) -> None:
        """Run, pause, step or reset."""
        if what == "Run":
            if self.session is not None and not self._wishes():
                self.tell("Nothing to run", "click two points or more along the object's axis")
            self.engine.run()
        elif what == "Pause":
            self.engine.run(False)
        elif what == "Step":
            self.engine.step(1)
        elif self.session is not None:
            self.engine.reset()
            self._plot = {}
            self.act(lambda session: session.forget_pulls())
        self._changed = True

    def film(self, what: str) -> None:
        """Track, stop, or a frame back or on."""
        if what in ("Track", "Stop"):
            if what == "Track" and self.session is not None and not self._wishes():
                self.tell("Nothing to track", "click two points or more along the object's axis")
            self.engine.track(what == "Track")
        else:
            self.see(self.engine.frame + (1 if what == "Next" else -1))
        self._changed = True

    def see(self, frame: int) -> None:
        """Shows a frame."""
        self.engine.see(frame)
        self._changed = True

    def undo(self, what: str) -> None:
        """Undo or redo."""
        self.act(lambda session: session.undo() if what == "Undo" else session.redo())

    def start_over(self) -> None:
        """To what the file holds."""
        self.act(lambda session: session.start_over(self.folder.first(self.path)))

    def save(self, name: str) -> None:
        """Writes the scene file, and plays again what `symseek run` would do otherwise."""

        def do() -> None:
            full = self._saved(name)
            self.engine.settle()
            rest = "" if self.engine.at_rest() else " It is not at rest yet; symseek run goes on until it is."
            self.controls.list_files()
            self.tell("Saved", f"{full.relative_to(self.folder.root)}.{rest}", "green")

        self.attempt(do)

    def _saved(self, name: str) -> Path:
        if self.session is None:
            raise SceneError("", "", "nothing is open", "choose a file and open it")
        with self.lock:
            return self.folder.save(self.session, name)

    def results(self, name: str) -> None:
        """Saves, and runs what was saved in the engine's thread: meshes, measures, pictures."""

        def do() -> None:
            full = self._saved(name)
            out = self.folder.inside(full.with_suffix(""))
            self.tell("Working", "meshes, measures and pictures are being made")
            result = self.engine.call(lambda: run_scene(full, out, self.engine.device)).result()
            doubts = [f"{o.name}: {w}" for o in result.objects for w in o.warnings]
            text = f"{len(result.files)} files in {out.relative_to(self.folder.root)}."
            self.tell("Not to be trusted" if doubts else "Done", " ".join([text, *doubts]), "red" if doubts else "green")

        self.attempt(do)

    def html(self, name: str) -> None:
        """Writes the page as it is, to be opened without a server."""

        def do() -> None:
            if self.session is None:
                raise SceneError("", "", "nothing is open", "choose a file and open it")
            with self._painting:
                text = self._html()
            full = self.folder.write(self.session, f"{name}.html", text)
            self.tell("Written", f"{full.relative_to(self.folder.root)}", "green")

        self.attempt(do)

    def _html(self) -> str:
        drawing, colours = self.drawing, self._colours()
        assert drawing is not None
        out, at = away(drawing.size, 1.5), middle(drawing.size)
        eye = self.server.initial_camera
        eye.fov, eye.near, eye.far, eye.up = FOV, 0.01 * out, 20 * out, (0.0, -1.0, 0.0)
        eye.position, eye.look_at = at + 1.25 * out * ASIDE, at  # windows of other shapes are to see all of it
        with self.server.atomic():  # windows are not to see it
            drawing.look(self.eye, True)
            drawing.models(self.engine.snapshots, colours, True)
            text = self.server.scene.as_html()
            drawing.look(self.eye, self.in_space)
            drawing.models(self.engine.snapshots, colours, self.in_space)
        return text

    def _colours(self) -> dict[int, str]:
        return {} if self.session is None else {i.uid: i.colour for i in self.session.state.items}

    # drawing

    def _keep_drawing(self) -> None:
        before: Any = None
        spent = 0.0
        while not self._closed.wait(max(1 / RATE - spent, spent)):
            self.engine.fresh.wait(1 / RATE)
            self.engine.fresh.clear()
            begun, spent = time.thread_time(), 0.0
            snapshots = self.engine.snapshots
            if self.engine.failed:
                self.tell("A fault of the studio", self.engine.failed, "red")
                self.engine.failed = ""
            if snapshots is before and not self._changed:
                continue
            before, self._changed = snapshots, False
            self.attempt(lambda snapshots=snapshots: self._draw(snapshots))
            spent = time.thread_time() - begun

    def _draw(self, snapshots: dict[int, Snapshot]) -> None:
        with self._painting:
            self._paint(snapshots)

    def _paint(self, snapshots: dict[int, Snapshot]) -> None:
        session, drawing = self.session, self.drawing
        if session is None or drawing is None:
            return
        colours = self._colours()
        snapshots = {uid: s for uid, s in snapshots.items() if uid in colours}
        self._picture(session, drawing)
        with self.server.atomic():
            drawing.models(snapshots, colours, self.in_space)
            items = [item for item in session.state.items if item.is_tube]
            drawing.axes([self._axis(item) for item in items], self.handle() if self.tool == "Draw" else None)
            marked = [] if self.engine.frame > 0 else items
            drawing.marks([m for i in marked for m in marks_of(session, i, snapshots.get(i.uid), self.eye)])
        self.server.flush()
        self.mouse.listen_to_models(drawing)
        self.engine.watched = self.chosen
        s = snapshots.get(self.chosen) if self.chosen is not None else None
        if self.chosen is not None and s is not None:
            error = s.off if s.frame else s.support[0] if s.support else np.nan
            line = self._plot.setdefault(self.chosen, [])
            if line and line[-1][0] > s.iteration:
                line.clear()
            known = np.isfinite([s.residual, error]).all()
            if known and (not line or s.iteration > line[-1][0]):
                line.append((s.iteration, s.residual, error))
                del line[:-KEPT]
        self.controls.follow(s, self._plot.get(self.chosen or -1, []))

    def _picture(self, session: Session, drawing: Drawing) -> None:
        """Shows the frame in hand."""
        film, frame = self.engine.film, self.engine.frame
        if film is None or not session.moving or self._pictured[self.eye] == frame:
            return
        images = film.reel.known(frame) or self.engine.picture(frame).result()
        if not isinstance(images, str):
            drawing.picture(self.eye, images[self.eye])
        self._pictured[self.eye] = frame

    def _axis(self, item: Item) -> tuple[np.ndarray, str, bool]:
        assert self.session is not None
        session, view = self.session, self.session.views[self.eye]
        if self.engine.frame > 0:
            return np.zeros((0, 2)), item.colour, False
        chosen = item.uid == self.chosen and self.tool == "Draw"
        points = np.array(([] if item.in_world else session.axis(item.uid, self.eye)) or np.zeros((0, 2)), float)
        tube = None if len(points) else session.tube(item)
        if tube is None:
            return points, item.colour, chosen
        spine = np.asarray(tube.spine, float)  # not drawn here: as it lies in the world
        world = spine if spine.shape[1] == 3 else lift(spine, session.view.camera, tube.depth)
        return view.camera.project(world), item.colour, False

    def handle(self) -> np.ndarray | None:
        """Of the chosen object's radius in the view in hand, see `handle_of`."""
        uid, session = self.chosen, self.session
        if uid is None or session is None or self.engine.frame > 0:
            return None
        return handle_of(session, uid, self.eye, self.engine.snapshots.get(uid))

    def close(self) -> None:
        """Ends the drawing."""
        self._closed.set()
        self._thread.join()
