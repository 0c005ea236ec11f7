"""Runs the models live, in a thread of its own: it alone calls the solver, the page hands it wishes and reads snapshots."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from symseek.device import prepare
from symseek.frames import Frames
from symseek.kernels import contour, coupling, depth, elastic, integrate, pole, spring
from symseek.pipeline import DepthPasses
from symseek.sim.assembly import maps_of
from symseek.sim.foreground import Foreground
from symseek.sim.order import in_order
from symseek.sim.problem import Settings, View
from symseek.sim.reconstruct import REFRESH, SCALES, Look
from symseek.sim.track import Tracking

from .film import Film
from .inbox import Inbox, answered
from .pace import FIRST, ROUND, Pace, yields
from .part import Part, Snapshot, Wish, first_difference, fixed, same_maps
from .shelf import Shelf

MEASURE = 0.2
"""Seconds between two measurements of the contour's error."""


class Engine:
    """The thread; `close` ends it.

    Attributes:
        snapshots: of each object by uid, replaced as a whole.
        speed: most iterations a second.
        watched: the object whose contour is measured on the way.
        failed: what went wrong in the thread, for the page to say.
        film: the frames of a moving scene, and the tubes on their way through them.
        fresh: set when there are new snapshots.
    """

    def __init__(self, device: str = "cpu"):
        self.device, self.speed = device, 1000.0
        self.snapshots: dict[int, Snapshot] = {}
        self.failed = ""
        self.watched: int | None = None
        self.film: Film | None = None
        self.fresh = threading.Event()
        self._parts: dict[int, Part] = {}
        self._views: list[View] = []
        self._settings = Settings()
        self._go: dict[int, bool] = {}
        self._inbox = Inbox()
        self._pace, self._measured = Pace(), 0.0
        self._look: Look | None = None
        self._looked = 0.0
        self._maps: dict[int, list[Foreground]] = {}
        self._depths: dict[int, float] = {}
        self._mapped: list[str] = []
        self._workers = max(1, (os.cpu_count() or 2) - 1)
        self._thread = threading.Thread(target=self._live, name="symseek-engine", daemon=True)
        self._thread.start()

    # wishes, from any thread

    def call(self, what: Callable[[], Any]) -> Future:
        """Has something done between two rounds."""
        return self._inbox.call(what)

    def show(
        self, views: list[View], settings: Settings, wishes: Mapping[int, Wish], fresh: bool = False,
        frames: Sequence[Frames] = (), tracking: Tracking | None = None, shelf: Shelf | None = None, state: str = "",
    ) -> Future:  # fmt: skip
        """Makes the runs those of these objects: what can go on goes on, what cannot is played again.

        Args:
            views: of all of them.
            settings: of the solver.
            wishes: by uid.
            fresh: another scene, of which nothing is known.
            frames, tracking, shelf: of it, if it moves, see `Film`.
            state: text of the session's state that the objects are of.
        """

        def do() -> None:
            if fresh:
                self._open(frames, tracking or Tracking(), shelf)
            if self.film is not None:
                self.film.state = state
            self._show(views, settings, dict(wishes))
            if self.film is not None and fresh and wishes and self.film.returns():
                self._set_going(True)

        return self.call(do)

    def see(self, frame: int) -> Future:
        """Shows a frame of a moving scene."""
        return self.call(lambda: self.film.see(frame) if self.film is not None else None)

    def track(self, on: bool = True) -> Future:
        """Lets the tubes go on through the frames, from the last one that they have been through, or stops them."""
        return self.call(lambda: self._set_tracking(on))

    def picture(self, frame: int) -> Future:
        """Images of a frame, one a view, or why there are none."""
        return self.call(lambda: self.film.reel.at(frame) if self.film is not None else "it does not move")

    def run(self, on: bool = True) -> Future:
        """Lets all go on, or pauses them."""
        return self.call(lambda: self._set_going(on))

    def step(self, count: int) -> Future:
        """Takes all on by some iterations, paused before and after."""
        return self.call(lambda: self._step(count))

    def reset(self) -> Future:
        """Puts all back to their starts, paused; wishes are to be shown anew."""
        return self.call(self._reset)

    def grab(
        self, uid: int, point: tuple[float, float], anchor: Sequence[float] | np.ndarray, push: bool = False, view: int = 0
    ) -> Future:
        """The mouse takes hold of a material point (x, s) of an object, or pushes it away from the anchor.

        Args:
            uid: which object.
            point: material coordinates (x, s) in [0, 1].
            anchor: image point, or world point.
            push: by a volcano.
            view: number of the view that the anchor is in, if it is an image point.
        """
        return self.call(lambda: self._hold(uid, point, tuple(map(float, anchor)), push, view))

    def drag(self, uid: int, anchor: Sequence[float] | np.ndarray) -> Future:
        """The mouse moves to another anchor."""
        mouse = tuple(map(float, anchor))
        return self.call(lambda: held.drag(mouse) if (held := self._holder(uid)) is not None else None)

    def let_go(self, uid: int, pin: bool = False) -> Future:
        """The mouse lets go, or leaves the spring pinned; the answer is the list of springs that it made."""
        return self.call(lambda: held.let_go(pin) if (held := self._holder(uid)) is not None else [])

    def settle(self) -> Future:
        """Plays again what did not go as `symseek run` will go, up to where it was; all of it where one hides another."""
        return self.call(self._settle)

    def at_rest(self) -> bool:
        """Whether nothing moves any more."""
        return all(s.done for s in self.snapshots.values())

    def going(self) -> bool:
        """Whether any is to go on, of those that are not at their ends."""
        film = self.film
        return any(part.active for part in list(self._parts.values())) or (film is not None and film.going)

    def close(self) -> None:
        """Ends the thread."""
        self._inbox.close()
        self._thread.join()

    @property
    def frame(self) -> int:
        """Of a moving scene, that is shown."""
        return 0 if self.film is None else self.film.frame

    # the thread

    def _live(self) -> None:
        prepare(self.device)
        for module in (elastic, coupling, contour, pole, integrate, spring, depth):
            wp.load_module(module, device=self.device)
        with (
            ThreadPoolExecutor(os.cpu_count(), initializer=yields) as self._ahead,
            ThreadPoolExecutor(self._workers, initializer=yields) as self._pool,
            DepthPasses() as self._depth,
        ):
            before = time.perf_counter()
            while True:
                idle = not self.going()
                calls = self._inbox.take(idle)
                if calls is None:
                    break
                before = time.perf_counter() if idle else before
                answered(calls, lambda: self._publish(True))
                now = time.perf_counter()
                try:
                    self._round(now - before, FIRST if idle else ROUND)
                except Exception as problem:  # a fault of ours must not end the studio
                    self.failed = f"{type(problem).__name__}: {problem}"
                    self._set_going(False)
                    self._set_tracking(False)
                before = now
                self._publish(False)
            for part in self._parts.values():
                part.run.stop()

    def _active(self) -> list[Part]:
        return [part for part in self._parts.values() if part.active]

    def _round(self, passed: float, most: float) -> None:
        """Takes all active runs on for about `most` seconds, no faster than `speed`."""
        begun, left = time.perf_counter(), max(1, round(self.speed * min(max(passed, most), 4 * ROUND)))
        if self.film is not None and self.film.going and not self._active():
            self._go_on(self.film, left, begun)
            return
        while left > 0 and self._active() and (spare := begun + most - time.perf_counter()) > 0:
            left -= self._advance(min(left, self._pace.iterations(spare)))
            if self._look is not None and self._looked > ROUND:  # it must not take all the time; `settle` makes up for it
                self._look.last += self._look.every * int(self._looked / ROUND)
        self._rest(begun, most)

    def _rest(self, begun: float, most: float = ROUND) -> None:
        """To the end of a round that began then, unless somebody wants something."""
        spare = begun + most - time.perf_counter()
        if self.going() and spare > 0:
            self._inbox.pause(spare)

    def _go_on(self, film: Film, most: int, begun: float) -> None:
        """Takes the tubes on through the frames after the first."""
        if not film.begun:
            self._settle()
            if self._active():
                return
            film.begin(self._parts)
        if film.going:
            film.go_on(most, begun + ROUND)
        self._rest(begun)

    def _advance(self, most: int) -> int:
        """Takes all active runs on together, to the next look at what hides them; by how many iterations."""
        parts, active = [part.run for part in self._parts.values()], self._active()
        if self.film is not None:  # tubes do not hide each other there
            self._take_on(active, most)
            return most
        if self._look is None:
            self._look = Look(parts, self._settings, self._depth)
            self._look.again(max(run.iteration for run in parts))
        count = min(most, max(1, self._look.every - (max(run.iteration for run in parts) - self._look.last)))
        self._take_on(active, count)
        begun = time.perf_counter()
        self._look.again(max(run.iteration for run in parts))
        self._looked = time.perf_counter() - begun
        return count

    def _take_on(self, active: Sequence[Part], count: int) -> None:
        """All of them by some iterations."""
        begun = time.perf_counter()
        list(self._pool.map(lambda part: part.run.advance(count), active))
        self._pace.took(time.perf_counter() - begun, count)

    def _publish(self, at_once: bool) -> None:
        if not at_once and self.going() and self._pace.early():
            return
        begun = time.perf_counter()
        self.snapshots = self._seen(begun)
        self._pace.published(begun)
        self.fresh.set()

    def _seen(self, now: float) -> dict[int, Snapshot]:
        if self.film is not None and (self.film.frame > 0 or self.film.begun):
            return self.film.snapshots()
        watched = self._parts.get(self.watched or -1)
        if watched is not None and (now - self._measured > MEASURE or not self._active()):
            watched.measure()
            self._measured = now
        return {uid: part.snapshot() for uid, part in self._parts.items()}

    # in the thread

    def _open(self, frames: Sequence[Frames], tracking: Tracking, shelf: Shelf | None) -> None:
        """Another scene, of which nothing is known."""
        self._go, self._mapped, self._maps = {}, [], {}
        self._remove(list(self._parts))
        self.film = Film(frames, tracking, self._ahead, shelf) if frames else None

    def _set_tracking(self, on: bool) -> None:
        film = self.film
        if film is not None and self._parts:
            film.tracking = on and film.count < film.length
            if film.tracking and not film.begun:
                self._set_going(True)

    def _holder(self, uid: int) -> Film | Part | None:
        """What holds what the mouse has taken hold of."""
        return self.film if self.film is not None and self.film.frame > 0 else self._parts.get(uid)

    def _back(self) -> None:
        """To the first frame as it was before the tubes left it."""
        if self.film is not None and self.film.begun:
            self.film.forget()
            for uid, part in list(self._parts.items()):
                self._play(uid, part.wish, part.run.iteration)

    def _in_film(self, film: Film, wishes: dict[int, Wish]) -> dict[int, Wish]:
        """Takes in what is wished of frames after the first; what changes the first one takes the tubes back to it."""
        first, springs = film.first_frame(wishes)
        before = {uid: fixed(part.wish) for uid, part in self._parts.items()}
        if {uid: fixed(wish) for uid, wish in first.items()} != before:
            self._back()
            film.frame = 0
        film.change(springs)
        film.keep()
        return first

    def _show(self, views: list[View], settings: Settings, wishes: dict[int, Wish]) -> None:
        wishes = wishes if self.film is None else self._in_film(self.film, wishes)
        self._views, self._settings, self._look = views, settings, None
        self._remove([uid for uid in self._parts if uid not in wishes])
        mapped = [wish.structure for wish in wishes.values()]
        if mapped != self._mapped:  # each is made with the others in mind
            tubes, _ = in_order(views[0], [wish.tube for wish in wishes.values()])
            found = maps_of(views, tubes) if wishes else []
            self._maps, self._mapped = dict(zip(wishes, found, strict=True)), mapped
            self._depths = {uid: tube.depth for uid, tube in zip(wishes, tubes, strict=True)}
        for uid, wish in wishes.items():
            part = self._parts.get(uid)
            if part is None or part.wish.structure != wish.structure or not same_maps(part.map, self._maps[uid]):
                self._begin(uid, wish)
                continue
            if wish.tube.springs != part.wish.tube.springs:
                self._play(uid, wish, first_difference(wish.tube.springs, part.wish.tube.springs))
                continue
            part.change(wish)
        self._parts = {uid: self._parts[uid] for uid in wishes}

    def _remove(self, uids: Sequence[int]) -> None:
        for uid in uids:
            self._parts.pop(uid).run.stop()

    def _begin(self, uid: int, wish: Wish) -> Part:
        """A run from its start, in the place of the one there was."""
        if (old := self._parts.get(uid)) is not None:
            self._go[uid] = old.go
        wish = replace(wish, tube=replace(wish.tube, depth=self._depths[uid], find_depth=False))
        ahead = self._ahead, max(1, SCALES // len(self._maps))
        part = Part(wish, self._views, self._maps[uid], self._settings, self.device, *ahead)
        part.go, self._parts[uid] = self._go.get(uid, False), part
        if old is not None:  # only now: whoever asks meanwhile whether any is going on is to hear the truth
            old.run.stop()
        return part

    def _play(self, uid: int, wish: Wish, until: int) -> None:
        """The same run with other springs, up to an iteration, before anybody sees it."""
        part, self._look = self._begin(uid, wish), None
        while part.run.iteration < until and not part.run.done:
            part.run.advance(until - part.run.iteration)

    def _set_going(self, on: bool) -> None:
        if self.film is not None and not on and not self.film.begun:
            self.film.forget()
        for uid, part in self._parts.items():
            part.go = self._go[uid] = on

    def _step(self, count: int) -> None:
        self._set_going(True)
        while count > 0 and self._active():
            count -= self._advance(count)
        self._set_going(False)

    def _reset(self) -> None:
        self._look = None
        if self.film is not None:
            self.film.reset()
        for uid, part in list(self._parts.items()):
            loose = tuple(s for s in part.wish.tube.springs if s.stop is None)
            tube = replace(part.wish.tube, springs=tuple(replace(s, start=0) for s in loose))
            self._begin(uid, Wish(part.wish.structure, tube)).go = False
            self._go[uid] = False

    def _hold(self, uid: int, point: tuple[float, float], mouse: tuple[float, ...], push: bool, view: int) -> None:
        if self.film is not None and self.film.frame > 0:
            self.film.hold(uid, point, mouse, push, view)
            return
        self._back()
        part = self._parts.get(uid)
        if part is not None:
            part.go, self._look = True, None
            self._go[uid] = True
            part.hold(point, mouse, push, view)

    def _settle(self) -> None:
        if self.film is not None and self.film.begun:  # it was before they left the first frame
            return
        if any(part.hides for part in self._parts.values()):  # then they go together
            for uid, part in list(self._parts.items()):
                self._begin(uid, part.wish).go = True
            self._look = None
            while self._active():
                self._advance(REFRESH)
            return
        for uid, part in list(self._parts.items()):
            if not part.path:
                self._play(uid, part.wish, part.run.iteration)
