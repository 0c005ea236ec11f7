"""The handle of an object's radius: a point beside the middle of its axis, as far away as the first tube is thick."""

from __future__ import annotations

import numpy as np

from symseek.sim.camera import Camera
from symseek.sim.initial import lift

from .part import Snapshot
from .session import Session


def rate(camera: Camera, at: np.ndarray) -> np.ndarray:
    """How the image of a world point, shape (3,), goes with it, shape (2, 3) [px / world unit]."""
    step = 1e-4 * max(float(np.abs(at).max()), 1.0)
    ways = [camera.project(at + step * e) - camera.project(at - step * e) for e in np.eye(3)]
    return np.array(ways).T / (2 * step)


def pixels(session: Session, uid: int, v: int) -> float | None:
    """Of view v, for a world unit at an object; None while it is being drawn."""
    tube = session.tube(session.item(uid))
    if tube is None:
        return None
    spine = np.asarray(tube.spine, float)
    world = spine if spine.shape[1] == 3 else lift(spine, session.view.camera, tube.depth)
    return float(np.linalg.norm(rate(session.views[v].camera, world.mean(axis=0))[1]))


def handle_of(session: Session, uid: int, v: int, s: Snapshot | None) -> np.ndarray | None:
    """The handle of an object in view v; where its radius is the image's, by the model as it is. None without an axis."""
    unit, item = pixels(session, uid, v), session.item(uid)
    axis = [] if item.in_world else session.axis(uid, v)
    radius = item.table.get("radius")
    if radius is None and s is not None:
        middle = s.tube.shape[1] // 2
        radius = float(np.linalg.norm(s.tube[:, middle] - s.spine[middle], axis=1).mean())
    return None if unit is None or radius is None or len(axis) < 2 else handle(np.array(axis), unit * radius)


def handle(axis: np.ndarray, radius: float) -> np.ndarray:
    """From the middle of an axis (n, 2), along its normal, to where it is to be taken hold of; shape (2, 2)."""
    ways = np.diff(axis, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    half = 0.5 * lengths.sum()
    k = min(int(np.searchsorted(np.cumsum(lengths), half)), len(ways) - 1)
    along = ways[k] / max(lengths[k], 1e-9)
    foot = axis[k] + (half - lengths[:k].sum()) * along
    return np.array([foot, foot + radius * np.array([along[1], -along[0]])])


def away(axis: np.ndarray, place: np.ndarray) -> float:
    """Distance of a place from an axis (n, 2)."""
    a, way = axis[:-1], np.diff(axis, axis=0)
    share = np.clip(((place - a) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-12), 0, 1)
    return float(np.linalg.norm(a + share[:, None] * way - place, axis=1).min())
