"""Moving scenes (section 4.3): the first frame to equilibrium, then some iterations a frame from a prediction."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from .assembly import Assembly, maps_of
from .bend import bend, contour, linearised, look_up
from .correct import correct
from .kept import Kept
from .loop import HOST
from .palette import Palette
from .potential import Potential, ScaleSpace
from .problem import Settings, Tube, View
from .relax import HOLD, Relaxation, thinned
from .result import ObjectResult, Result, finish

SHARE = 0.03
"""Share of the rigidities w2 and w02 while tracking: more lags behind, less is lost."""
STRETCH = 0.05
"""K1 of the spine while tracking, whose natural lengths are those of the first frame: nodes do not drift along it."""
SCALES, MOVES = (-3, -2, -1), (1, 1, 1)
"""Which scales a frame is looked at by, and how many moves as a rod each takes; iterations go by the last."""
DEGREE = 5
"""Of a rod's moves, see `bend`."""
SMOOTH = 2.0
"""Rings over which the turn of a ring from frame to frame is averaged for its prediction."""
LEAST_SEEN, LEAST_BACK = 0.85, 0.9
"""Of how far tube and object are one by its colours (`Palette.seen`), over the first frame's: lost below, back above."""
MOST_OFF = 0.2
"""How far the contour may be off its edges on average, in half widths; half of that to be taken up again."""
MOST_OUT = 0.5
"""Share of the silhouette that may lie beyond the image."""
FINE = 20.0
"""Samples for an object's half width in a frame's potentials: a tenth of the work of a still picture's."""
DIVERGED = "lost: the solver diverged"
WIDE = 4.0
"""How much further from the tube a lost object is looked for."""


@dataclass(frozen=True)
class Tracking:
    """How a moving scene is followed; defaults serve every scene."""

    iterations: int = 20
    """a frame, after the first."""
    fps: float | None = None
    """frames a second; None: a video's own, else velocities are in world units a frame."""
    first: str = "rod"
    """how a frame begins: the tube moves as a "rod" that bends, or "rigid" (section 4.3), or "none"."""


@dataclass
class Look:
    """What one frame shows of one tube in one view."""

    view: View
    space: ScaleSpace
    potentials: list[Potential]
    """at each of `SCALES`."""


@dataclass(frozen=True)
class Shown:
    """Where a run is; handed to the callback after each frame."""

    frame: int
    """from 0."""
    followers: list[Follower]
    """the tubes."""


class Follower:
    """One tube on its way from frame to frame.

    Attributes:
        states: its nodes in each frame so far, as `Fabric.positions` gives them.
        notes: for each frame nothing, or why it is not to be trusted.
        whole: how far tube and object are one in each view of the first frame, see `Palette.seen`.
        seen, off: the least of that over the first frame's, and most mean way of the contour to its edges [half widths],
            over the views, of each frame.

    Args:
        relaxation: of the first frame, at its end.
        tracking: how to go on.
    """

    def __init__(self, relaxation: Relaxation, tracking: Tracking):
        self.relaxation, self.scene, self.loop, self.tracking = relaxation, relaxation.scene, relaxation.loop, tracking
        scene = self.scene
        self.palettes = [Palette(view, m) for view, m in zip(scene.views, scene.maps[0], strict=True)]
        self.sigmas = [[space.sigmas[max(s, -len(space.sigmas))] for s in SCALES] for space in scene.spaces[0]]
        self.cameras = [scene.own_camera(view.camera) for view in scene.views]
        self.states, self.notes = [scene.positions()], [""]
        tube, spine = self.world(self.states[0])
        pairs = zip(self.palettes, scene.views, strict=True)
        self.whole = [palette.seen(palette.map(view.image, tube, spine), tube) for palette, view in pairs]
        self.seen, self.off = [1.0], [0.0]
        self.seconds = 0.0
        scene.hold_shares(HOLD)  # a bend changes them
        if scene.weights.materials[0].L1 is None:
            scene.weights.change(0, {"L1": scene.shape(0)["L1"], "k1": STRETCH})

    @property
    def lost(self) -> bool:
        """Whether the last frame did not show it."""
        return self.notes[-1].startswith("lost")

    def grid(self, tube: np.ndarray) -> np.ndarray:
        """Flat nodes (N, 3) as a grid (N_x, N_s, 3)."""
        nx, ns = self.scene.tubes[0].grid
        return tube.reshape(ns, nx, 3).transpose(1, 0, 2)

    def world(self, state: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Tube (N_x, N_s, 3) and spine (N_s, 3) of a state in world units."""
        unit, origin = float(self.scene.unit), self.scene.origin
        return self.grid(state[0]) * unit + origin, state[1] * unit + origin

    def predicted(self, frame: int, known: int) -> tuple[np.ndarray, np.ndarray]:
        """Nodes in a frame by the first `known` ones: each ring goes on as it did and turns with the spine.

        Not about it: outlines hardly tell, and what is predicted from what was predicted would grow.
        """
        now, ahead = self.states[known - 1], frame - known + 1
        if known == 1 or any(note.startswith("lost") for note in self.notes[known - 2 : known]):
            return now
        new, spine = self.grid(now[0]).transpose(1, 0, 2).astype(float), now[1].astype(float)
        way = ndimage.gaussian_filter1d(spine - self.states[known - 2][1], 1.0, axis=0, mode="nearest")
        for _ in range(ahead):
            rotation = turns(spine, spine + way)
            new = np.einsum("sij,sxj->sxi", rotation, new - spine[:, None]) + (spine + way)[:, None]
            spine = spine + way
        return new.reshape(-1, 3).astype(np.float32), spine.astype(np.float32)

    def look(self, v: int, image: np.ndarray, frame: int) -> Look:
        """Map and potentials of a frame in view v, by all frames but the one before, which is being solved."""
        known = max(1, frame - 1)
        wide = WIDE if self.notes[known - 1].startswith("lost") else 1.0
        return self.looked(v, image, *self.world(self.predicted(frame, known)), wide)

    def looked(self, v: int, image: np.ndarray, tube: np.ndarray, spine: np.ndarray, wide: float = 1.0) -> Look:
        """Map and potentials of an image of view v about a tube."""
        scene = self.scene
        map_ = self.palettes[v].map(image, tube, spine, wide)
        view = replace(scene.views[v], image=image)
        space = ScaleSpace(view, view.camera, map_, scene.settings, FINE)
        return Look(view, space, [space.at(s, i == len(SCALES) - 1) for i, s in enumerate(self.sigmas[v])])

    def skip(self, reason: str) -> None:
        """On over a frame that is not there."""
        self.states.append(self.predicted(len(self.states), len(self.states)))
        self.notes.append(self.notes[-1] if self.lost else reason)
        self.seen.append(self.seen[-1])
        self.off.append(self.off[-1])

    def follow(self, looks: list[Look]) -> None:
        """On to the next frame."""
        clock = time.perf_counter()
        scene, was_lost = self.scene, self.lost
        # with mass and no moves its own momentum alone carries the tube on
        carried = self.loop.solver.mass and self.tracking.first == "none" and not was_lost
        scene.views = [look.view for look in looks]
        scene.spaces, scene.maps = [[look.space for look in looks]], [[look.space.map for look in looks]]
        with HOST:
            if not carried:
                self._begin(looks)
            scene.set_potentials([[look.potentials[-1] for look in looks]])
            scene.hold_tangents()
            self.loop.set_material(SHARE)
            if not carried:
                scene.stand_still()
        self.loop.run(self.tracking.iterations)
        with HOST:
            self._end(looks, was_lost)
        self.seconds += time.perf_counter() - clock

    def put_right(self, looks: list[Look]) -> None:
        """Takes it that the tube, set by hand, is in the last frame where it is now."""
        state = self.scene.positions()
        note, self.seen[-1], self.off[-1] = self._doubt(state, looks, False)
        self.states[-1], self.notes[-1] = state, note if note == DIVERGED else ""

    def _begin(self, looks: list[Look]) -> None:
        """Predicts and moves the tube as a whole."""
        sizes = [look.view.image.shape[:2] for look in looks]
        tube, spine = self.predicted(len(self.states), len(self.states))
        grid = self.grid(tube).astype(float)
        closed = self.scene.tubes[0].material.closed
        if self.tracking.first != "none":
            degree = 0 if self.tracking.first == "rigid" or self.lost else DEGREE
            for i, count in enumerate(MOVES):
                potentials = [look.potentials[i] for look in looks]
                for _ in range(count + (4 if self.lost and i == 0 else 0)):
                    grid, spine = bend(grid, spine, self.cameras, potentials, sizes, degree, closed)
        self.scene.rewind((grid.transpose(1, 0, 2).reshape(-1, 3).astype(np.float32), spine.astype(np.float32)))

    def _end(self, looks: list[Look], was_lost: bool) -> None:
        """Whether it is there, and where."""
        state = self.scene.positions()
        note, seen, off = self._doubt(state, looks, was_lost)
        if note.startswith("lost"):
            state = self.states[-1]
            self.scene.rewind(state)
        self.states.append(state)
        self.notes.append(note)
        self.seen.append(seen)
        self.off.append(off)

    def _doubt(self, state: tuple[np.ndarray, np.ndarray], looks: list[Look], was_lost: bool) -> tuple[str, float, float]:
        if not all(np.isfinite(a).all() for a in state):
            return DIVERGED, 0.0, np.inf
        grid, closed = self.grid(state[0]).astype(float), self.scene.tubes[0].material.closed
        tube, _ = self.world(state)
        seen, off, out = [], [], []
        parts = zip(self.palettes, self.whole, self.cameras, self.scene.views, looks, strict=True)
        for palette, whole, own, view, look in parts:
            seen.append(palette.seen(look.space.map, tube) / max(whole, 1e-9))
            points = view.camera.project(tube)
            h, w = view.image.shape[:2]
            out.append(float(((points < 0) | (points > [w - 1, h - 1])).any(axis=-1).mean()))
            _, at, normal, share = contour(grid, own, view.image.shape[:2], closed)
            if not len(at):
                off.append(np.inf)
                continue
            pixels, slope = linearised(own, at)
            m = np.einsum("nij,nj->ni", slope, normal)
            m /= np.maximum(np.linalg.norm(m, axis=1, keepdims=True), 1e-12)
            value = look_up(look.potentials[-1], pixels)
            off.append(float((share**2 * np.abs((value[:, :2] * m).sum(axis=1) + value[:, 2])).sum()) / palette.half_width)
        least, most = min(seen), max(off)
        before, _ = self.world(self.states[-1])
        way = np.linalg.norm(tube.mean(axis=0) - before.mean(axis=0), axis=1).max()
        broad = np.linalg.norm(tube - tube.mean(axis=0), axis=2).max()
        if max(out) > MOST_OUT:
            return "lost: it has left the image", least, most
        if least < (LEAST_BACK if was_lost else LEAST_SEEN):
            return "lost: its colours are not where it must be: hidden, or moved too far", least, most
        if most > (0.5 if was_lost else 1.0) * MOST_OFF:
            return "lost: no edges where its contour must be", least, most
        if not was_lost and way > 2.5 * broad:
            return "lost: it moved too far between two frames", least, most
        return "", least, most


def track(
    frames: Iterable[Sequence[np.ndarray] | str],
    views: list[View],
    tubes: list[Tube],
    settings: Settings | None = None,
    tracking: Tracking | None = None,
    device: str = "cpu",
    callback: Callable[[Shown], bool | None] | None = None,
    kept: Kept | None = None,
) -> Result:
    """Follows tubes through the frames of synchronised views.

    Frames are taken from the stream one at a time; the next one's potentials are made while this one is solved.

    Args:
        frames: for each time an image a view, or why there is none; the first must be there.
        views: cameras; their images are not used.
        tubes: rough axes in the first frame.
        settings, tracking: of the solver.
        device: Warp device.
        callback: called after each frame; returning True stops.
        kept: keeps each frame; what it has already is not solved again.

    Returns:
        Objects with an entry for each frame in `tube`, `spine`, `velocity`, `time` and `notes`; meshes and measures are the
        last frame's, and so are the images of `Result.views`.

    Raises:
        ValueError: no first frame, or as `reconstruct`.
    """
    settings, tracking = settings or Settings(), tracking or Tracking()
    clock, seconds = time.perf_counter(), {}
    stream = iter(frames)
    first = next(stream, "there is none")
    if isinstance(first, str):
        raise ValueError(f"the first frame cannot be read: {first}")
    views = [replace(view, image=image) for view, image in zip(views, first, strict=True)]
    maps = maps_of(views, tubes)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        followers = []
        for k, tube in enumerate(tubes):
            relaxation = Relaxation(Assembly(views, [tube], settings, device, [maps[k]]), pool)
            relaxation.advance(settings.iterations)
            followers.append(Follower(relaxation, tracking))
        seconds["first frame"] = time.perf_counter() - clock
        clock, count = time.perf_counter(), 0
        if kept is not None:
            count = kept.restore(followers) - 1
            for _ in range(count):
                next(stream, None)
        waiting = looks_ahead(followers, next(stream, None), pool, count + 1)
        while waiting is not None:
            ahead = looks_ahead(followers, next(stream, None), pool, count + 2)
            for follower, looks in zip(followers, waiting, strict=True):
                if isinstance(looks, str):
                    follower.skip(looks)
                    continue
                follower.follow([look.result() for look in looks])
                correct(follower, count + 1).leave()
            waiting, count = ahead, count + 1
            if kept is not None:
                kept.add(followers)
            if callback and callback(Shown(count, followers)):
                break
    seconds["frames"] = time.perf_counter() - clock
    seconds["solve"] = sum(f.seconds for f in followers)
    objects = [_followed(f) for f in followers]
    settings = replace(settings, scheme=followers[0].loop.solver.name)
    return Result(objects, [], None, seconds, settings, followers[0].scene.views)


def looks_ahead(
    followers: Sequence[Follower], images: Sequence[np.ndarray] | str | None, pool: Executor, frame: int
) -> list[list[Future[Look]] | str] | None:
    """What each tube's views show in a frame, under way."""
    if images is None:
        return None
    if isinstance(images, str):
        return [images for _ in followers]
    return [[pool.submit(f.look, v, image, frame) for v, image in enumerate(images)] for f in followers]


def _followed(follower: Follower) -> ObjectResult:
    scene, rate = follower.scene, follower.tracking.fps or 1.0
    states = [follower.world(state) for state in follower.states]
    cuts = list(scene.weights.cuts[0])
    history = [(tube, spine, follower.sigmas[0][-1], cuts) for tube, spine in states]
    done = follower.relaxation.iteration + follower.tracking.iterations * (len(states) - 1)
    potentials = [space.at(s[-1], True) for space, s in zip(scene.spaces[0], follower.sigmas, strict=True)]
    out = finish(scene, 0, potentials, thinned(history), done, True, False)
    out.tube, out.spine = np.stack([tube for tube, _ in states]), np.stack([spine for _, spine in states])
    out.velocity = velocity(out.tube, [note.startswith("lost") for note in follower.notes]) * rate
    out.time = np.arange(len(states)) / rate
    out.notes = follower.notes
    for text in dict.fromkeys(filter(None, follower.notes)):
        at = [i for i, note in enumerate(follower.notes) if note == text]
        out.warnings.append(f"frame{'s' * (len(at) > 1)} {_runs(at)}: {text}")
    out.trusted &= not any(follower.notes)
    return out


def turns(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Least rotations (N_s, 3, 3) that take the tangents of one spine (N_s, 3) to those of another."""
    a, b = (ndimage.gaussian_filter1d(np.gradient(s, axis=0), SMOOTH, axis=0, mode="nearest") for s in (old, new))
    a, b = (t / np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-30) for t in (a, b))
    axis, cosine = np.cross(a, b), (a * b).sum(axis=1)
    cross = np.cross(np.eye(3)[None], axis[:, None])
    return np.eye(3) + cross + cross @ cross / (1 + np.maximum(cosine, -0.99))[:, None, None]


def velocity(tube: np.ndarray, lost: Sequence[bool]) -> np.ndarray:
    """Velocity of nodes (F, N_x, N_s, 3) a frame: slope of the parabola through five frames, through fewer at ends.

    0 where a tube is lost; a parabola does not reach across such frames.
    """
    out = np.zeros_like(tube)
    for first, last in _stretches([not x for x in lost]):
        own = tube[first:last]
        n = len(own)
        for i in range(n):
            a, b = max(0, min(i - 2, n - 5)), min(n, max(i + 3, 5))
            if b - a == 1:
                continue
            t = np.arange(a, b) - i
            weight = np.linalg.pinv(np.vander(t, min(3, b - a), increasing=True))[1]
            out[first + i] = np.tensordot(weight, own[a:b], 1)
    return out


def _stretches(flags: Sequence[bool]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _runs(numbers: list[int]) -> str:
    """Numbers in words: 3 to 5, 9 for [3, 4, 5, 9]."""
    flags = np.isin(np.arange(max(numbers) + 1), numbers)
    return ", ".join(str(a) if b == a + 1 else f"{a} to {b - 1}" for a, b in _stretches(list(flags)))
