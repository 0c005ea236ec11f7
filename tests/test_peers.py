"""The benchmark's measures of error on closed forms, and its peers on shapes that they can do."""

import dataclasses

import numpy as np
import pytest
import trimesh

from benchmarks import accuracy, lines, truth
from benchmarks.peers import contour_peer, generalised_cylinder, inflation, large_steps, line_solvers
from symseek.scenes import views
from symseek.scenes.synthetic import KINDS, make
from symseek.sim.camera import Camera
from tests import reference

CAMERA = Camera.orthographic()


def _sphere(radius, centre=(60.0, 60.0, 0.0)):
    ball = trimesh.creation.icosphere(5, radius)
    return np.asarray(ball.vertices) + centre, np.asarray(ball.faces)


def test_two_balls_about_one_point():
    """Radii 40 and 44: IoU (40/44)^2, outlines 4 px apart, surfaces 4, volume (40/44)^3 - 1."""
    inner, faces = _sphere(40.0, (60.0, 60.0, 33.0))  # depth must not count
    outer, _ = _sphere(44.0)
    cover = truth.silhouette(outer, faces, CAMERA, (120, 121))
    assert truth.silhouette_iou(inner, faces, CAMERA, cover) == pytest.approx((40 / 44) ** 2, rel=2e-3)
    mean, p95, largest = truth.contour_error(inner, faces, CAMERA, cover)
    assert mean == pytest.approx(4, abs=0.02) and 4 <= p95 <= largest < 4.2
    assert truth.surface_error(inner, faces, outer, faces, 88.0) == pytest.approx(100 * 4 / 88, rel=2e-3)
    error = truth.volume_error(inner, faces, truth.volume(outer, faces))
    assert error == pytest.approx(100 * ((40 / 44) ** 3 - 1), rel=1e-6)


def test_outlines_of_discs_apart_and_nothing():
    """A disc of radius r moved by d: IoU of the lens, mean distance about 2 d / pi."""
    vertices, faces = _sphere(40.0)
    r, d = 40.0, 5.0
    step = np.array([d, 0, 0])
    cover, moved = (truth.silhouette(v, faces, CAMERA, (120, 130)) for v in (vertices, vertices + step))
    lens = 2 * r**2 * np.arccos(d / (2 * r)) - d / 2 * np.sqrt(4 * r**2 - d**2)
    assert truth.overlap(cover, moved) == pytest.approx(lens / (2 * np.pi * r**2 - lens), rel=2e-3)
    assert truth.outline_error(cover, moved)[0] == pytest.approx(2 * d / np.pi, rel=0.02)
    assert truth.outline_error(cover, moved)[2] == pytest.approx(d, abs=0.1)
    assert truth.overlap(cover, np.zeros_like(cover)) == 0
    assert truth.outline_error(cover, np.zeros_like(cover))[0] == np.inf


def test_a_mask_serves_as_truth():
    vertices, faces = _sphere(40.0)
    mask = truth.silhouette(vertices, faces, CAMERA, (120, 120)) >= 0.5
    assert truth.silhouette_iou(vertices, faces, CAMERA, mask) > 0.98


def test_distance_to_triangles():
    triangle = np.array([[[0, 0, 0], [4, 0, 0], [0, 4, 0.0]]])
    points = np.array([[1, 1, 3], [-3, -4, 0], [2, -1, 0], [4, 4, 1], [1, 1, 0.0]])
    exact = [3, 5, 1, np.sqrt(2 * 4 + 1), 0]
    np.testing.assert_allclose(truth._to_triangles(points[:, None], triangle[None])[:, 0], exact, atol=1e-12)


def test_outline_coverage_of_a_square():
    square = np.array([[9.5, 19.5], [29.5, 19.5], [29.5, 59.5], [9.5, 59.5]])
    cover = truth.outline_coverage(square, (70, 40))
    assert cover.sum() == pytest.approx(20 * 40, rel=0.02) and (cover[20:60, 10:30] > 0.8).all()


@pytest.mark.parametrize("seed", [1, 4])
def test_truth_and_best_circles_have_no_error(seed):
    sample = make(seed)
    own = truth.compare(sample.vertices + np.array([0, 0, 50]), sample.faces, sample)
    assert own.iou == 1 and own.contour < 1e-9 and own.surface < 0.003 and abs(own.volume) < 1e-6
    circles = truth.compare(*truth.circular_sections(sample), sample)
    assert circles.iou > 0.998 and circles.surface < 0.02 and abs(circles.volume) < 0.3


@pytest.mark.parametrize("seed", [1, 4, 6])
def test_generalised_cylinder_measures_sweeps(seed):
    sample = make(seed)
    mesh = generalised_cylinder.reconstruct(sample.image, sample.clicks)
    assert mesh is not None and trimesh.Trimesh(*mesh, process=False).is_watertight
    errors = truth.compare(*mesh, sample)
    assert errors.iou > 0.99 and errors.surface < 0.06 and abs(errors.volume) < 1


def test_peers_say_so_where_there_is_nothing():
    noise = 0.5 + 0.02 * np.random.default_rng(0).standard_normal((200, 200))
    clicks = np.stack([np.linspace(50, 150, 5), np.full(5, 100.0)], 1)
    assert generalised_cylinder.reconstruct(noise, clicks) is None
    assert inflation.poisson(noise, clicks) is None and inflation.balls(noise, clicks) is None


def test_poisson_on_a_disc():
    """-laplace(u) = 2 inside radius R, 0 outside: u = (R^2 - r^2) / 2."""
    angle = np.linspace(0, 2 * np.pi, 600, endpoint=False)
    points, triangles, border = inflation._triangulated(50 + 40 * np.stack([np.cos(angle), np.sin(angle)], 1))
    u = inflation._solve_poisson(points, triangles, border, 2.0)
    np.testing.assert_allclose(u, (40**2 - ((points - 50) ** 2).sum(1)) / 2, atol=0.005 * 800)


def test_balls_in_a_disc_make_a_ball():
    y, x = np.mgrid[:120, :120]
    disc = np.clip(40.5 - np.hypot(x - 60, y - 60), 0, 1)
    clicks = np.stack([np.linspace(35, 85, 5), np.full(5, 60.0)], 1)
    mesh = inflation.balls(disc, clicks)
    assert mesh is not None and trimesh.Trimesh(*mesh, process=False).is_watertight
    # the medial axis lies on whole pixels
    assert truth.volume(*mesh) == pytest.approx(4 / 3 * np.pi * 40**3, rel=0.04)


@pytest.mark.parametrize(("method", "size", "worst"), [(contour_peer.plain, 128, 1.0), (contour_peer.helped, 256, 0.4)])
def test_active_contours_find_the_outline(method, size, worst):
    sample = make(11, size=size)
    errors = truth.compare_outline(method(sample.image, sample.clicks), sample)
    assert errors.contour < worst and errors.iou > 0.95 and np.isnan(errors.surface)


def test_table_tells_silent_failures_from_told_ones():
    good = truth.Errors(0.99, 0.1, 0.2, 0.3, 0.05, -0.4)
    bad = dataclasses.replace(good, iou=0.5)
    case = accuracy.Case(0)
    given = [(good, True), (good, False), (bad, True), (bad, False), (None, False)]
    line = accuracy.table([accuracy.Score("m", case, "bent", e, trusted, 1.0) for e, trusted in given])[0]
    assert line[:3] == ["m", "5", "0.7450"] and line[-4:] == ["1.00", "3", "1", "1"]


def test_unseen_seeds_were_not_tuned_with():
    unseen, tuning = ({*s.main, *s.varied, *s.mixed} for s in (accuracy.UNSEEN, accuracy.TUNING))
    assert max(tuning) < 100 <= min(unseen)
    kinds = [KINDS[s % len(KINDS)] for s in accuracy.UNSEEN.main]
    assert all(kinds.count(k) == 3 for k in KINDS)


@pytest.mark.parametrize("tubes", [1, 3])
def test_line_solvers_solve_the_same_step(tubes):
    """(1 + dt Kx)(M + dt Ks) D = r by dense matrices; the sparse one solves (M + dt (M Kx + Ks)) D = r instead."""
    step = line_solvers.Step(9, 8, tubes, w20=1e-3, w02=1e-5)
    around = np.eye(9) + step.dt * reference.ring_stiffness(np.zeros(9), np.full(9, step.w20))
    mass = np.diag(reference.end_mass(8))
    along = mass + step.dt * reference.open_stiffness(np.zeros(8), np.full(8, step.w02))
    right = lines.right_side(step)
    split = np.linalg.solve(np.kron(along, around), right.reshape(tubes, 72, 3))
    whole = np.linalg.solve(np.kron(along, np.eye(9)) + np.kron(mass, around - np.eye(9)), right.reshape(tubes, 72, 3))
    for kind in (*lines.PEERS.values(), None):
        v = right.copy()
        if kind is None:
            v = lines.ours(step)()
        elif kind is line_solvers.Interleaved:
            v = np.ascontiguousarray(v.transpose(2, 1, 3, 0))
            kind(step).solve(v)
            v = v.transpose(3, 1, 0, 2)
        else:
            kind(step).solve(v)
        expected = whole if kind is line_solvers.SparseFactors else split
        np.testing.assert_allclose(v.reshape(tubes, 72, 3), expected, atol=2e-6)


def test_a_free_mesh_starts_about_the_axis_and_gets_masks_by_area():
    made = views.ring(1, 3, perspective=True, kind="bent", size=200)
    vertices, faces = large_steps.ellipsoid(np.array([[0, 0, 0], [1, 1, 0], [4.0, 0, 0]]), 0.25)
    assert truth.volume(vertices, faces) == pytest.approx(np.pi / 6 * 4 * 1 * 1, rel=0.01)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [4, 1, 1], rtol=0.01)
    small = large_steps.reduced(made.coverages[0])
    assert small.shape == (large_steps.SIZE, large_steps.SIZE) and 0 <= small.min() and small.max() <= 1 + 1e-6
    assert small.mean() == pytest.approx(made.coverages[0].mean(), rel=1e-5)
    centre = np.indices(small.shape)[1][small > 0.5].mean() * 200 / large_steps.SIZE
    assert centre == pytest.approx(np.indices((200, 200))[1][made.coverages[0] > 0.5].mean(), abs=1.0)
    widest = large_steps.thickness(made, made.spine)
    assert 0.15 < widest < 0.5
