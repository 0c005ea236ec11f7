"""What following a tube rests on: sampled images, moves as a rod, where it is looked for, and ends at which it goes on."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from symseek.sim.bend import bend, cross
from symseek.sim.beyond import capped, past, places
from symseek.sim.camera import Camera
from symseek.sim.follow import DOUBTFUL, Follower, Tracking, folded
from symseek.sim.foreground import Foreground
from symseek.sim.palette import Palette
from symseek.sim.potential import Potential, fewer
from symseek.sim.problem import Settings, Tube, View
from symseek.sim.retake import profile, retaken
from symseek.sim.sampling import resample
from symseek.sim.search import shifted
from symseek.sim.surface import silhouette
from symseek.sim.track import track
from tests.rig import circles

SHAPE = (150, 200)
EYES = [Camera.stereo(a) for a in (0.4, -0.4)]
HALF = 9.0


def rod(spine: np.ndarray, radius: float = HALF) -> tuple[np.ndarray, np.ndarray]:
    """A tube (12, n, 3) with round ends about a spine (n, 3), which lies about along Y."""
    u = np.linspace(-1, 1, len(spine))
    tube = circles(np.zeros((len(spine), 3)), radius * np.sqrt(np.clip(1 - u**6, 0, 1)), 12).transpose(1, 0, 2)
    tangent = np.gradient(spine, axis=0)
    turned = [Rotation.align_vectors(t[None], [[0, 1, 0]])[0].apply(tube[:, j]) for j, t in enumerate(tangent)]
    return np.stack(turned, axis=1) + spine, spine


def straight(middle=(100.0, 75.0, 0.0), long: float = 90.0) -> tuple[np.ndarray, np.ndarray]:
    """A rod along Y."""
    return rod(np.array(middle) + np.linspace(-0.5, 0.5, 21)[:, None] * [0, long, 0])


def bright(tube: np.ndarray, camera: Camera) -> np.ndarray:
    """An image in which a tube is bright, blurred by a pixel."""
    mask = silhouette(4 * camera.project(tube) + 1.5, (4 * SHAPE[0], 4 * SHAPE[1])).astype(float)
    cover = mask.reshape(SHAPE[0], 4, SHAPE[1], 4).mean(axis=(1, 3))
    return (0.2 + 0.6 * ndimage.gaussian_filter(cover, 1.0)).astype(np.float32)


def way_to(tube: np.ndarray, camera: Camera) -> Potential:
    """A potential whose pull is the way to the nearest point of a tube's outline."""
    mask = silhouette(4 * camera.project(tube) + 1.5, (4 * SHAPE[0], 4 * SHAPE[1]))
    edge = np.argwhere(mask ^ ndimage.binary_erosion(mask))[:, ::-1]
    rows, columns = np.indices(SHAPE)
    points = np.stack([columns, rows], axis=-1).reshape(-1, 2)
    near = (edge[KDTree(edge).query(4 * points + 1.5)[1]] - 1.5) / 4
    samples = np.zeros((*SHAPE, 4), np.float32)
    samples[..., :2] = (near - points).reshape(*SHAPE, 2)
    return Potential(1.0, samples, np.ones(SHAPE), 1.0, (0.0, 0.0))


@pytest.mark.parametrize(("step", "smooth"), [(1.7, True), (1.7, False), (0.6, True), (1.0, True)])
def test_samples(step, smooth):
    """As a Gaussian filter and linear interpolation have them, beyond the border too; whatever part they are of."""
    image = np.random.default_rng(0).random((40, 30, 2)).astype(np.float32)
    origin, shape = np.array([12.4, -3.2]), (31, 17)
    sigma = 0.5 * np.sqrt(step**2 - 1) if step > 1 and smooth else 0.0
    soft = ndimage.gaussian_filter(image.astype(float), (sigma, sigma, 0), mode="nearest", truncate=3) if sigma else image
    grid = np.meshgrid(*(origin[1 - i] + step * np.arange(shape[i]) for i in (0, 1)), indexing="ij")
    want = [ndimage.map_coordinates(soft[..., c], grid, order=1, mode="nearest") for c in (0, 1)]
    np.testing.assert_allclose(resample(image, origin, step, shape, smooth), np.stack(want, axis=-1), atol=2e-6)


def test_channels_that_tell_no_edges_are_left_out():
    """An edge in a mixture of two of three channels is left in one, as high as it was; elsewhere may be what will."""
    step = (np.arange(40) >= 20).astype(np.float32)
    image = np.broadcast_to(step[:, None], (30, 40, 1)) * np.array([0.6, 0.0, 0.8], np.float32)
    image[:4, :, 1] = np.random.default_rng(0).random((4, 40))
    weight = np.ones((30, 40))
    weight[:6] = 0.0
    left = fewer(image, weight)
    assert left.shape == (30, 40, 1)
    np.testing.assert_allclose(np.abs(np.diff(left[10, :, 0])), np.abs(np.diff(step)), atol=1e-6)
    assert fewer(image, np.ones((30, 40))).shape[2] == 2


def test_cross():
    a, b = np.random.default_rng(0).standard_normal((2, 5, 4, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b))


@pytest.mark.parametrize(("degree", "bent"), [(0, 0.0), (3, 0.0), (3, 6.0)])
def test_moves_lead_to_the_outlines(degree, bent):
    """Of a rod that has moved in all three directions and turned, and of one that has bent too."""
    tube, spine = straight()
    u = np.linspace(-1, 1, len(spine))
    turn = Rotation.from_rotvec([0.03, 0, 0.06]).as_matrix()
    middle = spine.mean(axis=0)
    goal = (spine - middle) @ turn.T + middle + [3.0, 2.0, 5.0] + bent * (u**2)[:, None] * [1, 0, 0]
    there = rod(goal)[0]
    potentials = [way_to(there, camera) for camera in EYES]
    moved = tube, spine
    for _ in range(12):
        moved = bend(*moved, EYES, potentials, [SHAPE, SHAPE], degree)
    start, off = (np.linalg.norm(s[2:-2] - goal[2:-2], axis=1).mean() for s in (spine, moved[1]))
    assert off < 0.12 * start
    if degree == 0:  # it stays what it was
        before, after = (np.linalg.norm(np.diff(t, axis=1), axis=2) for t in (tube, moved[0]))
        np.testing.assert_allclose(after, before, rtol=1e-9)


def palettes_of(tube: np.ndarray, spine: np.ndarray) -> tuple[list[Palette], list[View]]:
    views = [View(bright(tube, camera), camera) for camera in EYES]
    maps = []
    for view in views:
        inside = silhouette(view.camera.project(tube), SHAPE).astype(np.float32)
        maps.append(Foreground(inside, 1.0, (0.0, 0.0), 90.0, HALF, view.camera.project(spine)))
    return [Palette(view, map_) for view, map_ in zip(views, maps, strict=True)], views


def test_what_has_gone_further_than_it_must_is_looked_for():
    """The shift in space that brings a rod to where it is now, by its colours in both eyes."""
    tube, spine = straight()
    palettes, _ = palettes_of(tube, spine)
    way = np.array([14.0, -9.0, 12.0])
    views = [View(bright(tube + way, camera), camera) for camera in EYES]
    found = shifted(tube, spine, palettes, views, 4.0)
    pixels = [np.linalg.norm(camera.project(way[None]) - camera.project(found[None])) for camera in EYES]
    assert max(pixels) < 3.0 and np.linalg.norm(way) > 15  # an arrow's ends are points of the world whose origin is 0
    assert np.linalg.norm(shifted(tube, spine, palettes, palettes_of(tube, spine)[1], 4.0)) < 3.0


def test_what_has_bent_meanwhile_is_taken_up_again():
    """A rod that lies elsewhere, bent to an arc; nothing where nothing has its colours, or only something smaller."""
    tube, spine = straight()
    palettes, views = palettes_of(tube, spine)
    profiles = [profile(view.image, view.camera.project(spine)) for view in views]
    angle = np.linspace(-0.6, 0.6, 21)
    arc = np.stack([130 - 75 * np.cos(angle), 70 + 75 * np.sin(angle), 0 * angle], axis=1)
    there = rod(arc)[0]
    now = [View(bright(there, camera), camera) for camera in EYES]
    found = retaken(tube, spine, palettes, now, profiles)
    assert found is not None
    away = KDTree(found[1]).query(arc[2:-2])[0]
    assert away.mean() < 0.4 * HALF
    empty = [View(np.full(SHAPE, 0.2, np.float32), camera) for camera in EYES]
    assert retaken(tube, spine, palettes, empty, profiles) is None
    small = [View(bright(straight(long=30)[0], camera), camera) for camera in EYES]
    assert retaken(tube, spine, palettes, small, profiles) is None


@pytest.mark.parametrize("better", [False, True])
def test_what_lies_badly_is_laid_anew_or_doubted(monkeypatch, better):
    """A rod that may not move, while what it shows goes aside by a quarter of its half width."""
    eye = Camera.orthographic()
    pictures = [[bright(straight((100.0 + x, 75.0, 0.0))[0], eye)] for x in (0.0, 0.25 * HALF)]

    def elsewhere(self, looks):
        tube, spine = self.states[0]
        way = np.array([0.25 * HALF, 0, 0]) / float(self.scene.unit)
        return (looks, ((tube + way).astype(np.float32), (spine + way).astype(np.float32))) if better else None

    monkeypatch.setattr(Follower, "_look_everywhere", elsewhere)
    rough = Tube(np.array([[100.0, 38.0], [100.0, 75.0], [100.0, 112.0]]))
    o = track(pictures, [View(pictures[0][0], eye)], [rough], tracking=Tracking(0, first="none")).objects[0]
    assert o.notes == ["", "" if better else DOUBTFUL] and o.trusted == better
    np.testing.assert_allclose((o.spine[1] - o.spine[0])[:, 0], 0.25 * HALF * better, atol=1e-3)


def test_a_spine_that_turns_back_has_folded():
    """Within a radius of its tube; an arc as narrow as a tube can bend, and one that comes by itself again, have not."""
    tube, spine = straight()
    assert not folded(tube, spine)
    back = spine.copy()
    back[10:] = spine[10] - 0.8 * (spine[10:] - spine[10])
    assert folded(tube - spine + back, back)
    angle = np.linspace(0, 1.9 * np.pi, 61)
    ring = 25 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    assert not folded(*rod(ring))


def test_past_an_end():
    """What lies ahead of an end, nearer to it than to the rest of the curve; on one side only where one end goes on."""
    curve = np.array([[20.5, 30], [40, 30], [60, 30], [79.5, 30]])
    rows, columns = np.indices((60, 110))
    first, both = past(curve, (True, False), (60, 110)), past(curve, (True, True), (60, 110))
    np.testing.assert_array_equal(first, columns <= 20)
    np.testing.assert_array_equal(both, (columns <= 20) | (columns >= 80))
    inside = past(curve, (True, True), (60, 110), np.array([[0.0, 10], [30, 50]]))
    np.testing.assert_array_equal(inside, (columns <= 20) & (rows >= 10) & (rows <= 50))
    hook = np.array([[20.0, 30], [60, 30], [60, 10], [20, 10]])  # what is ahead of one end may be nearer to another part
    assert not past(hook, (True, False), (60, 110))[8, 5] and past(hook, (True, False), (60, 110))[40, 5]


def test_a_cap_stands_for_what_goes_on():
    """Round, as deep as wide, as wide as the tube beside that end; the rest stays; found again where it was drawn."""
    tube, spine = straight()
    at = places(spine, spine[[4, -1]] + [2.0, 0, 0])
    np.testing.assert_allclose(at, [4, 20], atol=0.06)
    new, line = capped(tube, spine, (True, False), np.array([4.0, 20.0]))
    np.testing.assert_array_equal(new[:, 4:], tube[:, 4:])
    np.testing.assert_array_equal(line[4:], spine[4:])
    radii = np.linalg.norm(tube - spine, axis=2).mean(axis=0)
    assert 2 * radii[4] < np.linalg.norm(spine[9] - spine[4])
    radius = radii[4:10].mean()  # of five rings more, which reach further than the tube is wide
    assert np.linalg.norm(line[0] - spine[4]) == pytest.approx(radius)
    np.testing.assert_allclose(np.linalg.norm(new[:, :4] - spine[4], axis=2), radius, rtol=1e-6)
    assert (new[..., 1].min() - (spine[4, 1] - radius)) == pytest.approx(0)


@pytest.mark.parametrize("long", [45.0, 130.0])
def test_what_is_stubby_is_held_stiffer(long):
    """While followed: by the square of width over length below seven widths; the tube is drawn, its size is known."""
    tube, spine = straight(long=long)
    image, shares = bright(tube, Camera.orthographic()), []
    quick = Settings(iterations=60)
    track(
        [[image]] * 2,
        [View(image)],
        [Tube(spine[3:-3:3, :2])],
        quick,
        callback=lambda shown: shares.append(shown.followers[0].share),
    )
    assert shares == [pytest.approx(0.03 * max(1.0, (7 * 2 * HALF / long) ** 2), rel=0.15)]
