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
from .handle import handle_of
from .keep import Folder
from .mouse import Mouse
from .part import Snapshot, Wish
from .session import Session
from .state import Item

RATE = 30
"""Most updates of the page a second; and at most half of a core's time goes into making them."""
FOV = 0.4
"""Of the viewer's eye through the scene's camera [rad]."""
MARGIN = 1.06
"""Of the view around the photograph."""
ASIDE = 1.15 * np.array([0.55, -0.35, -0.76])
"""From the photograph's middle to the eye that sees the models in space, beside its distance through the camera."""
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
        self._fitted: dict[int, tuple[float, np.ndarray]] = {}
        """for which aspect each window's eye was put where."""
        self._pictured: list[int] = []
        """which frame each view's photograph shows."""
        self._closed = threading.Event()
        server.scene.set_up_direction("-y")  # first of all: turned later, it puts an eye set meanwhile in a wrong place
        self.controls = Controls(self)
        server.on_client_connect(self._welcome)
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
                self.tell("Brought back", "what you had made of it before; *Start over* takes the file as it is.")
            for client in self.server.get_clients().values():
                self._through_camera(client)

        self.attempt(do)
        self.attempt(self.controls.list_files)
        self.refresh()

    def attempt(self, what: Callable[[], Any]) -> bool:
        """Does something; a fault of the input becomes a message on the page. Whether it was done."""
        try:
            what()
            return True
        except SceneError as problem:
            self.tell(problem.field or "Not possible", f"{problem.problem}; {problem.remedy}", "red")
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

    def refresh(self) -> None:
        """Brings controls and drawing up to date."""
        self._changed = True
        self.attempt(self.controls.update)

    def _wishes(self) -> dict[int, Wish]:
        assert self.session is not None
        tubes = [(item, self.session.tube(item)) for item in self.session.state.items]
        return {item.uid: Wish(item.structure(), tube) for item, tube in tubes if tube is not None}

    # the eye

    def _welcome(self, client: viser.ClientHandle) -> None:
        self.attempt(lambda: self._through_camera(client))
        self.refresh()

        @client.camera.on_update
        async def _(camera: viser.CameraHandle) -> None:
            set_for, place = self._fitted.get(client.client_id, (camera.aspect, camera.position))
            untouched = np.abs(camera.position - place).max() < 1e-3 * np.abs(place).max()
            if untouched and not self.in_space and abs(camera.aspect / set_for - 1) > 0.01:  # a panel takes its room, say
                self.attempt(lambda: self._through_camera(client))
            drawing = self.drawing
            if drawing is not None and drawing.seen_from(camera.position, camera.fov, camera.image_height):
                self._changed = True

    def _through_camera(self, client: viser.ClientHandle) -> None:
        """Puts a window's eye where the whole photograph fills it."""
        if self.drawing is None:
            return
        width, height = self.drawing.size
        aspect = client.camera.aspect or 1.5
        away = MARGIN * max(height, width / aspect) / (2 * np.tan(FOV / 2))
        middle = np.array([(width - 1) / 2, (height - 1) / 2, 0.0])
        with client.atomic():
            camera = client.camera
            camera.near, camera.far, camera.fov = 0.01 * away, 20 * away, FOV
            camera.up_direction = (0.0, -1.0, 0.0)
            camera.position, camera.look_at = middle - [0, 0, away], middle
        self._fitted[client.client_id] = aspect, middle - [0, 0, away]

    def look(self, client: viser.ClientHandle, in_space: bool, eye: int | None = None) -> None:
        """Through the camera of a view, by its number, or at the models in space before it."""
        with self.lock, self._painting:
            self.in_space, self.eye = in_space, self.eye if eye is None else eye
            if self.drawing is not None:
                self.drawing.look(self.eye, in_space)
        self._through_camera(client)
        if in_space and self.drawing is not None:
            with client.atomic():
                middle = client.camera.look_at
                out = np.linalg.norm(middle - client.camera.position)
                client.camera.position = middle + out * ASIDE
                client.camera.look_at = middle
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
            rest = "" if self.engine.at_rest() else " It is not at rest yet; `symseek run` goes on until it is."
            self.controls.list_files()
            self.tell("Saved", f"`{full.relative_to(self.folder.root)}`.{rest}", "green")

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
            text = f"{len(result.files)} files in `{out.relative_to(self.folder.root)}`."
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
            self.tell("Written", f"`{full.relative_to(self.folder.root)}`", "green")

        self.attempt(do)

    def _html(self) -> str:
        drawing, colours = self.drawing, self._colours()
        assert drawing is not None
        drawing.models(self.engine.snapshots, colours, True)
        width, height = drawing.size
        middle = np.array([(width - 1) / 2, (height - 1) / 2, 0.0])
        away = MARGIN * max(height, width / 1.5) / (2 * np.tan(FOV / 2))
        eye = self.server.initial_camera
        eye.fov, eye.near, eye.far, eye.up = FOV, 0.01 * away, 20 * away, (0.0, -1.0, 0.0)
        eye.position, eye.look_at = middle + 1.25 * away * ASIDE, middle  # windows of other shapes are to see all of it
        text = self.server.scene.as_html()
        self._changed = True
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
        self.server.flush()
        self.mouse.listen_to_models(drawing)
        self.engine.watched = self.chosen
        s = snapshots.get(self.chosen) if self.chosen is not None else None
        if self.chosen is not None and s is not None:
            error = s.off if s.frame else s.support[0] if s.support else np.nan
            line = self._plot.setdefault(self.chosen, [])
            if line and line[-1][0] > s.iteration:
                line.clear()
            if not line or s.iteration > line[-1][0]:
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
