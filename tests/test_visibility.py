"""Depth passes against exact rays, what hides what, and what that makes of a potential."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from symseek.device import start_quietly
from symseek.render.visibility import DepthPass
from symseek.scenes import raster, shapes
from symseek.scenes.synthetic import vertex_normals
from symseek.sim.camera import Camera
from symseek.sim.foreground import Foreground
from symseek.sim.hidden import Hidden, clear_of
from symseek.sim.potential import Potential
from symseek.sim.visibility import Visibility, _grid_faces, cast_rays, hidden_by_depth, hidden_by_rays, note_others, seen

SIZE = 512
CAMERAS = {
    "orthographic": Camera.orthographic(),
    "stereo": Camera.stereo(-0.3),
    "perspective": Camera.perspective(
        np.array([[900.0, 0, 256], [0, 900, 256], [0, 0, 1]]), np.eye(3), np.array([-256.0, -256, 900])
    ),
}


@pytest.fixture(scope="module")
def draw():
    start_quietly()
    with DepthPass() as depth_pass:
        yield depth_pass


def solids() -> list[tuple[np.ndarray, np.ndarray]]:
    """A pear behind an egg, some 260 px long."""
    out = []
    for kind, angle, place in (("egg", 0.4, (300.0, 300.0, -90.0)), ("pear", 1.9, (230.0, 230.0, 80.0))):
        vertices, faces = shapes.mesh(shapes.sweep(kind, np.random.default_rng(3)), around=48, along=48)
        c, s = np.cos(angle), np.sin(angle)
        vertices = vertices @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T
        out.append((260 * (vertices - vertices.mean(0)) + place, faces))
    return out


def exact(camera: Camera, vertices: np.ndarray, faces: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Depth along the line of sight's axis where the ray of each pixel (n, 2) first meets a face; infinite for none.

    In float64 by Moeller and Trumbore, in the world: nothing is projected.
    """
    m = camera.matrix
    if camera.affine:
        way = np.broadcast_to(camera.sight(np.zeros(3)), (len(pixels), 3))
        sides = np.stack([m[0, :3], m[1, :3], way[0]])
        heights = np.column_stack([pixels - m[:2, 3], np.full(len(pixels), -5000.0)])
        start = np.linalg.solve(sides, heights.T).T
    else:
        start = np.broadcast_to(-np.linalg.solve(m[:, :3], m[:, 3]), (len(pixels), 3))
        way = np.linalg.solve(m[:, :3], np.column_stack([pixels, np.ones(len(pixels))]).T).T
        way = way / (way @ np.array([0, 0, 1.0]))[:, None]
    nearest = np.full(len(pixels), np.inf)
    for a, b, c in vertices[faces]:
        p = np.cross(way, c - a)
        det = p @ (b - a)
        safe = np.where(np.abs(det) < 1e-12, 1.0, det)
        u = ((start - a) * p).sum(1) / safe
        q = np.cross(start - a, b - a)
        v, t = (way * q).sum(1) / safe, (q @ (c - a)) / safe
        hit = (np.abs(det) > 1e-12) & (u >= 0) & (v >= 0) & (u + v <= 1)
        nearest = np.where(hit & (t < nearest), t, nearest)
    at = start + np.where(np.isfinite(nearest), nearest, 0)[:, None] * way
    depth = camera.distance(at) if camera.affine else -1 / np.maximum(at[:, 2] + 900, 1e-9)
    return np.where(np.isfinite(nearest), depth, np.inf)


@pytest.mark.parametrize("name", CAMERAS)
def test_depth_pass_against_exact_rays(draw, name):
    """Mask equal but for the outline's last half pixel, depth to 1e-5 of its range, owners equal: all by both ways."""
    camera = CAMERAS[name]
    meshes = [(seen(camera, vertices), faces) for vertices, faces in solids()]
    passes = {"depth": draw(meshes, (SIZE, SIZE)), "rays": cast_rays(meshes, (SIZE, SIZE))}
    rng = np.random.default_rng(0)
    mask = np.isfinite(passes["rays"][0])
    rows, columns = np.nonzero(mask)
    pick = rng.choice(len(rows), 400)
    pixels = np.stack([columns[pick], rows[pick]], axis=1)
    around = rng.integers(0, SIZE, (200, 2))
    pixels = np.concatenate([pixels, around]).astype(float)
    alone = np.stack([exact(camera, *mesh, pixels) for mesh in solids()])
    true, owner = alone.min(axis=0), np.where(np.isfinite(alone.min(axis=0)), alone.argmin(axis=0), -1)
    column, row = pixels.astype(int).T
    spread = np.ptp(true[np.isfinite(true)])
    for depth, found in passes.values():
        # a pixel from an outline, where front and back of a surface are far apart, ways may differ
        calm = np.all([found[np.clip(row + i, 0, 511), np.clip(column + j, 0, 511)] == found[row, column]
                       for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)  # fmt: skip
        np.testing.assert_array_equal(found[row, column][calm], owner[calm])
        np.testing.assert_array_equal(np.isfinite(depth[row, column][calm]), np.isfinite(true[calm]))
        hit = calm & np.isfinite(true)
        assert hit.sum() > 250
        np.testing.assert_allclose(depth[row, column][hit], true[hit], atol=1e-5 * spread)


@pytest.mark.parametrize("name", CAMERAS)
def test_nodes_hidden_by_either_way(draw, name):
    """Of nodes that face the viewer, by the depth buffer and by a ray from each: half a percent apart, at edges only."""
    camera, both = CAMERAS[name], solids()
    meshes = [(seen(camera, vertices), faces) for vertices, faces in both]
    facing = np.concatenate([(vertex_normals(v, f) * camera.sight(v)).sum(axis=1) < 0 for v, f in both])
    points = np.concatenate([vertices for vertices, _ in meshes])
    margin = 0.04 * np.ptp(points[:, 2])
    depth, _ = draw(meshes, (SIZE, SIZE))
    by_depth, by_rays = hidden_by_depth(points, depth, margin), hidden_by_rays(points, meshes, margin)
    assert 0.03 < by_rays[facing].mean() < 0.3 and by_rays[~facing].mean() > 0.7
    apart = (by_depth != by_rays) & facing
    assert apart.sum() <= 0.005 * facing.sum()
    for column, row, _ in points[apart]:
        near = depth[int(row) - 1 : int(row) + 3, int(column) - 1 : int(column) + 3]
        assert np.any(~np.isfinite(near)) or np.ptp(near) > margin  # a jump or a steep side within a pixel


@pytest.mark.parametrize("name", CAMERAS)
def test_depth_pass_over_the_whole_picture(draw, name):
    """Against a rasteriser in float64: the same owner but within half a pixel of an outline, depth to 1e-5 of its range."""
    camera = CAMERAS[name]
    meshes = [(seen(camera, vertices), faces) for vertices, faces in solids()]

    def true(shift: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        depth, owner = np.full((SIZE, SIZE), np.inf), np.full((SIZE, SIZE), -1)
        for number, (vertices, faces) in enumerate(meshes):
            points = vertices[:, :2] + shift
            a, b, c = np.moveaxis(points[faces], 1, 0)
            front = faces[(b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0]
            face = raster.visible(points, vertices[:, 2], front, (SIZE, SIZE), 1)
            row, column, chosen, weight = raster.barycentric(points, front, face, 1)
            own = (vertices[front[chosen], 2] * weight).sum(axis=1)
            nearer = own < depth[row, column]
            depth[row[nearer], column[nearer]], owner[row[nearer], column[nearer]] = own[nearer], number
        return depth, owner

    depth, owner = true((0.0, 0.0))
    band = np.zeros(owner.shape, bool)
    for angle in np.arange(8) * np.pi / 4:
        band |= true((0.5 * np.cos(angle), 0.5 * np.sin(angle)))[1] != owner
    assert 0.1 < (owner >= 0).mean() < 0.9 and (owner == 0).any() and (owner == 1).any() and band.mean() < 0.02
    spread = np.ptp(depth[owner >= 0])
    for found, whose in (draw(meshes, (SIZE, SIZE)), cast_rays(meshes, (SIZE, SIZE))):
        np.testing.assert_array_equal(whose[~band], owner[~band])
        same = ~band & (owner >= 0)
        np.testing.assert_allclose(found[same], depth[same], atol=1e-5 * spread)


def memory() -> int:
    """Resident bytes of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_depth_passes_do_not_fill_the_memory(draw):
    meshes = [(seen(CAMERAS["orthographic"], vertices), faces) for vertices, faces in solids()]
    for _ in range(10):
        draw(meshes, (SIZE, SIZE))
    before = memory()
    for _ in range(100):
        draw(meshes, (SIZE, SIZE))
    assert memory() - before < 10e6


def tube(line: np.ndarray, radius: float, nx: int = 12) -> np.ndarray:
    """Circles across X or Y about a line in the image plane, shape (nx, n, 3)."""
    tangent = np.gradient(line[:, :2], axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0], np.zeros(len(line))])
    angle = 2 * np.pi * np.arange(nx) / nx
    return line + radius * (np.cos(angle)[:, None, None] * normal + np.sin(angle)[:, None, None] * np.array([0.0, 0, 1]))


class Scene:
    """What `Visibility` asks of an assembly."""

    def __init__(self, nodes: np.ndarray, eye: Camera | None = None):
        class View:
            camera, image, ignore = eye or Camera.orthographic(), np.zeros((200, 200)), None

        self.views, self.tubes, self.nodes = [View()], [None], nodes
        self.own_views = [self.views]
        self.hidden: list[list[Hidden | None]] = [[None]]
        self.meetings = [[np.zeros((0, 2))]]

    def world(self, k: int):
        return self.nodes, self.nodes.mean(axis=0)


def refresh(visibility: Visibility, scenes: list[Any]) -> list[bool | None]:
    return visibility.refresh(scenes)


def upright(column: float, depth: float) -> Scene:
    return Scene(tube(np.column_stack([np.full(9, column), np.linspace(20, 180, 9), np.full(9, depth)]), 15.0))


def level(row: float, depth: float) -> Scene:
    return Scene(tube(np.column_stack([np.linspace(20, 180, 9), np.full(9, row), np.full(9, depth)]), 15.0))


@pytest.mark.parametrize("way", ["depth", "rays"])
def test_who_hides_whom(draw, way):
    """By the depth of the spines, though the tubes run through each other; only where both are; equal depths hide none."""
    visibility = Visibility(draw if way == "depth" else None)
    front, back = upright(100, 0.0), level(80, 5.0)
    assert refresh(visibility, [front, back]) == [False, True]  # where outlines meet is taken in and not told
    assert front.hidden[0][0] is None
    off, corner = KDTree([(85, 65), (85, 95), (115, 65), (115, 95)]).query(front.meetings[0][0])
    assert off.max() < 2.5 and np.unique(corner).tolist() == [0, 1, 2, 3] and not len(back.meetings[0][0])
    hidden = back.hidden[0][0]
    assert hidden is not None
    rows, columns = np.mgrid[:200, :200]
    mask = hidden.at(np.stack([columns, rows], axis=-1))
    crossing = (np.abs(columns - 100) <= 13) & (np.abs(rows - 80) <= 13)
    assert mask[crossing].all() and not mask[(np.abs(columns - 100) > 16) | (np.abs(rows - 80) > 18)].any()
    assert refresh(visibility, [front, back]) == [None, None]
    back.nodes = back.nodes + np.array([0, 40.0, 0])
    assert refresh(visibility, [front, back]) == [False, True]
    back.nodes = back.nodes - np.array([0, 0, 5.0])
    assert refresh(visibility, [front, back]) == [False, True]
    assert not len(front.meetings[0][0]) and back.hidden[0][0] is None and front.hidden[0][0] is None


@pytest.mark.parametrize("unit", [1.0, 0.01])
@pytest.mark.parametrize("affine", [True, False])
def test_who_hides_whom_in_any_units(affine, unit):
    """Tubes in world units of any size, seen along the axis or from nearby: the same as in pixels."""
    if affine:
        camera = Camera(np.array([[1 / unit, 0, 0, 0], [0, 1 / unit, 0, 0], [0, 0, 0, 1.0]]))
    else:
        k = np.array([[300.0, 0, 100], [0, 300, 100], [0, 0, 1]])
        camera = Camera.perspective(k, np.eye(3), unit * np.array([-100.0, -100, 300]))
    front, back = (Scene(unit * scene.nodes, camera) for scene in (upright(100, 0.0), level(80, 5.0)))
    assert refresh(Visibility(None), [front, back]) == [False, True]
    assert KDTree([(85, 65), (85, 95), (115, 65), (115, 95)]).query(front.meetings[0][0])[0].max() < 2.5
    hidden = back.hidden[0][0]
    assert hidden is not None and front.hidden[0][0] is None
    assert hidden.at(np.array([100, 80])) and hidden.mask.sum() == pytest.approx(30 * 35, rel=0.1)
    back.nodes = back.nodes - unit * np.array([0, 0, 4.999])
    assert refresh(Visibility(None), [front, back]) == [False, True]
    assert back.hidden[0][0] is None


def test_what_stands_still_is_not_drawn_again():
    """Two crossings far apart: one moves, then so much that it meets the other."""
    drawn: list[int] = []

    def counted(meshes, shape):
        drawn.append(len(meshes))
        return cast_rays(meshes, shape)

    visibility = Visibility(counted)
    scenes: list[Any] = [upright(30, 0.0), level(40, 5.0), upright(150, 0.0), level(160, 5.0)]
    for scene, (low, high) in zip(scenes, [(20, 60), (10, 50), (140, 180), (130, 170)], strict=True):
        axis = 1 if np.ptp(scene.nodes[..., 1]) > np.ptp(scene.nodes[..., 0]) else 0
        scene.nodes = scene.nodes.copy()
        scene.nodes[..., axis] = np.interp(scene.nodes[..., axis], (20, 180), (low, high))
    assert refresh(visibility, scenes) == [False, True, False, True] and drawn == [2, 2]
    assert refresh(visibility, scenes) == [None] * 4 and drawn == [2, 2]
    scenes[0].nodes = scenes[0].nodes + np.array([3.0, 0, 0])
    assert refresh(visibility, scenes) == [False, True, None, None] and drawn == [2, 2, 2]
    scenes[0].nodes = scenes[0].nodes + np.array([106.0, 0, 0])
    scenes[0].nodes[..., 1] += 100
    assert refresh(visibility, scenes) == [False, True, False, True] and drawn == [2, 2, 2, 3]
    assert scenes[1].hidden[0][0] is None


def test_nothing_is_drawn_where_nothing_meets():
    def refused(meshes, shape):
        raise AssertionError("drawn for nothing")

    visibility = Visibility(refused)
    assert refresh(visibility, [upright(40, 0.0), upright(120, 3.0)]) == [None, None]


def test_what_changes_little_is_taken_in_and_not_told():
    """A back that drifts by a third of a per cent of what is hidden a look."""
    visibility = Visibility(None)
    front, back = upright(100, 0.0), level(80, 5.0)
    refresh(visibility, [front, back])
    told = []
    for _ in range(20):
        back.nodes = back.nodes + np.array([0, 0.1, 0])
        told.append(bool(refresh(visibility, [front, back])[1]))
    assert sum(told) < 5  # those where the mask of whole pixels has gone on by a row
    hidden = back.hidden[0][0]
    assert hidden is not None
    row = np.argwhere(hidden.mask.any(axis=1))[:, 0].mean() + hidden.corner[1]
    assert abs(row - 82) < 0.6


def test_where_outlines_meet_comes_to_rest():
    """A back that goes to and fro by 4 px: what it makes of the front is taken in, less and less often."""
    visibility = Visibility(None)
    front, back = upright(100, 0.0), level(80, 5.0)
    told, places = [], []
    for look in range(40):
        back.nodes = back.nodes + np.array([0, 4.0 if look % 2 else -4.0, 0])
        told.append(refresh(visibility, [front, back])[0])
        places.append(front.meetings[0][0])
    assert told[:3] == [False] * 3 and not any(t is not None for t in told[-20:])
    assert not np.array_equal(places[0], places[1]) and all(np.array_equal(p, places[-1]) for p in places[-20:])


def test_near_what_is_hidden():
    """Within a blur of a hidden pixel's centre, by a search among all of them; of points anywhere about the mask."""
    rng = np.random.default_rng(4)
    for blur in (0.7, 1.0, 2.5, 6.0):
        mask = rng.random((20, 30)) < 0.02
        mask[3, 4] = True
        hidden = Hidden(mask, (-5, 7))
        points = np.rint(rng.uniform(-15, 40, (60, 2)))
        away = KDTree(np.argwhere(mask)[:, ::-1] + [-5, 7]).query(points)[0]
        np.testing.assert_array_equal(hidden.near(points, blur), away <= blur)
        assert not Hidden(mask & False, (0, 0)).near(points, blur).any()


def test_where_others_lie():
    """Within its map's crop: whatever its depth, and not where it lies alone."""
    scenes: list[Any] = [upright(100, 0.0), level(80, 5.0), upright(20, 0.0)]
    for scene in scenes:
        map_ = Foreground(np.zeros((90, 50), np.float32), 2.0, (60.0, 10.0), 100.0, 10.0, np.zeros((2, 2)))
        scene.maps, scene.others = [[map_]], [[None]]
    note_others(scenes)
    rows, columns = np.mgrid[:200, :200]
    at, on = np.stack([columns, rows], axis=-1), []
    for scene in scenes:
        found = scene.others[0][0]
        on.append(np.zeros(rows.shape, bool) if found is None else found.at(at))
    crop = (columns >= 60) & (columns <= 160) & (rows >= 10) & (rows <= 190)
    inside, outside = np.abs(rows - 80) <= 13, np.abs(rows - 80) > 16
    assert on[0][inside & crop].all() and not on[0][outside | ~crop].any()
    inside, outside = (np.abs(columns - 100) <= 13) & (np.abs(rows - 100) < 75), np.abs(columns - 100) > 16
    assert on[1][inside & crop].all() and not on[1][outside | ~crop].any()


def test_before_itself():
    """A loop: hidden where it crosses, and nowhere else."""
    t = np.linspace(0, 2 * np.pi * 0.9, 40) + 0.8
    line = np.column_stack([100 + 60 * np.sin(t), 100 + 45 * np.sin(2 * t), 10 * np.cos(t)])
    scene = Scene(tube(line, 8.0))
    assert refresh(Visibility(None), [scene]) == [True]
    hidden = scene.hidden[0][0]
    assert hidden is not None and hidden.at(np.array([100.0, 100.0]))
    rows, columns = np.mgrid[:200, :200]
    mask = hidden.at(np.stack([columns, rows], axis=-1))
    assert not mask[np.hypot(columns - 100, rows - 100) > 25].any()
    assert refresh(Visibility(None), [upright(100, 0.0)]) == [None]


def test_beta_of_a_half_plane():
    """0 on what is hidden and a blur further, 1 from two blurs on, even between; nothing beyond the mask is hidden."""
    mask = np.zeros((40, 60), bool)
    mask[:, :20] = True
    hidden = Hidden(mask, (10, 5))
    sigma, step = 3.0, 0.5
    potential = Potential(sigma, np.ones((60, 120, 4), np.float32), np.zeros((60, 120)), step, (10.0, 10.0))
    beta = hidden.beta(potential)[30]
    column = 10 + step * np.arange(120)
    blur = np.hypot(sigma, step)
    expected = np.clip((column - 29.0) / blur - 1, 0, 1)
    np.testing.assert_allclose(beta, np.where(column < 29.0, 0, expected), atol=0.51 * step / blur)
    assert hidden.near(np.array([[29 + 0.9 * sigma, 20.0]]), sigma) and not hidden.near(
        np.array([[29 + 1.5 * sigma, 20.0]]), sigma
    )
    assert not hidden.at(np.array([[0.0, 0.0], [9.0, 20.0], [15.0, 300.0]])).any()


def test_no_edge_counts_where_outlines_meet():
    """Nothing within two blurs, all from four on; the push on poles stays, and all where the map alone leads."""
    potential = Potential(3.0, np.ones((60, 120, 4), np.float32), np.zeros((60, 120)), 0.5, (10.0, 10.0))
    map_ = Foreground(np.zeros((9, 9), np.float32), 1.0, (0.0, 0.0), 100.0, 40.0, np.zeros((2, 2)))
    met = np.array([[30.0, 20.0], [32.0, 20.0], [-500.0, 3.0]])
    rows, columns = np.mgrid[10:40:0.5, 10:70:0.5]
    off = KDTree(met).query(np.stack([columns, rows], axis=-1))[0]
    expected = np.clip(off / np.hypot(3.0, 0.5) / 2 - 1, 0, 1)
    clear = clear_of(met, potential, map_)
    np.testing.assert_allclose(clear[..., :3], expected[..., None].repeat(3, axis=-1), atol=1e-6)
    assert (clear[..., 3] == 1).all()
    assert (clear_of(met, potential, replace(map_, half_width=10.0)) == 1).all()
    assert (clear_of(met[2:], potential, map_) == 1).all()


def test_grid_faces_close_the_ring():
    faces = _grid_faces(5, 3)
    assert len(faces) == 5 * 2 * 2 and sorted(np.unique(faces)) == list(range(15))
