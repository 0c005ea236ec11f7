"""The panel beside the picture: buttons, sliders and running plots, and what they call."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from viser import GuiEvent, uplot

from symseek.sim.material import Material

from .drawing import rgb
from .film import Film
from .keep import IMAGES, PAIR
from .part import Snapshot
from .state import Item

if TYPE_CHECKING:
    from .page import Page

TOOLS = {
    "Draw": "click points along the object's axis, from one end to the other, then **Run**. Drag a point to move it, click "
    "on the line to put one between, shift-click to delete one. The magenta point is the radius: drag it, or shift-click "
    "it to take the image's.",
    "Pull": "drag any place of a model; let go, and it returns.",
    "Pin": "drag any place of a model; the spring stays where you let go, until **Undo**.",
    "Push": "press the mouse beside a model and move: it is pushed away.",
    "Crease": "click where the object has a sharp edge across, or paint one over the model.",
    "Gap": "click where the object is broken in two.",
    "Not here": "click on what is not the object.",
}
VIEWS = ("Through the camera", "In space")
NONE = "(none)"
SEVERAL = " In another view click it again, beginning at the same end (the white point)."
MARK = "● "
"""Before what is in force among some buttons."""
PLOTTED = 0.25
"""Seconds between two updates of plots and numbers."""


@dataclass(frozen=True)
class Slider:
    """A weight of the material, or two that go together."""

    label: str
    names: tuple[str, ...]
    low: float
    high: float
    logarithmic: bool = False
    """the slider counts in powers of ten about the default."""
    with_: tuple[str, float] | None = None
    """a weight that this one needs beside it."""

    @property
    def hint(self) -> str:
        return "powers of ten, 0: the default" if self.logarithmic else "0: none" if self.with_ else ""

    def values(self, at: float) -> dict[str, float | None]:
        """Weights for a place of the slider; None is the default."""
        if self.logarithmic:
            return {n: None if at == 0 else float(f"{getattr(Material(), n) * 10**at:.3g}") for n in self.names}
        out: dict[str, float | None] = {n: None if at == self.at({}) else at for n in self.names}
        return out | ({self.with_[0]: None if at == self.at({}) else self.with_[1]} if self.with_ else {})

    def at(self, material: dict[str, Any]) -> float:
        """The place of the slider for a table of weights."""
        first = getattr(Material(), self.names[0])
        value = material.get(self.names[0], first)
        if value is None:
            return self.low
        if not isinstance(value, int | float):
            return 0.0 if self.logarithmic else first
        place = float(np.log10(max(value, 1e-30) / first)) if self.logarithmic else float(value)
        return float(np.clip(round(place, 2), self.low, self.high))


SLIDERS = (
    Slider("Spine: rigidity", ("w2",), -3.0, 3.0, True),
    Slider("Tube: rigidity", ("w20", "w02"), -3.0, 3.0, True),
    Slider("Symmetry b", ("b",), 0.0, 4.0),
    Slider("Inflation c", ("c",), -0.3, 0.3),
    Slider("Spine: natural length", ("L1",), 0.0, 2.0, with_=("k1", 1.0)),
    Slider("Tube: natural length", ("L01",), 0.0, 2.0, with_=("k01", 1e-3)),
    Slider("Tube: natural girth", ("L10",), 0.0, 2.0, with_=("k10", 1e-3)),
)


class Controls:
    """The panel.

    Args:
        page: whose methods the buttons call.
    """

    def __init__(self, page: Page):
        self.page = page
        self._plotted = 0.0
        gui = self.gui = page.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(47, 120, 200))
        gui.set_panel_label("symseek studio")
        gui.main_panel.dock_right()
        self.hint = gui.add_markdown("")
        with gui.add_folder("File", expand_by_default=True):
            self.files = self._on(gui.add_dropdown("File", self._listing()), lambda _: setattr(self.second, "value", NONE))
            self.second = gui.add_dropdown("Right eye", [NONE, *self._listing(IMAGES)], hint="of a stereo pair")
            self._button("Open", self._open)
        with gui.add_folder("Model") as model:
            self.tools = self._buttons("Tool", tuple(TOOLS), self._take_tool)
            self._buttons("Run", ("Run", "Pause", "Step", "Reset"), page.run)
            self._buttons("Steps", ("Undo", "Redo"), page.undo)
            self.state = gui.add_markdown("")
            self.view = gui.add_button_group("View", VIEWS)
            self.eye = gui.add_dropdown("Through", ["-"], visible=False)
        self.frames = gui.add_folder("Frames", visible=False)
        with self.frames:
            self.frame = self._on(gui.add_slider("Frame", 0, 1, 1, 0), page.see)
            self._buttons("Film", ("Track", "Stop", "Back", "Next"), page.film)

        @self.view.on_click
        async def _(event: GuiEvent) -> None:
            if event.client is not None:
                page.look(event.client, event.target.value.removeprefix(MARK) == VIEWS[1])

        @self.eye.on_update
        async def _(event: GuiEvent) -> None:
            if event.client is not None and event.target.value in self.eye.options:
                page.look(event.client, page.in_space, self.eye.options.index(event.target.value))

        later = [model, self._objects(), self._shape()]
        with gui.add_folder("Plots", expand_by_default=False) as plots:
            self.residual = self._plot("residual force, powers of ten [lengths of the spine]", "#d62728")
            self.error = self._plot("contour to edge, mean [px]", "#1f77b4")
        with gui.add_folder("Keep") as keep:
            self.name = gui.add_text("Name", "")
            self._button("Save", lambda: page.save(self.name.value))
            self._button("Results", lambda: page.results(self.name.value))
            self._button("Web page", lambda: page.html(self.name.value))
            self._button("Start over", page.start_over)
        self.later = [*later, plots, keep]
        for folder in self.later:
            folder.visible = False

    def _button(self, label: str, what: Callable[[], Any]) -> None:
        self.gui.add_button(label).on_click(lambda _: what())

    def _buttons(self, label: str, options: Sequence[str], what: Callable[[str], Any]) -> Any:
        group = self.gui.add_button_group(label, options)

        @group.on_click
        async def _(event: GuiEvent) -> None:
            if event.client is not None:
                what(event.target.value.removeprefix(MARK))

        return group

    def _take_tool(self, tool: str) -> None:
        self.page.tool = tool
        self.page.refresh()

    def _listing(self, kinds: Iterable[str] = ()) -> list[str]:
        found = [f for f in self.page.folder.listing() if not kinds or Path(f).suffix.lower() in kinds]
        return found or ([] if kinds else ["(no image here)"])

    def _open(self) -> None:
        pair = "" if self.second.value == NONE else PAIR + self.second.value
        self.page.open(self.files.value + pair)

    def list_files(self, opened: bool = False) -> None:
        """Looks what there is in the folder now; after something was `opened`, chooses that."""
        first, second = tuple(self._listing()), (NONE, *self._listing(IMAGES))
        left, _, right = self.page.path.partition(PAIR)
        for field, options, own in ((self.files, first, left), (self.second, second, right or NONE)):
            if options != field.options:
                field.options = options
            if opened and self.page.session is not None and own in options:
                field.value = own

    def _on(self, handle: Any, what: Callable[[Any], Any]) -> Any:
        """Calls back with the value that a person gave, not with those that the studio set."""

        @handle.on_update
        async def _(event: GuiEvent) -> None:
            if event.client is not None:
                what(event.target.value)

        return handle

    def _chosen(self, what: Callable[[Any, int], Any]) -> None:
        uid = self.page.chosen
        if uid is not None:
            self.page.act(lambda session: what(session, uid))

    def _objects(self) -> Any:
        gui, page = self.gui, self.page
        with gui.add_folder("Object") as folder:
            self.objects = self._on(gui.add_dropdown("Chosen", ["-"]), self._choose)
            self._buttons("Objects", ("New", "Delete", "Nearer", "Further"), self._object)
            self.place = self._on(gui.add_slider("In depth, 1: nearest", 1, 2, 1, 1, visible=False), self._to_place)
            self.title = self._on(gui.add_text("Called", ""), lambda v: self._chosen(lambda s, uid: s.rename(uid, v)))
            self.colour = self._on(
                gui.add_rgb("Colour", (255, 255, 255)),
                lambda v: self._chosen(lambda s, uid: s.recolour(uid, "#{:02x}{:02x}{:02x}".format(*v))),
            )
            self.radius = self._on(
                gui.add_slider("Radius, 0: from the image", 0.0, 100.0, 0.5, 0.0),
                lambda v: self._chosen(lambda s, uid: s.set_radius(uid, v or None)),
            )
        self._uids: list[int] = []
        page.tool = "Draw"
        return folder

    def _shape(self) -> Any:
        gui = self.gui
        with gui.add_folder("Shape by hand", expand_by_default=False) as folder:
            self.sliders = []
            for slider in SLIDERS:
                first = slider.at({})
                handle = gui.add_slider(slider.label, slider.low, slider.high, 0.01, first, hint=slider.hint or None)
                self._on(handle, lambda v, s=slider: self._chosen(lambda x, uid: x.set_weight(uid, s.values(v))))
                self.sliders.append((slider, handle))
            self.shut = self._on(
                gui.add_checkbox("Ends shut", True),
                lambda v: self._chosen(lambda s, uid: s.set_weight(uid, {"closed": None if v else False})),
            )
            self._button("Clear creases, marks, springs", lambda: self._chosen(lambda s, uid: s.clear(uid)))
            self.speed = gui.add_slider("Iterations a second, at most", 50, 5000, 50, 1000)
            self._on(self.speed, lambda v: setattr(self.page.engine, "speed", float(v)))
        return folder

    def _plot(self, title: str, colour: str) -> Any:
        return self.gui.add_uplot(
            (np.zeros(1), np.zeros(1)), (uplot.Series(label="iteration"), uplot.Series(label="", stroke=colour, width=2)),
            title=title, height=150, scales={"x": uplot.Scale(time=False)}, legend=uplot.Legend(show=False),
        )  # fmt: skip

    def _choose(self, label: str) -> None:
        if label in self.objects.options and self._uids:
            self.page.chosen = self._uids[self.objects.options.index(label)]
            self.page.refresh()

    def _object(self, what: str) -> None:
        page = self.page
        if what == "New":
            page.act(lambda session: setattr(page, "chosen", session.add()))
            self._take_tool("Draw")
        elif what == "Delete":
            self._chosen(lambda s, uid: s.remove(uid))
        else:
            if page.session is not None:
                page.session.end_of_drag()
            self._chosen(lambda s, uid: s.move(uid, -1 if what == "Nearer" else 1))

    def _to_place(self, place: int) -> None:
        self._chosen(lambda s, uid: s.move(uid, place - s.place(uid)[0]))

    def update(self) -> None:
        """Shows the session's state."""
        page, session = self.page, self.page.session
        if session is None:
            self.hint.content = "**Open** a photograph or a scene file."
            return
        for folder in self.later:
            folder.visible = True
        self.tools.options = _marked(TOOLS, page.tool)
        self.view.options = _marked(VIEWS, VIEWS[page.in_space])
        more = SEVERAL if page.tool == "Draw" and len(session.views) > 1 else ""
        self.hint.content = f"**{page.tool}**: {TOOLS[page.tool]}{more}"
        self.frames.visible = session.moving
        if session.moving:
            self.frame.max = max(1, min(map(len, session.frames)) - 1)
        names = [view.name for view in session.views]
        self.eye.visible = len(names) > 1
        if tuple(names) != self.eye.options:
            self.eye.options = names
        self.eye.value = names[page.eye]
        items = session.state.items
        self._uids = [i.uid for i in items]
        labels = [_label(i, items) for i in items] or ["-"]
        if tuple(labels) != self.objects.options:
            self.objects.options = labels
        if not self.name.value:
            self.name.value = f"{session.name}-studio"
        item = next((i for i in items if i.uid == page.chosen), None)
        if item is None:
            return
        self.objects.value = labels[self._uids.index(item.uid)]
        place, count = session.place(item.uid)
        self.place.visible = count > 1 and len(session.views) == 1 and item.is_tube
        self.place.max, self.place.value = max(2, count), place
        self.title.value, self.colour.value = item.name, rgb(item.colour)
        height, width = session.view.image.shape[:2]
        self.radius.max = float(max(100.0, round(0.25 * min(height, width)) * session.scenery.scale))
        self.radius.value = float(min(item.table.get("radius") or 0.0, self.radius.max))
        material = dict(item.table.get("material", {}))
        for slider, handle in self.sliders:
            handle.value = slider.at(material)
        self.shut.value = bool(material.get("closed", True))

    def follow(self, s: Snapshot | None, line: Sequence[tuple[int, float, float]]) -> None:
        """Shows where the chosen object's run is; not at every call."""
        now = time.monotonic()
        if now - self._plotted < PLOTTED and not (s is None or s.done):
            return
        self._plotted = now
        session = self.page.session
        steps = "" if session is None else ". ".join(
            f"*{verb}*: {what}" for verb, what in (("Undo", session.can_undo), ("Redo", session.can_redo)) if what
        )  # fmt: skip
        film, frame = self.page.engine.film, self.page.engine.frame
        if film is not None and self.frame.value != frame:
            self.frame.value = frame
        self.state.content = _described(s, film, frame, self.page.engine.going()) + (f"  \n{steps}" if steps else "")
        if len(line) > 1:
            i, residual, error = (np.array(c, float) for c in zip(*line, strict=True))
            self.residual.data = (i, np.log10(np.maximum(residual, 1e-12)))
            self.error.data = (i, error)


def _label(item: Item, items: Sequence[Item]) -> str:
    depths = sorted(i.depth for i in items if i.is_tube)
    if not item.is_tube:
        return f"{item.name} ({item.table['kind']})"
    place = depths.index(item.depth) + 1
    return f"{item.name} [{place}]" if len(set(depths)) > 1 else item.name


def _marked(options: Iterable[str], chosen: str) -> tuple[str, ...]:
    return tuple(MARK + option if option == chosen else option for option in options)


def _described(s: Snapshot | None, film: Film | None, frame: int, going: bool) -> str:
    if film is not None and frame > 0:
        text = f"frame {frame} of 0 to {film.length - 1}"
        if s is None:
            return f"{text}, not tracked yet"
        where = "being put right" if not s.done else s.note or "followed"
        return f"{text}, {where}, contour {s.off:.2f} px from the image's edges"
    if s is None:
        return "Not drawn yet"
    if s.diverged:
        where = "**Diverged**: undo, or draw another axis; "
    elif s.done:
        where = "**At rest**, " if s.converged else "**Stopped**, not at rest, "
    elif s.iteration == 0 and not going:
        where = "**Ready to run**, "
    else:
        where = f"**{'Running' if going else 'Paused'}**, scale {s.stage + 1} of {s.stages}, "
    text = f"{where}iteration {s.iteration}, sigma {s.sigma:.1f} px"
    if s.support is not None:
        text += f", contour {s.support[0]:.2f} px from the image's edges, {s.support[1]:.0%} supported"
    return text
