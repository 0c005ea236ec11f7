"""Stereo frames of a bending finger with known shape, pose and velocity (the paper's figures 11 and 12).

`python -m symseek.scenes.finger` writes the videos of the scenes `finger` and `finger_perspective` anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from ..sim.camera import Camera
from ..sim.sights import triangulated
from . import shapes
from .synthetic import render

SHAPE = (480, 640)
SCALE = 0.27
"""World units, mm, a pixel (at the finger, where the view is perspective)."""
LENGTH, BASE, TIP = 96.0, 9.3, 6.6
"""Of the axis; radius at the base and before the tip [mm]."""
BEYOND = 24.0
"""How far a base that is cut off reaches beyond the image's border [mm]."""
JOINTS, SOFT = (0.44, 0.72), 0.065
"""Where the finger bends, and half over how much of it, in shares of its length."""
FLEXION = ((8.0, 52.0), (4.0, 34.0))
"""Least and most angle of each joint [degrees]."""
TIP_SPEED = 7.5
"""Fastest way of the tip from frame to frame in the image [px]."""
ALPHA = 0.2
"""Of the paper's (15), either way; tangent of half the angle between perspective cameras."""
DISTANCE = 480.0
"""Of perspective cameras [mm]."""
SKIN = np.array([0.93, 0.70, 0.56])
LIGHT = np.array([-0.35, -0.6, -1.0])


@dataclass(frozen=True)
class Frame:
    """One pair of images and what is true of them."""

    images: list[np.ndarray]
    """float32 in [0, 1], shape (H, W, 3) each."""
    coverages: list[np.ndarray]
    """share of each pixel that the finger covers, float32, shape (H, W) each."""
    vertices: np.ndarray
    """true mesh [mm], watertight, shape (V, 3); each vertex is one point of the skin."""
    velocity: np.ndarray
    """of each vertex [mm / s], shape (V, 3)."""
    spine: np.ndarray
    """true axis [mm], shape (n, 3)."""


class Finger:
    """A finger that bends and sways before two eyes.

    Args:
        seed: fixes shape, pose, motion and noise.
        frames: how many.
        speed: 1: the tip goes `TIP_SPEED` px a frame at the fastest.
        perspective: two cameras that converge; otherwise the paper's (15).
        out_of_round: of its sections, see `shapes.mesh`.
        cut: the base reaches beyond the image's lower border, or the left one; otherwise it ends round within.
        along: the finger lies along the line between the eyes, from the left border, rather than across it, from the lower
            one: outlines along that line are the same for every depth, which then ends, bends and shading hardly tell.
        noise: standard deviation of the images' noise.
        bending: share of its flexion; 0: it is rigid, as bent as it is least.

    Attributes:
        cameras: of both views.
        faces: of every frame's mesh, shape (F, 3).
        clicks: five rough points (column, row) along the axis in each view of frame 0, shape (5, 2) each.
        rough: the axis that they tell of, shape (n, 3) [mm].
        length: of the axis [mm].
    """

    fps = 30.0

    def __init__(
        self,
        seed: int = 0,
        frames: int = 40,
        speed: float = 1.0,
        perspective: bool = False,
        out_of_round: float = 0.03,
        cut: bool = True,
        along: bool = False,
        noise: float = 0.01,
        bending: float = 1.0,
    ):
        self.seed, self.frames, self.noise, self.bending = seed, frames, noise, bending
        shape_rng, pose_rng, click_rng = (np.random.default_rng([seed, k]) for k in range(3))
        self.length = LENGTH + BEYOND * cut
        self._before = BEYOND * cut
        self._sections(shape_rng, out_of_round)
        self._pose(pose_rng, cut, along)
        self.cameras = self._eyes(perspective)
        self._rate = 1.0
        # all that moves comes round once in 40 frames
        tip = np.stack([self.cameras[0].project(self._axis(t)[-1]) for t in np.linspace(0, 40, 401)])
        fastest = np.linalg.norm(np.diff(tip, axis=0), axis=1).max() * 10
        self._rate = speed * TIP_SPEED / fastest
        self.clicks = [self._clicked(camera, click_rng) for camera in self.cameras]
        self.rough = triangulated(self.clicks, self.cameras)
        y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / SHAPE[1]
        mat = gaussian_filter(np.random.default_rng([seed, 3]).standard_normal(SHAPE), 3) * 6
        glow = 0.13 + 0.05 * (x + y) + 0.012 * mat
        self._behind = glow[..., None] * np.array([0.8, 0.95, 1.1])

    def _clicked(self, camera: Camera, rng: np.random.Generator) -> np.ndarray:
        axis = camera.project(self._axis(0.0))
        on = np.flatnonzero(((axis > 8) & (axis < np.array(SHAPE[::-1]) - 8)).all(axis=1))
        at = np.rint(np.linspace(0.08, 0.92, 5) * (len(on) - 1)).astype(int)
        return axis[on[at]] + 3.0 * rng.standard_normal((5, 2))

    def _sections(self, rng: np.random.Generator, out_of_round: float) -> None:
        """Rings of the skin: where they lie along the axis, radii around, and how bright the skin is there."""
        u = (1 - np.cos(np.linspace(0, np.pi, 2001))) / 2
        at = (u * self.length - self._before) / LENGTH
        body = BASE + (TIP - BASE) * np.clip(at, -0.3, 1)
        for place, high in zip(JOINTS, (0.55, 0.35), strict=True):
            body = body + high * np.exp(-(((at - place) / 0.06) ** 2))
        station, radius = shapes.close(u, body / self.length, (shapes.Round(1.0), shapes.Round(1.25)))
        solid = shapes.Sweep(station, radius, np.zeros((2, 2)))
        self._station, radius = shapes.resample(solid, 200)
        angle = 2 * np.pi * np.arange(96) / 96
        around = shapes.sections(self._station, angle, out_of_round, rng)
        along = (self._station * self.length - self._before) / LENGTH
        # the back of the finger is at angle pi, away from where it bends to
        nail = _step((along - 0.87) / 0.012) * _step((0.985 - along) / 0.012)
        off = np.abs(np.angle(np.exp(1j * (angle - np.pi))))
        plate = nail[:, None] * _step((0.75 - off) / 0.06)
        crease = np.exp(-(((along[:, None] - np.array(JOINTS)) / 0.012) ** 2)).sum(axis=1)
        paint = 1 + 0.16 * plate - 0.07 * crease[:, None] * (0.5 + 0.5 * np.cos(2 * angle))
        self._radius = self.length * radius[:, None] * around * (1 - 0.02 * plate)
        poles = paint[[0, -1]].mean(axis=1)
        self._paint = np.concatenate([poles[:1], paint[1:-1].ravel(), poles[1:]])

    def _pose(self, rng: np.random.Generator, cut: bool, along: bool) -> None:
        """Where the finger's own plane lies, and how it sways."""
        tilt, roll = np.radians(rng.uniform(-14, 14)), np.radians(rng.uniform(20, 50) * rng.choice([-1, 1]))
        c, s = np.cos(roll), np.sin(roll)
        about = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        c, s = np.cos(tilt), np.sin(tilt)
        self._turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ about
        side, inner = SCALE * rng.uniform(150, 210), -self._before if cut else SCALE * 60
        if along:
            self._root = np.array([inner, side, 0.0])
        else:
            self._turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) @ self._turn
            self._root = np.array([side, SCALE * (SHAPE[0] - 1) - inner, 0.0])
        self._phase = rng.uniform(0, 2 * np.pi, 4)
        self._sway = np.radians(rng.uniform(4, 7)), np.radians(rng.uniform(2, 4))
        self._shift = SCALE * rng.uniform(3, 6, 3) * np.array([0.3, 1.0, 2.0])
        if not along:
            self._shift = self._shift[[1, 0, 2]]

    def _eyes(self, perspective: bool) -> list[Camera]:
        if not perspective:
            return [Camera.stereo(a, SCALE) for a in (ALPHA, -ALPHA)]
        middle = np.array([(SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2])
        K = np.array([[DISTANCE / SCALE, 0, middle[0]], [0, DISTANCE / SCALE, middle[1]], [0, 0, 1.0]])
        out = []
        for a in (np.arctan(ALPHA), -np.arctan(ALPHA)):
            c, s = np.cos(a), np.sin(a)
            R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
            out.append(Camera.perspective(K, R, np.array([0, 0, DISTANCE]) - R @ np.array([*SCALE * middle, 0.0])))
        return out

    def _line(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Axis in the finger's own plane at each ring, points and tangents, shape (n, 2), at a time in frames."""
        p = 2 * np.pi * self._rate * t / 40
        at = np.linspace(0, 1, 1601)
        along = (at * self.length - self._before) / LENGTH
        heading = self._sway[0] * np.sin(p + self._phase[0]) * np.ones_like(at)
        for (least, most), place, lag in zip(FLEXION, JOINTS, (0.0, 0.4), strict=True):
            angle = np.radians(least + self.bending * (most - least) * 0.5 * (1 - np.cos(p + lag)))
            heading += angle * 0.5 * (1 + np.tanh((along - place) / SOFT))
        d = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        line = np.concatenate([np.zeros((1, 2)), np.cumsum((d[1:] + d[:-1]) / 2, axis=0)]) * self.length / 1600
        line, d = (np.stack([np.interp(self._station, at, c) for c in of.T], axis=1) for of in (line, d))
        return line, d

    def _placed(self, points: np.ndarray, t: float) -> np.ndarray:
        """Points (n, 3) of the finger's own frame in the world."""
        p = 2 * np.pi * self._rate * t / 40
        a = self._sway[1] * np.sin(p + self._phase[1])
        c, s = np.cos(a), np.sin(a)
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ self._turn
        return points @ turn.T + self._root + self._shift * np.sin(p + self._phase[[2, 3, 2]])

    def _axis(self, t: float) -> np.ndarray:
        line, _ = self._line(t)
        return self._placed(np.column_stack([line, np.zeros(len(line))]), t)

    def _skin(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        line, tangent = self._line(t)
        vertices, faces = shapes.tube(line, tangent, self._radius)
        return self._placed(vertices, t), faces

    def frame(self, i: int) -> Frame:
        """Frame i, from 0."""
        vertices, faces = self._skin(i)
        after, before = self._skin(i + 1e-3)[0], self._skin(i - 1e-3)[0]
        images, coverages = [], []
        rng = np.random.default_rng([self.seed, 4, i])
        for camera in self.cameras:
            shade, cover = render(vertices, faces, SHAPE, LIGHT, ambient=0.55, gloss=0.08, camera=camera, paint=self._paint)
            alpha = cover[..., None]
            image = (1 - alpha) * self._behind + alpha * shade[..., None] * SKIN
            image = image + self.noise * rng.standard_normal(image.shape)
            images.append(np.clip(image, 0, 1).astype(np.float32))
            coverages.append(cover)
        velocity = (after - before) / 2e-3 * self.fps
        return Frame(images, coverages, vertices, velocity, self._axis(i))

    @property
    def faces(self) -> np.ndarray:
        """Of every frame's mesh, shape (F, 3)."""
        return self._skin(0.0)[1]


def _step(x: np.ndarray) -> np.ndarray:
    """From 0 to 1 about 0."""
    return 0.5 * (1 + np.tanh(x))


def write(folder: Path, perspective: bool = False) -> None:
    """Write left.mp4 and right.mp4 of the first finger."""
    from ..render.video import write_mp4  # scenes are made without it elsewhere

    finger = Finger(perspective=perspective)
    frames = [finger.frame(i) for i in range(finger.frames)]
    folder.mkdir(parents=True, exist_ok=True)
    for view, name in enumerate(("left", "right")):
        pictures = [np.round(255 * f.images[view]).astype(np.uint8) for f in frames]
        write_mp4(folder / f"{name}.mp4", pictures, finger.fps, crf=22)


if __name__ == "__main__":
    write(Path(__file__).parent / "finger")
    write(Path(__file__).parent / "finger_perspective", perspective=True)
