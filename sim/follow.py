"""One tube on its way through the frames of a moving scene (section 4.3): where it must be, and what is seen there."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from .bend import bend, cross, outlines
from .beyond import capped, part, past, places
from .foreground import length_of
from .guide import CLOSELY
from .hidden import Hidden
from .loop import HOST
from .palette import AROUND, Palette
from .potential import Potential, ScaleSpace
from .problem import View
from .relax import HOLD, Relaxation
from .retake import profile, retaken
from .search import shifted

SHARE, STUBBY = 0.03, 7.0
"""Share of the rigidities w2 and w02 while tracking, more lags behind, less is lost; and below how many widths of length it
grows, as a beam's own rigidity does, with the square of the width: what is stubby does not curl within its width."""
STRETCH = 0.05
"""K1 of the spine while tracking, whose natural lengths are those of the first frame: nodes do not drift along it."""
GIRTH = 1e-2
"""K10 of the tube while tracking, whose natural circumferences are those of the first frame: what has its colours beside it,
as a finger's neighbour, does not widen it from frame to frame."""
SCALES, MOVES = (-3, -2, -1), (1, 1, 1)
"""Which scales a frame is looked at by, and how many moves as a rod each takes; iterations go by the last."""
DEGREE = 5, 10
"""Least and most of a rod's moves, see `bend`; between them its length in widths: what is slender bends in more turns."""
SMOOTH = 2.0
"""Rings over which the turn of a ring from frame to frame is averaged for its prediction."""
LEAST_SEEN, LEAST_BACK = 0.85, 0.9
"""Of how far tube and object are one by its colours (`Palette.seen`), over the first frame's: lost below, back above."""
MOST_OFF = 0.2
"""How far the contour may be off its edges on average, in half widths; half of that to be taken up again, or not doubted."""
NEAR, NEARER = 0.6, 0.35
"""How near its edges the contour counts as there in any case: when it is to be taken up again, and when not doubted [px]."""
MOST_OUT = 0.5
"""Share of the silhouette that may lie beyond the image."""
DIVERGED = "lost: the solver diverged"
DOUBTFUL = "doubtful: its contour lies off the edges"
REACHES = (3.0, 6.0)
"""How far about it is looked for what is not where it was predicted, in half widths, one after the other."""
AGAIN, STRAY = 2, 0.25
"""How often a frame is looked at anew from where the tube has come to, and how far from there it was looked for, in half
widths, on average, that this be worth it: colours alone decide no further than half a half width from there."""
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
    hidden: Hidden | None
    """where nothing is to be looked at."""
    tube: np.ndarray
    """where it was looked for, shape (N_x, N_s, 3), world units."""


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
        self.palettes = [Palette(view, m) for view, m in zip(scene.own_views[0], scene.maps[0], strict=True)]
        self.sigmas = [[space.sigmas[max(s, -len(space.sigmas))] for s in SCALES] for space in scene.spaces[0]]
        self.cameras = [scene.own_camera(view.camera) for view in scene.views]
        self.ends = self._ends(self.world(scene.positions())[1])
        self._cap()
        self.states, self.notes = [scene.positions()], [""]
        tube, spine = self.world(self.states[0])
        pairs = zip(self.palettes, scene.own_views[0], strict=True)
        self.whole = [palette.seen(palette.map(view, tube, spine)[0], tube) for palette, view in pairs]
        self.straight = not folded(tube, spine)
        self.profiles = [profile(view.image, view.camera.project(spine)) for view in scene.views]
        self.seen, self.off = [1.0], [0.0]
        self.seconds = 0.0
        self.degree = int(np.clip(round(scene.slender(0)), *DEGREE))
        wide = 2 * np.median(np.linalg.norm(tube - spine, axis=2).mean(axis=0))
        self.share = float(np.clip(SHARE * (STUBBY * wide / max(length_of(spine), wide)) ** 2, SHARE, 1.0))
        scene.weights.stiffer[0] = 0.0  # the share above sees to that
        scene.hold_shares(HOLD)  # a bend changes them
        scene.smooth = CLOSELY
        if scene.weights.materials[0].L1 is None:
            scene.weights.change(0, {"L1": scene.shape(0)["L1"], "k1": STRETCH})
        if scene.weights.materials[0].L10 is None:
            scene.weights.change(0, {"L10": scene.shape(0)["L10"], "k10": GIRTH})

    @property
    def lost(self) -> bool:
        """Whether the last frame did not show it."""
        return self.notes[-1].startswith("lost")

    def _fair(self, near: float) -> float:
        """How far its contour may be off its edges where that is looked at closely, or so many pixels [half widths]."""
        fine = near / min(palette.half_width for palette in self.palettes)
        return min(max(0.5 * MOST_OFF, fine), MOST_OFF)

    def grid(self, tube: np.ndarray) -> np.ndarray:
        """Flat nodes (N, 3) as a grid (N_x, N_s, 3)."""
        nx, ns = self.scene.tubes[0].grid
        return tube.reshape(ns, nx, 3).transpose(1, 0, 2)

    @staticmethod
    def _flat(grid: np.ndarray, spine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A grid (N_x, N_s, 3) and its spine as nodes of a state."""
        return grid.transpose(1, 0, 2).reshape(-1, 3).astype(np.float32), spine.astype(np.float32)

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
        scene, palette = self.scene, self.palettes[v]
        view = replace(scene.views[v], image=image, ignore=self._ignored(v, image.shape, tube, spine, wide))
        map_, known = palette.map(view, tube, spine, wide)
        space = ScaleSpace(view, view.camera, map_, scene.settings, known)
        potentials = [space.at(s, i == len(SCALES) - 1) for i, s in enumerate(self.sigmas[v])]
        return Look(view, space, potentials, Hidden.of(view.ignore), tube)

    def _ends(self, spine: np.ndarray) -> np.ndarray:
        """Where along the spine (N_s, 3) the ends of the axis as drawn lie [rings], shape (2,)."""
        drawn = np.asarray(self.scene.tubes[0].spine, float)
        return places(spine if drawn.shape[1] == 3 else self.scene.views[0].camera.project(spine), drawn[[0, -1]])

    def _ignored(
        self, v: int, shape: tuple[int, ...], tube: np.ndarray, spine: np.ndarray, wide: float
    ) -> np.ndarray | None:
        """What is not to be looked at about a tube in view v, shape (H, W): the view's own, and where the object goes on."""
        given, ends = self.scene.views[v].ignore, self.scene.tubes[0].goes_on
        if not any(ends):
            return given
        camera, far = self.scene.views[v].camera, (1 + AROUND * max(1.0, wide)) * self.palettes[v].half_width
        flat = camera.project(tube).reshape(-1, 2)
        box = np.stack([flat.min(axis=0) - far, flat.max(axis=0) + far])
        mask = past(camera.project(part(spine, self.ends)), ends, shape, box)
        return mask if given is None else mask | given

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
        alone = self.loop.solver.mass and self.tracking.first == "none" and not was_lost
        start = self.predicted(len(self.states), len(self.states))
        self._solve(looks, None if alone else start)
        with HOST:
            found = self._doubt(scene.positions(), looks, was_lost)
            reaches, again, tried = iter(REACHES), AGAIN, False
            while True:
                if found[0].startswith("lost"):
                    reach = next(reaches, None)
                    if reach is None:
                        anew = None if tried else self._look_everywhere(looks)
                        if anew is None:
                            break
                        (looks, start), tried = anew, True
                    else:
                        looks, start = self._look_about(looks, start, reach)
                elif again and self._strayed(looks):
                    looks, start = self._look_about(looks, scene.positions(), 0.0)
                    again -= 1
                else:
                    break
                self._solve(looks, start, tried)
                found = self._doubt(scene.positions(), looks, was_lost)
            if not found[0] and found[2] > self._fair(NEARER):
                if not tried:
                    found = self._laid_anew(looks, found, was_lost)
                if found[2] > self._fair(NEARER):
                    found = DOUBTFUL, *found[1:]
            self._end(*found)
        self.seconds += time.perf_counter() - clock

    def _solve(self, looks: list[Look], start: tuple[np.ndarray, np.ndarray] | None, anew: bool = False) -> None:
        """A frame's moves and iterations from nodes to begin with; None: from where and as fast as they are."""
        scene = self.scene
        self.show(looks)
        with HOST:
            if start is not None:
                self._begin(looks, start, anew)
            scene.weights.share = self.share
            scene.set_potentials([[look.potentials[-1] for look in looks]])
            scene.hold_tangents()
            self.loop.set_material()
            if start is not None:
                scene.stand_still()
        self.loop.run(self.tracking.iterations)
        with HOST:
            self._cap()

    def _cap(self) -> None:
        """Lays what lies past ends anew."""
        ends = self.scene.tubes[0].goes_on
        if any(ends):
            tube, spine = self.scene.positions()
            self.scene.rewind(self._flat(*capped(self.grid(tube), spine, ends, self.ends)))

    def _laid_anew(self, looks: list[Look], found: tuple[str, float, float], was_lost: bool) -> tuple[str, float, float]:
        """Lies badly: where what looks like the object tells of a better way to lie, lies so instead."""
        old, anew = self.scene.positions(), self._look_everywhere(looks)
        if anew is None:
            return found
        self._solve(*anew, True)
        better = self._doubt(self.scene.positions(), anew[0], was_lost)
        if not better[0] and better[2] < self._fair(NEARER):
            return better
        self.show(looks)
        self.scene.rewind(old)
        return found

    def _look_about(
        self, looks: list[Look], start: tuple[np.ndarray, np.ndarray], reach: float
    ) -> tuple[list[Look], tuple[np.ndarray, np.ndarray]]:
        """The nodes moved to where their colours are, within so many half widths, and what the frame shows there."""
        tube, spine = self.world(start)
        way = np.zeros(3)
        if reach:
            views = [
                replace(look.view, ignore=self._ignored(v, look.view.image.shape, tube, spine, reach))
                for v, look in enumerate(looks)
            ]
            way = shifted(tube, spine, self.palettes, views, reach)
        looks = [self.looked(v, look.view.image, tube + way, spine + way) for v, look in enumerate(looks)]
        own = way / float(self.scene.unit)
        return looks, ((start[0] + own).astype(np.float32), (start[1] + own).astype(np.float32))

    def show(self, looks: list[Look]) -> None:
        """Sets what the tube is to see in force, but for the potentials."""
        scene, views = self.scene, [look.view for look in looks]
        scene.views = [replace(old, image=new.image) for old, new in zip(scene.views, views, strict=True)]
        scene.own_views, scene.hidden = [views], [[look.hidden for look in looks]]
        scene.spaces, scene.maps = [[look.space for look in looks]], [[look.space.map for look in looks]]

    def put_right(self, looks: list[Look]) -> None:
        """Takes it that the tube, set by hand, is in the last frame where it is now."""
        state = self.scene.positions()
        note, self.seen[-1], self.off[-1] = self._doubt(state, looks, False)
        self.states[-1], self.notes[-1] = state, note if note == DIVERGED else ""

    def _look_everywhere(self, looks: list[Look]) -> tuple[list[Look], tuple[np.ndarray, np.ndarray]] | None:
        """Nodes laid along what looks like the object anywhere in the frame, however bent, and what it shows there."""
        views = [replace(old, image=look.view.image) for old, look in zip(self.scene.views, looks, strict=True)]
        found = retaken(*self.world(self.states[0]), self.palettes, views, self.profiles)
        if found is None or any(self.scene.tubes[0].goes_on):
            return None
        tube, spine = ((v - self.scene.origin) / float(self.scene.unit) for v in found)
        return [self.looked(v, view.image, *found) for v, view in enumerate(views)], self._flat(tube, spine)

    def _strayed(self, looks: list[Look]) -> bool:
        """Whether the tube is so far from where the frame was looked at that it may have to go on."""
        tube, _ = self.world(self.scene.positions())
        ways = [look.view.camera.project(tube) - look.view.camera.project(look.tube) for look in looks]
        half_widths = [palette.half_width for palette in self.palettes]
        return any(np.linalg.norm(w, axis=2).mean() > STRAY * h for w, h in zip(ways, half_widths, strict=True))

    def _begin(self, looks: list[Look], start: tuple[np.ndarray, np.ndarray], anew: bool) -> None:
        """Moves the tube as a whole; what was laid `anew` may bend, what was lost may not."""
        sizes, hidden = [look.view.image.shape[:2] for look in looks], [look.hidden for look in looks]
        tube, spine = start
        grid, spine = self.grid(tube).astype(float), spine.astype(float)
        closed = self.scene.tubes[0].material.closed
        if self.tracking.first != "none":
            degree = 0 if self.tracking.first == "rigid" or (self.lost and not anew) else self.degree
            for i, count in enumerate(MOVES):
                potentials = [look.potentials[i] for look in looks]
                for _ in range(count + (4 if self.lost and i == 0 else 0)):
                    grid, spine = bend(grid, spine, self.cameras, potentials, sizes, degree, closed, hidden)
        self.scene.rewind(self._flat(grid, spine))

    def _end(self, note: str, seen: float, off: float) -> None:
        """Takes down whether it is there, and where."""
        state = self.scene.positions()
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
        last, sizes = [look.potentials[-1] for look in looks], [look.view.image.shape[:2] for look in looks]
        found = outlines(grid, self.cameras, last, sizes, closed, [look.hidden for look in looks])
        for palette, whole, look, contour, (h, w) in zip(self.palettes, self.whole, looks, found, sizes, strict=True):
            seen.append(palette.seen(look.space.map, tube) / max(whole, 1e-9))
            points = look.view.camera.project(tube)
            out.append(float(((points < 0) | (points > [w - 1, h - 1])).any(axis=-1).mean()))
            way = float((contour.share * np.abs(contour.way)).sum()) if len(contour.at) else np.inf
            off.append(way / palette.half_width)
        least, most = min(seen), max(off)
        before, _ = self.world(self.states[-1])
        way = np.linalg.norm(tube.mean(axis=0) - before.mean(axis=0), axis=1).max()
        broad = np.linalg.norm(tube - tube.mean(axis=0), axis=2).max()
        if max(out) > MOST_OUT:
            return "lost: it has left the image", least, most
        if self.straight and folded(*self.world(state)):
            return "lost: it has folded", least, most
        if least < (LEAST_BACK if was_lost else LEAST_SEEN):
            return "lost: its colours are not where it must be: hidden, or moved too far", least, most
        if most > (self._fair(NEAR) if was_lost else MOST_OFF):
            return "lost: no edges where its contour must be", least, most
        if not was_lost and way > REACHES[-1] * broad:
            return "lost: it moved too far between two frames", least, most
        return "", least, most


def folded(tube: np.ndarray, spine: np.ndarray) -> bool:
    """Whether a spine (N_s, 3) turns back within a radius of its tube (N_x, N_s, 3), as nothing so thick can bend."""
    step = np.linalg.norm(np.diff(spine, axis=0), axis=1)
    place = np.append(0.0, np.cumsum(step))
    radius = np.linalg.norm(tube - spine, axis=2).mean(axis=0)
    tangent = np.diff(spine, axis=0) / np.maximum(step, 1e-30)[:, None]
    middle, wide = 0.5 * (place[1:] + place[:-1]), np.minimum(radius[1:], radius[:-1])
    near = np.abs(middle[:, None] - middle) < np.minimum(wide[:, None], wide)
    return bool((near & (tangent @ tangent.T < 0)).any())


def turns(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Least rotations (N_s, 3, 3) that take the tangents of one spine (N_s, 3) to those of another."""
    a, b = (ndimage.gaussian_filter1d(np.gradient(s, axis=0), SMOOTH, axis=0, mode="nearest") for s in (old, new))
    a, b = (t / np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-30) for t in (a, b))
    axis, cosine = cross(a, b), (a * b).sum(axis=1)
    turn = cross(np.eye(3)[None], axis[:, None])
    return np.eye(3) + turn + turn @ turn / (1 + np.maximum(cosine, -0.99))[:, None, None]
