"""A moving scene in the studio: its frames, read one at a time, and the tubes on their way through them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import islice

import numpy as np

from symseek.frames import Frames
from symseek.sim.correct import Correction, correct
from symseek.sim.kept import put_back, taken
from symseek.sim.loop import HOST
from symseek.sim.spring import Spring
from symseek.sim.track import Follower, Tracking, looks_ahead

from .part import Grip, Part, Snapshot, Wish, gripped
from .shelf import Shelf

CACHED = 8
"""Frames that are held in memory."""
CHUNK = 10
"""Iterations between two looks at the clock."""


class Reel:
    """Frames of all views by number; the last few are remembered, and going on is quicker than going back."""

    def __init__(self, frames: Sequence[Frames]):
        self._sources = frames
        self.length = min(len(f) for f in frames)
        self._known: dict[int, list[np.ndarray] | str] = {}
        self._streams: list[Iterator[np.ndarray | str]] = []
        self._next = -1

    def at(self, frame: int) -> list[np.ndarray] | str:
        """Images of a frame, one a view, or why there are none."""
        if frame not in self._known:
            if frame != self._next:
                self._streams = [source.since(frame) for source in self._sources]
            pictures = [next(islice(stream, 1), "it is not there") for stream in self._streams]
            self._next = frame + 1
            sizes = [source.first.shape[:2] for source in self._sources]
            why = [p for p in pictures if isinstance(p, str)]
            good = [p for p in pictures if isinstance(p, np.ndarray)]
            if not why and any(p.shape[:2] != size for p, size in zip(good, sizes, strict=True)):
                why = ["it has another size than the first"]
            known = [*self._known.items()][1 - CACHED :]
            self._known = dict([*known, (frame, f"skipped: {why[0]}" if why else good)])
        return self._known[frame]

    def known(self, frame: int) -> list[np.ndarray] | str | None:
        """The same, if it is remembered; from any thread."""
        return self._known.get(frame)


class Film:
    """Tubes that are followed from frame to frame, put right by hand on the way; called by the engine's thread alone.

    Attributes:
        springs: that each tube is put right by, by uid.
        frame: that is shown.
        tracking: the tubes go on from frame to frame.
        returning: they go to where they were when the studio was closed.
        state: text of the session's state that they are of.

    Args:
        frames: of each view.
        tracking: how to follow.
        pool: makes potentials.
        shelf: keeps the frames that they have been through.
    """

    def __init__(self, frames: Sequence[Frames], tracking: Tracking, pool: Executor, shelf: Shelf | None = None):
        self.reel, self._how, self._pool, self._shelf = Reel(frames), tracking, pool, shelf
        self.springs: dict[int, tuple[Spring, ...]] = {}
        self.frame, self.state = 0, ""
        self.forget()

    def forget(self) -> None:
        """Back to where no tube has left the first frame."""
        self.tracking, self.returning = False, False
        self._followers: dict[int, Follower] = {}
        self._firsts: dict[int, Snapshot] = {}
        self._records: list[np.ndarray] = []
        self._corrections: dict[int, Correction] = {}
        self._held: tuple[int, Grip, int] | None = None
        """uid, what is held, and how many springs there were before."""

    def reset(self) -> None:
        """To the first frame, and nothing is put right in others."""
        self.forget()
        self.frame, self.springs = 0, {}
        if self._shelf is not None:
            self._shelf.clear()

    @property
    def begun(self) -> bool:
        """Whether the tubes have left the first frame."""
        return bool(self._followers)

    @property
    def length(self) -> int:
        """How many frames there are."""
        return self.reel.length

    @property
    def count(self) -> int:
        """Frames that the tubes have been through, the first among them."""
        return max(1, len(self._records))

    @property
    def busy(self) -> bool:
        """Whether a tube is being put right."""
        return self._held is not None or any(c.count < c.end for c in self._corrections.values())

    @property
    def going(self) -> bool:
        """Whether there is something to do in frames after the first."""
        return self.busy or self.returning or (self.tracking and self.count < self.length)

    def see(self, frame: int) -> None:
        """See `Engine.see`."""
        self.frame = min(max(frame, 0), self.length - 1)

    def go_on(self, most: int, until: float) -> None:
        """By a frame, or by iterations of what is put right by hand, to a time of `time.perf_counter`."""
        if not self.busy:
            self.forward()
            self.frame = self.count - 1
            self.tracking &= self.count < self.length
            return
        while self.busy and most > 0 and time.perf_counter() < until:
            self.advance(min(most, CHUNK))
            most -= CHUNK

    def begin(self, parts: Mapping[int, Part]) -> None:
        """Takes over the runs of the first frame, which are at their ends."""
        self._firsts = {uid: part.snapshot() for uid, part in parts.items()}
        for uid, part in parts.items():
            tube = part.run.scene.tubes[0]
            part.run.scene.tubes[0] = replace(tube, springs=(*tube.springs, *self.springs.get(uid, ())))
            self._followers[uid] = Follower(part.run, self._how)
        self._records = [taken(list(self._followers.values()))]
        kept = [] if self._shelf is None else self._shelf.records(self.state, self._records[0].dtype)
        if 1 < len(kept) <= self.length:
            self._records += kept[1:]
            self._solve_again(len(kept) - 1)  # so that its potentials are there
            self.frame = self.count - 1
        self.returning = False
        self.keep()

    def keep(self) -> None:
        """Puts what has been gone through on the shelf."""
        if self._shelf is not None and self.count > 1:
            self._shelf.keep(self.state, self._records)

    def returns(self) -> bool:
        """Whether there are frames to go back to; then `returning` holds until `begin`."""
        self.returning = self._shelf is not None and self._shelf.has(self.state)
        return self.returning

    def forward(self) -> None:
        """All tubes on by a frame."""
        frame = self.count
        self._leave()
        ahead = looks_ahead(list(self._followers.values()), self.reel.at(frame), self._pool, frame)
        for (uid, follower), looks in zip(self._followers.items(), ahead or (), strict=True):
            if isinstance(looks, str):
                follower.skip(looks)
                continue
            follower.follow([look.result() for look in looks])
            follower.scene.tubes[0] = replace(follower.scene.tubes[0], springs=self.springs.get(uid, ()))
            self._corrections[uid] = correct(follower, frame)
        self._records.append(taken(list(self._followers.values())))
        self.keep()

    def _leave(self) -> None:
        for correction in self._corrections.values():
            correction.leave()
        self._corrections, self._held = {}, None

    def go_to(self, frame: int) -> None:
        """Makes a frame after the first the last one that the tubes have been through, solved anew."""
        if frame < self.count - 1:
            self._solve_again(frame)

    def hold(self, uid: int, point: tuple[float, float], mouse: tuple[float, ...], push: bool, view: int) -> None:
        """The mouse takes hold of a tube in the frame that is shown; those after it are forgotten."""
        self.tracking = False
        if uid not in self._followers or self.frame >= self.count:
            return
        self.go_to(self.frame)
        correction = self._corrections.get(uid)
        if correction is None:  # the frame could not be read
            return
        scene = correction.follower.scene
        before = len(correction.made)
        grip, springs = gripped(scene.world(0)[0], scene.views, point, mouse, push, view)
        grip.springs = [correction.pull(0, spring) for spring in springs]
        self._held = uid, grip, before

    def drag(self, mouse: tuple[float, ...]) -> None:
        """See `Engine.drag`."""
        if self._held is not None:
            uid, grip, _ = self._held
            correction = self._corrections[uid]
            grip.move(mouse, correction.follower.scene.springs.list, correction.now, correction.pull, correction.let_go)

    def let_go(self, pin: bool) -> list[Spring]:
        """See `Engine.let_go`."""
        if self._held is None:
            return []
        uid, grip, before = self._held
        correction = self._corrections[uid]
        for i in () if pin else reversed(grip.springs):
            correction.let_go(i)
        self._held, made = None, correction.made[before:]
        self.springs[uid] = (*self.springs.get(uid, ()), *made)
        return made

    def advance(self, count: int) -> None:
        """Goes on with the tubes that are being put right; one whose springs have let go for long enough is where it is."""
        for uid, correction in self._corrections.items():
            held = self._held is not None and self._held[0] == uid
            most = count if held else min(count, correction.end - correction.count)
            if most <= 0:
                continue
            correction.advance(most)
            if not held and correction.count >= correction.end:
                correction.finish()
                self._records[-1] = taken(list(self._followers.values()))
                self.keep()

    def first_frame(self, wishes: Mapping[int, Wish]) -> tuple[dict[int, Wish], dict[int, tuple[Spring, ...]]]:
        """What is wished of the first frame, and the springs of those after it."""
        springs = {uid: tuple(s for s in wish.tube.springs if s.frame) for uid, wish in wishes.items()}
        first = {
            uid: replace(wish, tube=replace(wish.tube, springs=tuple(s for s in wish.tube.springs if not s.frame)))
            for uid, wish in wishes.items()
        }
        return first, springs

    def change(self, springs: Mapping[int, tuple[Spring, ...]]) -> None:
        """Springs that somebody has added or taken away otherwise; from the first such frame on all is forgotten."""
        every = {*self.springs.items(), *springs.items()}
        differ = [s.frame for uid, _ in every for s in {*self.springs.get(uid, ())} ^ {*springs.get(uid, ())}]
        self.springs = dict(springs)
        first = min(differ, default=self.count)
        if not self.begun or first >= self.count:
            return
        self._solve_again(first)
        self.frame = first

    def _solve_again(self, frame: int) -> None:
        """Forgets a frame after the first and those after it, and goes through it anew."""
        self._leave()
        self._records = self._records[:frame]
        with HOST:
            put_back(list(self._followers.values()), np.concatenate(self._records), first=True)
        self.forward()

    def snapshots(self) -> dict[int, Snapshot]:
        """Where the tubes are in the frame that is shown; nothing in one that they have not been through."""
        if self.frame == 0:
            return self._firsts
        if self.frame >= self.count:
            return {}
        return {uid: self._snapshot(uid, follower, self.frame) for uid, follower in self._followers.items()}

    def _snapshot(self, uid: int, follower: Follower, frame: int) -> Snapshot:
        first, scene = self._firsts[uid], follower.scene
        tube, spine = follower.world(follower.states[frame])
        pulls, under_way = [], frame == self.count - 1 and uid in self._corrections and self.busy
        if under_way:
            tube, spine = scene.world(0)
            pulls = scene.springs.in_space(0, scene.state.tube.numpy())
        return replace(
            first, tube=tube, spine=spine, frame=frame, iteration=frame, done=not under_way, pulls=pulls, support=None,
            note=follower.notes[frame], off=follower.off[frame] * follower.palettes[0].half_width,
        )  # fmt: skip
