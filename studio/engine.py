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
from symseek.kernels import contour, coupling, elastic, integrate, pole, spring
from symseek.pipeline import DepthPasses
from symseek.sim.assembly import maps_of
from symseek.sim.foreground import Foreground
from symseek.sim.order import in_order
from symseek.sim.problem import Settings, View
from symseek.sim.reconstruct import REFRESH, Look
from symseek.sim.spring import Spring

from .part import Part, Snapshot, Wish

ROUND = 0.02
"""Seconds between two looks at what the page wants."""
PUBLISH = 1 / 40
"""Seconds between two snapshots, at the least."""
MEASURE = 0.2
"""Seconds between two measurements of the contour's error."""


class Engine:
    """The thread; `close` ends it.

    Attributes:
        snapshots: of each object by uid, replaced as a whole.
        speed: most iterations a second.
        watched: the object whose contour is measured on the way.
        failed: what went wrong in the thread, for the page to say.
    """

    def __init__(self, device: str = "cpu"):
        self.device, self.speed = device, 1000.0
        self.snapshots: dict[int, Snapshot] = {}
        self.failed = ""
        self.watched: int | None = None
        self._parts: dict[int, Part] = {}
        self._views: list[View] = []
        self._settings = Settings()
        self._go: dict[int, bool] = {}
        self._calls: list[tuple[Callable[[], Any], Future]] = []
        self._wake = threading.Condition()
        self._closed = False
        self._published, self._measured = 0.0, 0.0
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
        answer: Future = Future()
        with self._wake:
            if self._closed:
                raise RuntimeError("the engine is closed")
            self._calls.append((what, answer))
            self._wake.notify()
        return answer

    def show(self, views: list[View], settings: Settings, wishes: Mapping[int, Wish], fresh: bool = False) -> Future:
        """Makes the runs those of these objects: what can go on goes on, what cannot is played again.

        Args:
            views: of all of them.
            settings: of the solver.
            wishes: by uid.
            fresh: another scene, of which nothing is known.
        """
        return self.call(lambda: self._show(views, settings, dict(wishes), fresh))

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
        return self.call(lambda: self._parts[uid].drag(mouse) if uid in self._parts else None)

    def let_go(self, uid: int, pin: bool = False) -> Future:
        """The mouse lets go, or leaves the spring pinned; the answer is the list of springs that it made."""
        return self.call(lambda: self._parts[uid].let_go(pin) if uid in self._parts else [])

    def settle(self) -> Future:
        """Plays again what did not go as `symseek run` will go, up to where it was; all of it where one hides another."""
        return self.call(self._settle)

    def at_rest(self) -> bool:
        """Whether nothing moves any more."""
        return all(s.done for s in self.snapshots.values())

    def going(self) -> bool:
        """Whether any is to go on, of those that are not at their ends."""
        return any(part.active for part in list(self._parts.values()))

    def close(self) -> None:
        """Ends the thread."""
        with self._wake:
            self._closed = True
            self._wake.notify()
        self._thread.join()

    # the thread

    def _live(self) -> None:
        prepare(self.device)
        for module in (elastic, coupling, contour, pole, integrate, spring):
            wp.load_module(module, device=self.device)
        with (
            ThreadPoolExecutor(os.cpu_count()) as self._ahead,
            ThreadPoolExecutor(self._workers) as self._pool,
            DepthPasses() as self._depth,
        ):
            before = time.perf_counter()
            while True:
                with self._wake:
                    if not self._calls and not self._closed and not self._active():
                        self._wake.wait()
                        before = time.perf_counter()
                    if self._closed:
                        break
                    calls, self._calls = self._calls, []
                self._answer(calls)
                now = time.perf_counter()
                try:
                    self._round(now - before)
                except Exception as problem:  # a fault of ours must not end the studio
                    self.failed = f"{type(problem).__name__}: {problem}"
                    self._set_going(False)
                before = now
                self._publish(False)
            for part in self._parts.values():
                part.run.stop()
            for _, answer in self._calls:
                answer.cancel()

    def _answer(self, calls: list[tuple[Callable[[], Any], Future]]) -> None:
        """Does what is asked; whoever waits for an answer finds it in the snapshots."""
        outcomes: list[tuple[Future, Any, Exception | None]] = []
        for what, answer in calls:
            try:
                outcomes.append((answer, what(), None))
            except Exception as problem:
                outcomes.append((answer, None, problem))
        if calls:
            self._publish(True)
        for answer, value, problem in outcomes:
            if problem is None:
                answer.set_result(value)
            else:
                answer.set_exception(problem)

    def _active(self) -> list[Part]:
        return [part for part in self._parts.values() if part.active]

    def _round(self, passed: float) -> None:
        """Takes all active runs on for about `ROUND`, no faster than `speed`."""
        begun, left = time.perf_counter(), max(1, round(self.speed * min(passed, 4 * ROUND)))
        while left > 0 and self._active() and time.perf_counter() - begun < ROUND:
            left -= self._advance(left)
            if self._look is not None and self._looked > ROUND:  # it must not take all the time; `settle` makes up for it
                self._look.last += REFRESH * int(self._looked / ROUND)
        spare = begun + ROUND - time.perf_counter()
        if self._active() and spare > 0:
            with self._wake:
                if not self._calls:
                    self._wake.wait(spare)

    def _advance(self, most: int) -> int:
        """Takes all active runs on together, to the next look at what hides them; by how many iterations."""
        parts, active = [part.run for part in self._parts.values()], self._active()
        if self._look is None:
            self._look = Look(parts, self._settings, self._depth)
            self._look.again(max(run.iteration for run in parts))
        count = min(most, max(1, REFRESH - (max(run.iteration for run in parts) - self._look.last)))
        list(self._pool.map(lambda part: part.run.advance(count), active))
        begun = time.perf_counter()
        self._look.again(max(run.iteration for run in parts))
        self._looked = time.perf_counter() - begun
        return count

    def _publish(self, at_once: bool) -> None:
        now = time.perf_counter()
        if not at_once and self._active() and now - self._published < PUBLISH:
            return
        watched = self._parts.get(self.watched or -1)
        if watched is not None and (now - self._measured > MEASURE or not self._active()):
            watched.measure()
            self._measured = now
        self.snapshots = {uid: part.snapshot() for uid, part in self._parts.items()}
        self._published = now

    # in the thread

    def _show(self, views: list[View], settings: Settings, wishes: dict[int, Wish], fresh: bool) -> None:
        if fresh:
            self._go, self._mapped, self._maps = {}, [], {}
            self._remove(list(self._parts))
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
            if part is None or part.wish.structure != wish.structure or not _same(part.map, self._maps[uid]):
                self._begin(uid, wish)
                continue
            if wish.tube.springs != part.wish.tube.springs:
                self._play(uid, wish, _first_difference(wish.tube.springs, part.wish.tube.springs))
                continue
            part.change(wish)
        self._parts = {uid: self._parts[uid] for uid in wishes}

    def _remove(self, uids: Sequence[int]) -> None:
        for uid in uids:
            self._parts.pop(uid).run.stop()

    def _begin(self, uid: int, wish: Wish) -> Part:
        """A run from its start, in the place of the one there was."""
        old = self._parts.get(uid)
        if old is not None:
            self._go[uid] = old.go
            old.run.stop()
        wish = replace(wish, tube=replace(wish.tube, depth=self._depths[uid], find_depth=False))
        part = self._parts[uid] = Part(wish, self._views, self._maps[uid], self._settings, self.device, self._ahead)
        part.go = self._go.get(uid, False)
        return part

    def _play(self, uid: int, wish: Wish, until: int) -> None:
        """The same run with other springs, up to an iteration, before anybody sees it."""
        part, self._look = self._begin(uid, wish), None
        while part.run.iteration < until and not part.run.done:
            part.run.advance(until - part.run.iteration)

    def _set_going(self, on: bool) -> None:
        for uid, part in self._parts.items():
            part.go = self._go[uid] = on

    def _step(self, count: int) -> None:
        self._set_going(True)
        while count > 0 and self._active():
            count -= self._advance(count)
        self._set_going(False)

    def _reset(self) -> None:
        self._look = None
        for uid, part in list(self._parts.items()):
            loose = tuple(s for s in part.wish.tube.springs if s.stop is None)
            tube = replace(part.wish.tube, springs=tuple(replace(s, start=0) for s in loose))
            self._begin(uid, Wish(part.wish.structure, tube)).go = False
            self._go[uid] = False

    def _hold(self, uid: int, point: tuple[float, float], mouse: tuple[float, ...], push: bool, view: int) -> None:
        part = self._parts.get(uid)
        if part is not None:
            part.go, self._look = True, None
            self._go[uid] = True
            part.hold(point, mouse, push, view)

    def _settle(self) -> None:
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


def _same(a: Sequence[Foreground], b: Sequence[Foreground]) -> bool:
    """Whether an object's maps, one for each view, are the same."""
    return all(m is n or (m.origin == n.origin and np.array_equal(m.inside, n.inside)) for m, n in zip(a, b, strict=True))


def _first_difference(new: Sequence[Spring], old: Sequence[Spring]) -> int:
    """Iteration up to which two runs with these springs are the same."""
    differ = [s.start for s in {*new} ^ {*old}]
    return min(differ, default=0)
