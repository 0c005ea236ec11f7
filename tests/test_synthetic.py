"""The generator of images with known truth, and its rasteriser, against closed forms."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import Delaunay

from symseek.scenes import raster, shapes, synthetic
from symseek.scenes.synthetic import KINDS, make


@pytest.fixture(scope="module")
def samples():
    """One of each kind, without noise."""
    return {s.kind: s for s in (make(seed, size=256, noise=0.0) for seed in range(len(KINDS)))}


def test_a_run_of_seeds_holds_every_kind(samples):
    assert set(samples) == set(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_mesh_is_a_closed_solid_inside_the_picture(samples, kind):
    s = samples[kind]
    mesh = trimesh.Trimesh(s.vertices, s.faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(s.volume, rel=1e-9) and s.volume > 0
    assert s.vertices[:, :2].min() >= synthetic.MARGIN * 256 - 0.5
    assert s.vertices[:, :2].max() <= (1 - synthetic.MARGIN) * 256 - 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_volume_is_that_of_pappus(samples, kind):
    """Circles about their own centres: V = integral of pi r^2 ds, however the axis bends."""
    s = samples[kind]
    solid = shapes.sweep(kind, np.random.default_rng([s.seed, 0]))
    exact = np.pi * np.trapezoid(solid.radius**2, solid.station) * s.length**3
    polygons = np.sin(2 * np.pi / 192) / (2 * np.pi / 192)  # 192-gons for circles
    # 256 rings hold the profile's curves to about 1e-4
    assert s.volume == pytest.approx(exact * polygons, rel=3e-4)


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "tilted"])
def test_silhouette_is_what_the_circles_span(samples, kind):
    """With the axis in the image plane the outline is axis +- radius; folds or overlaps cost area."""
    s = samples[kind]
    solid = shapes.sweep(kind, np.random.default_rng([s.seed, 0]))
    u = np.linspace(0, 1, len(solid.axis))
    centre, slope = (
        np.stack([np.interp(solid.station, u, c) for c in of.T], 1)
        for of in (solid.axis, np.gradient(solid.axis, u, axis=0))
    )
    across = np.stack([-slope[:, 1], slope[:, 0]], 1) * solid.radius[:, None]
    x, y = np.concatenate([centre + across, (centre - across)[::-1]]).T * s.length
    area = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    assert s.coverage.sum() == pytest.approx(area, rel=2e-3)


def test_axis_has_even_steps_and_its_length(samples):
    for s in samples.values():
        steps = np.linalg.norm(np.diff(s.spine, axis=0), axis=1)
        assert steps.sum() == pytest.approx(s.length, rel=1e-4)
        np.testing.assert_allclose(steps, steps.mean(), rtol=1e-3)
        assert s.spine[:, 2].mean() == pytest.approx(0, abs=1e-9)


def test_tilted_axis_leaves_the_image_plane_by_the_angle_asked_for():
    s = make(2, tilt=20.0, size=128)
    chord = s.spine[-1] - s.spine[0]
    assert abs(chord[2]) / np.linalg.norm(chord) == pytest.approx(np.sin(np.radians(20)), rel=1e-6)


def test_size_only_scales_the_scene():
    small, large = make(1, size=128), make(1, size=256)
    corner = np.array([-0.5, -0.5, 0])
    np.testing.assert_allclose(2 * (small.vertices - corner), large.vertices - corner, rtol=0, atol=1e-9)
    np.testing.assert_allclose(2 * (small.clicks + 0.5), large.clicks + 0.5, atol=1e-9)


def test_same_seed_same_image_and_noise_is_as_asked():
    a, b = make(3, size=128, noise=0.02), make(3, size=128, noise=0.02)
    assert (a.image == b.image).all()
    assert not (a.image == make(14, size=128, noise=0.02).image).all()
    clean = make(3, size=128, noise=0.0, contrast="dark").image
    noisy = make(3, size=128, noise=0.02, contrast="dark").image
    assert (noisy - clean).std() == pytest.approx(0.02, rel=0.03)  # 1 / sqrt(2 * 128^2) = 0.6 %


@pytest.mark.parametrize(("contrast", "sign"), [("bright", 1), ("dark", -1)])
@pytest.mark.parametrize("colour", [False, True])
def test_contrast_and_colour(contrast, sign, colour):
    s = make(0, size=128, contrast=contrast, colour=colour)
    assert s.image.shape == ((128, 128, 3) if colour else (128, 128)) and s.image.dtype == np.float32
    assert sign * (s.image[s.mask].mean() - s.image[~s.mask].mean()) > 0.2


def test_clicks_err_by_the_given_amount():
    off = [make(s, size=64).clicks - make(s, size=64, click_error=0.0).clicks for s in range(4)]
    assert np.std(off) == pytest.approx(4.0 * 64 / 512, rel=0.35)  # 40 numbers: 11 %


def test_sections_out_of_round_keep_the_amplitude():
    solid = shapes.sweep("bent", np.random.default_rng(0))
    round_, _ = shapes.mesh(solid, 64, 65)
    other, _ = shapes.mesh(solid, 64, 65, 0.05, np.random.default_rng(1))
    centre = round_[1:-1].reshape(63, 64, 3).mean(1, keepdims=True)
    r, q = (np.linalg.norm(v[1:-1].reshape(63, 64, 3) - centre, axis=2) for v in (round_, other))
    share = np.abs(np.fft.rfft(q / r, axis=1)) / 32
    assert share[:, [2, 3]].max() <= 0.05 + 1e-9 and share[:, [2, 3]].min() >= 0.02 - 1e-9
    assert np.delete(share[:, 1:], [1, 2], axis=1).max() < 1e-9  # no other harmonics


def test_unknown_words_are_named():
    with pytest.raises(ValueError, match=r"'cube'.*bent, squash"):
        make(0, kind="cube")
    with pytest.raises(ValueError, match="'grey'"):
        make(0, contrast="grey")  # pyright: ignore[reportArgumentType]


def _sphere(radius, centre=(0.0, 0.0, 0.0)):
    ball = trimesh.creation.icosphere(5, radius)
    return np.asarray(ball.vertices) + centre, np.asarray(ball.faces)


def test_shading_of_a_sphere_is_lamberts():
    vertices, faces = _sphere(50.0, (63.2, 61.9, 7.0))
    light = np.array([0.3, -0.4, -0.9])
    shade, cover = synthetic.render(vertices, faces, (128, 128), light, ambient=0.4)
    y, x = np.mgrid[:128, :128]
    n = np.stack([x - 63.2, y - 61.9], -1) / 50
    inside = np.hypot(*n.transpose(2, 0, 1)) < 0.95
    nz = -np.sqrt(np.clip(1 - (n**2).sum(-1), 0, 1))
    lambert = np.clip(np.concatenate([n, nz[..., None]], -1) @ (light / np.linalg.norm(light)), 0, None)
    np.testing.assert_allclose(shade[inside], (0.4 + 0.6 * lambert)[inside], atol=4e-3)
    assert (cover[inside] == 1).all()


def test_coverage_of_a_disc_and_cut_off_at_the_border():
    angle = np.linspace(0, 2 * np.pi, 721)[:-1]
    disc = np.concatenate([[[20.3, 30.7]], [20.3, 30.7] + 15.4 * np.stack([np.cos(angle), np.sin(angle)], 1)])
    k = np.arange(720)
    faces = np.stack([np.zeros(720, int), 1 + k, 1 + (k + 1) % 720], 1)
    cover = raster.coverage(disc, faces, (64, 48))
    assert cover.sum() == pytest.approx(np.pi * 15.4**2, rel=1e-3)
    row, column = np.mgrid[:64, :48]
    assert (cover * column).sum() / cover.sum() == pytest.approx(20.3, abs=0.01)
    assert (cover * row).sum() / cover.sum() == pytest.approx(30.7, abs=0.01)
    half = raster.coverage(disc - [20.8, 0], faces, (64, 48))  # the centre on the left border, at -0.5
    assert half.sum() == pytest.approx(np.pi * 15.4**2 / 2, rel=5e-3)
    assert raster.coverage(disc + 100, faces, (64, 48)).sum() == 0


def test_neighbouring_triangles_neither_overlap_nor_leave_gaps():
    points = np.random.default_rng(0).uniform(-3, 35, (60, 2))
    faces = Delaunay(points).simplices
    each = sum(raster.coverage(points, faces[k : k + 1], (32, 32), 4) for k in range(len(faces)))
    np.testing.assert_allclose(each, raster.coverage(points, faces, (32, 32), 4), atol=1e-6)


def test_the_nearer_face_is_seen():
    points = np.array([[0, 0], [9, 0], [0, 9], [0, 0], [9, 0], [0, 9.0]])
    faces, depth = np.array([[0, 1, 2], [3, 4, 5]]), np.array([5.0, 5, 5, 2, 2, 2])
    seen = raster.visible(points, depth, faces[::-1], (10, 10), 2)
    assert set(np.unique(seen)) == {-1, 0}
    row, column, face, weight = raster.barycentric(points, faces[::-1], seen, 2)
    back = np.einsum("kc,kcd->kd", weight, points[faces[::-1][face]])
    np.testing.assert_allclose(back, (np.stack([column, row], 1) + 0.5) / 2 - 0.5, atol=1e-9)


def test_squash_scene_is_what_the_generator_writes(tmp_path):
    synthetic.write_squash(tmp_path)
    folder = Path(synthetic.__file__).parent / "squash"
    new, kept = np.load(tmp_path / "truth.npz"), np.load(folder / "truth.npz")
    for name in kept:
        np.testing.assert_allclose(new[name], kept[name], rtol=1e-5, atol=1e-3)
    pictures = [np.asarray(Image.open(p / "squash.jpg"), float) for p in (tmp_path, folder)]
    assert np.abs(pictures[0] - pictures[1]).mean() < 1.0
    cover = raster.coverage(kept["vertices"][:, :2], kept["faces"].astype(int), pictures[1].shape[:2])
    assert pictures[1][cover == 1].mean(0)[0] > 2 * pictures[1][cover == 0].mean(0)[0]  # yellow on blue
