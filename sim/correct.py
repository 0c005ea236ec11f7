"""A frame of a moving scene put right by hand: springs that pull on a tube once the frame's own iterations are done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import warp as wp

from ..kernels import spring as kernels
from .loop import HOST
from .spring import Spring

if TYPE_CHECKING:
    from .follow import Follower, Look

AFTER = 60
"""Iterations after the last spring has taken hold or let go."""


class Correction:
    """Springs on a tube in the frame that it has come to last, as somebody pulls or played again.

    What the frame shows is looked at anew about the tube once it is let go: it may have been pulled far.

    Attributes:
        count: iterations so far.
        made: springs so far, iterations counted from the end of the frame's own.

    Args:
        follower: of the tube.
        frame: its number, not the first.
        springs: to be played again.
    """

    def __init__(self, follower: Follower, frame: int, springs: Sequence[Spring] = ()):
        self.follower, self.frame, self.count = follower, frame, 0
        self._held = follower.scene.springs
        self._looks: list[Look] = []
        self._base = max(self._held.iteration, follower.relaxation.iteration) + 1
        for spring in springs:
            stop = None if spring.stop is None else spring.stop + self._base
            self._add(replace(spring, start=spring.start + self._base, stop=stop))

    @property
    def _own(self) -> list[Spring]:
        return [s for s in self._held.list if s.start >= self._base]

    @property
    def made(self) -> list[Spring]:
        return [
            replace(s, frame=self.frame, start=s.start - self._base, stop=None if s.stop is None else s.stop - self._base)
            for s in self._own
        ]

    @property
    def end(self) -> int:
        """Iterations until the tube is taken to be where it is."""
        events = [at for s in self.made for at in (s.start, s.stop) if at is not None]
        return max(events) + AFTER if events else 0

    @property
    def now(self) -> int:
        """The iteration as the springs count it."""
        return self._base + self.count

    def pull(self, k: int, spring: Spring) -> int:
        """Ties a spring from this iteration on; its number."""
        return self._add(replace(spring, start=max(spring.start, self.now)), k)

    def _add(self, spring: Spring, k: int = 0) -> int:
        wp.load_module(kernels, device=self.follower.scene.device)
        return self._held.add(k, spring)

    def let_go(self, i: int) -> None:
        """Ends spring i at this iteration."""
        self._held.let_go(i, self.now)

    def advance(self, count: int) -> None:
        """Goes on by `count` iterations."""
        until, loop = self.count + count, self.follower.loop
        while self.count < until:
            if self._held.due(self.now):
                with HOST:
                    if self._held.lets_go(self.now) and not any(s.holds(self.now) for s in self._own):
                        self._look_again()
                    loop.hold_springs(self.now)
            ahead = [at - self._base for at in self._held.events if at > self.now]
            steps = min([until, *ahead]) - self.count
            loop.run(steps)
            self.count += steps

    def _look_again(self) -> None:
        scene = self.follower.scene
        tube, spine = scene.world(0)
        self._looks = [self.follower.looked(v, view.image, tube, spine) for v, view in enumerate(scene.views)]
        self.follower.show(self._looks)
        scene.set_potentials([[look.potentials[-1] for look in self._looks]])

    def finish(self) -> None:
        """Takes the tube to be where it is now."""
        with HOST:
            if not self._looks:
                self._look_again()
            self.follower.put_right(self._looks)

    def leave(self) -> None:
        """Takes the springs away before the next frame."""
        held = self._held
        own = [i for i, s in enumerate(held.list) if s.start >= self._base]
        if not own:
            return
        for i in reversed(own):
            held.remove(i)
        with HOST:
            self.follower.loop.hold_springs(self.now)


def correct(follower: Follower, frame: int) -> Correction:
    """Plays the tube's springs of a frame, which it has just come to."""
    springs = [s for s in follower.scene.tubes[0].springs if s.frame == frame]
    correction = Correction(follower, frame, springs)
    if springs:
        correction.advance(correction.end)
        correction.finish()
    return correction
