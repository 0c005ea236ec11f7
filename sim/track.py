"""Moving scenes (section 4.3): the first frame to equilibrium, then some iterations a frame from a prediction."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from .assembly import Assembly, maps_of
from .correct import correct
from .follow import Follower, Look, Tracking
from .kept import Kept
from .problem import Settings, Tube, View
from .relax import Relaxation, thinned
from .result import ObjectResult, Result, finish


@dataclass(frozen=True)
class Shown:
    """Where a run is; handed to the callback after each frame."""

    frame: int
    """from 0."""
    followers: list[Follower]
    """the tubes."""


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
