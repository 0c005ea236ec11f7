"""Tubes followed from frame to frame: a finger with known shape and velocity, frames that are missing, files."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from benchmarks import truth
from symseek.device import start_quietly
from symseek.scenes.finger import TIP_SPEED, Finger
from symseek.sim import guide
from symseek.sim.problem import Tube, View
from symseek.sim.track import Tracking, track, velocity

COUNT = 8


@pytest.fixture(scope="module")
def finger() -> Finger:
    return Finger(seed=0, frames=40)


@pytest.fixture(scope="module")
def frames(finger):
    return [finger.frame(i) for i in range(COUNT)]


def follow(finger, stream):
    views = [View(np.zeros((1, 1)), camera, name) for camera, name in zip(finger.cameras, ("left", "right"), strict=True)]
    return track(stream, views, [Tube(finger.rough)], tracking=Tracking(fps=finger.fps))


def seen(finger, points):
    """Points that both images hold: the base is cut off."""
    sides = [camera.project(points) for camera in finger.cameras]
    return points[np.all([((p >= 0) & (p <= [639, 479])).all(axis=1) for p in sides], axis=0)]


@pytest.fixture(scope="module")
def found(finger, frames):
    start_quietly()
    return follow(finger, [frame.images for frame in frames])


@pytest.mark.parametrize("seed", [0, 11, 12])
@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_the_tip_goes_as_fast_as_it_says(seed, speed):
    """At its fastest, whichever part of its motion that is in."""
    finger = Finger(seed, speed=speed)
    tip = np.stack([finger.cameras[0].project(finger._axis(i))[-1] for i in range(300)])
    fastest = np.linalg.norm(np.diff(tip, axis=0), axis=1).max()
    assert 0.9 * speed * TIP_SPEED < fastest < 1.02 * speed * TIP_SPEED


def test_a_bending_finger_is_followed(finger, frames, found):
    """In every frame both silhouettes and the depth of the axis are near the truth."""
    (o,) = found.objects
    assert o.tube.shape == (COUNT, 25, 25, 3) and o.spine.shape == (COUNT, 25, 3) and len(o.time) == COUNT
    for i, frame in enumerate(frames):
        nodes = seen(finger, o.tube[i].reshape(-1, 3))
        assert KDTree(frame.vertices).query(nodes)[0].mean() < 0.01 * finger.length
        inner = seen(finger, o.spine[i])[:-3]
        apart = inner - frame.spine[KDTree(frame.spine).query(inner)[1]]
        assert np.abs(apart[:, 2]).mean() < 0.01 * finger.length
    assert o.trusted and o.measures["partial"]  # its base is cut off, which is told and no doubt
    stayed = KDTree(frames[-1].vertices).query(seen(finger, o.tube[0].reshape(-1, 3)))[0]
    assert stayed.mean() > 0.02 * finger.length  # it would not do to stay where it was
    for camera, cover in zip(finger.cameras, frames[-1].coverages, strict=True):
        assert truth.silhouette_iou(o.vertices, o.faces, camera, cover) > 0.96


def test_bent_joints_do_not_turn_the_ends_into_depth(monkeypatch):
    """Outlines do not tell where in its round ends the axis leads; what is told of the body must not bend it there.

    Over the same frame again and again, against ends led by as much of the body as in still images.
    """
    start_quietly()
    finger = Finger(51, cut=False, out_of_round=0.0)
    frame = finger.frame(26)
    views = [View(image, c, n) for image, c, n in zip(frame.images, finger.cameras, ("left", "right"), strict=True)]

    def depths() -> np.ndarray:
        o = track([frame.images] * 9, views, [Tube(frame.spine[15:185:34])]).objects[0]
        off = [line - frame.spine[KDTree(frame.spine[:, :2]).query(line[:, :2])[1]] for line in o.spine]
        return np.abs(np.stack(off)[..., 2]).mean(axis=1) / finger.length

    depth = depths()
    assert depth[-5:].max() < 0.0021 and depth[-1] < 0.0017 and depth[-1] < 0.7 * depth[0]
    monkeypatch.setattr("symseek.sim.follow.CLOSELY", guide.SMOOTH)
    assert depth[-5:].mean() < 0.95 * depths()[-5:].mean()


def test_velocity_across_the_surface(finger, frames, found):
    """Normal part of the velocity of the middle frames against the true skin's, near each node."""
    (o,) = found.objects
    for i in range(2, COUNT - 2):
        frame = frames[i]
        true = frame.velocity[KDTree(frame.vertices).query(o.tube[i].reshape(-1, 3))[1]]
        size = np.sqrt((true**2).sum(axis=1).mean())
        assert size > 5  # mm a second: it moves
        error = o.velocity[i].reshape(-1, 3) - true
        assert np.sqrt((error**2).sum(axis=1).mean()) < 0.5 * size


def test_a_missing_frame_is_skipped_and_told(finger, frames):
    stream = [frame.images for frame in frames[:5]]
    stream[2] = "left.png is broken"
    told = follow(finger, stream)
    (o,) = told.objects
    assert len(o.tube) == 5 and np.isfinite(o.tube).all()
    assert any("left.png is broken" in str(note) for note in o.notes)
    assert not o.trusted and any("left.png is broken" in warning for warning in o.warnings)


def test_what_is_gone_is_lost_and_taken_up_again(finger, frames):
    """Two frames of the bare ground: told as lost in both, its place kept, and found when it is there again."""
    bare = []
    for image, cover in zip(frames[3].images, frames[3].coverages, strict=True):
        ground = np.median(image[cover == 0], axis=0)
        bare.append(np.where(cover[..., None] > 0, ground, image).astype(np.float32))
    stream = [frame.images for frame in frames]
    stream[3] = stream[4] = bare
    (o,) = follow(finger, stream).objects
    assert [note.startswith("lost") for note in o.notes] == [False, False, False, True, True, False, False, False]
    assert not o.trusted and any("frames 3 to 4: lost" in warning for warning in o.warnings)
    np.testing.assert_array_equal(o.tube[3], o.tube[2])
    nodes = seen(finger, o.tube[-1].reshape(-1, 3))
    assert KDTree(frames[-1].vertices).query(nodes)[0].mean() < 0.015 * finger.length


def test_same_bits_twice(finger, frames, found):
    again = follow(finger, [frame.images for frame in frames[:3]]).objects[0]
    np.testing.assert_array_equal(again.tube, found.objects[0].tube[:3])


def test_no_first_frame():
    with pytest.raises(ValueError, match="the first frame cannot be read: there is none"):
        track([], [View(np.zeros((4, 4)))], [Tube(np.array([[1.0, 1], [2, 2]]))])


def test_velocity_of_even_motion():
    """Nodes that go on evenly have the velocity of it in every frame, at the ends too; what was lost has none."""
    rng = np.random.default_rng(0)
    start, way = rng.standard_normal((2, 4, 5, 3))
    tube = np.stack([start + i * way for i in range(6)])
    np.testing.assert_allclose(velocity(tube, [False] * 6), np.broadcast_to(way, tube.shape), atol=1e-12)
