"""Comparing a mesh with a known solid: silhouette, contour, surface and volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from skimage.draw import polygon2mask
from skimage.measure import find_contours

from symseek.scenes import raster, shapes
from symseek.scenes.synthetic import Sample
from symseek.sim.camera import Camera

SAMPLES = 8
"""Points a side of a pixel for silhouettes."""


@dataclass(frozen=True)
class Errors:
    """How far a mesh is from the truth."""

    iou: float
    """intersection over union of the silhouettes."""
    contour: float
    """mean distance between the silhouettes' outlines [px]."""
    contour_p95: float
    contour_max: float
    surface: float
    """mean distance between the surfaces [% of the axis' length], Z translation removed."""
    volume: float
    """signed, (mesh - truth) / truth [%]."""


def compare(vertices: np.ndarray, faces: np.ndarray, sample: Sample) -> Errors:
    """All errors of a mesh (V, 3), (F, 3) in the world of a synthetic sample."""
    outline = silhouette(vertices, faces, sample.camera, sample.coverage.shape)
    mean, p95, largest = outline_error(outline, sample.coverage)
    return Errors(
        iou=overlap(outline, sample.coverage),
        contour=mean,
        contour_p95=p95,
        contour_max=largest,
        surface=surface_error(vertices, faces, sample.vertices, sample.faces, sample.length),
        volume=volume_error(vertices, faces, sample.volume),
    )


def silhouette(vertices: np.ndarray, faces: np.ndarray, camera: Camera, shape: tuple[int, ...]) -> np.ndarray:
    """Share of each pixel that a mesh covers, float32 (H, W), by 8 x 8 points a pixel."""
    height, width = shape[:2]
    return raster.coverage(camera.project(vertices), faces, (height, width), SAMPLES)


def outline_coverage(outline: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Share of each pixel inside a closed line (n, 2) of (column, row), by 8 x 8 points a pixel."""
    height, width = shape[:2]
    fine = polygon2mask((height * SAMPLES, width * SAMPLES), (outline[:, ::-1] + 0.5) * SAMPLES - 0.5)
    return fine.reshape(height, SAMPLES, width, SAMPLES).mean((1, 3), dtype=np.float32)


def compare_outline(outline: np.ndarray, sample: Sample) -> Errors:
    """Errors of a closed line (n, 2); surface and volume are nan."""
    inside = outline_coverage(outline, sample.coverage.shape)
    mean, p95, largest = outline_error(inside, sample.coverage)
    return Errors(
        iou=overlap(inside, sample.coverage),
        contour=mean,
        contour_p95=p95,
        contour_max=largest,
        surface=float("nan"),
        volume=float("nan"),
    )


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two coverages or masks (H, W); 0 where both are empty."""
    union = np.maximum(a, b).sum()
    return float(np.minimum(a, b).sum() / union) if union > 0 else 0.0


def silhouette_iou(vertices: np.ndarray, faces: np.ndarray, camera: Camera, truth: np.ndarray) -> float:
    """Intersection over union of a mesh's silhouette and a coverage or mask (H, W)."""
    return overlap(silhouette(vertices, faces, camera, truth.shape), truth)


def contour_error(
    vertices: np.ndarray,
    faces: np.ndarray,
    camera: Camera,
    truth: np.ndarray,
) -> tuple[float, float, float]:
    """`outline_error` of a mesh's silhouette against a coverage (H, W)."""
    return outline_error(silhouette(vertices, faces, camera, truth.shape), truth)


def outline_error(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Mean, 95 % and largest distance [px] between the 0.5 iso-lines of two coverages (H, W), both ways.

    The mean is that of the two directions' means. Infinite where either has no outline.
    """
    first, second = outline_segments(a), outline_segments(b)
    if not (len(first) and len(second)):
        return np.inf, np.inf, np.inf
    there, back = to_segments(first.mean(1), second), to_segments(second.mean(1), first)
    both = np.concatenate([there, back])
    return float(there.mean() + back.mean()) / 2, float(np.quantile(both, 0.95)), float(both.max())


def surface_error(
    vertices: np.ndarray,
    faces: np.ndarray,
    true_vertices: np.ndarray,
    true_faces: np.ndarray,
    length: float,
    count: int = 8000,
) -> float:
    """Mean distance between two surfaces, both ways, in % of `length`.

    One orthographic view fixes no depth: both are first shifted along Z to mean depth 0. `count` points
    spread evenly over either surface are compared with the other's triangles.
    """
    a, b = _centred(vertices, faces), _centred(true_vertices, true_faces)
    there = _to_surface(_spread(a, count)[0], b)
    back = _to_surface(_spread(b, count)[0], a)
    return float(50 * (there.mean() + back.mean()) / length)


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume inside a watertight mesh with outward normals."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def volume_error(vertices: np.ndarray, faces: np.ndarray, truth: float) -> float:
    """Signed error of the mesh's volume in % of the true one."""
    return 100 * (volume(vertices, faces) / truth - 1)


def circular_sections(sample: Sample, around: int = 96, along: int = 161) -> tuple[np.ndarray, np.ndarray]:
    """The best that circles can do for a sample whose axis lies in the image plane: vertices, faces.

    Circles around points of the true axis, half as wide as the true silhouette is across the axis there.
    """
    s = (1 - np.cos(np.linspace(0, np.pi, along))) / 2
    at = s * (len(sample.spine) - 1)
    axis = sample.spine[:, :2]
    slope = np.gradient(axis, axis=0, edge_order=2)
    index = np.arange(len(axis))
    centre, tangent = (np.stack([np.interp(at, index, c) for c in of.T], 1) for of in (axis, slope))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    outline = outline_segments(sample.coverage)
    half = np.zeros(along)
    for k in range(1, along - 1):
        half[k] = _half_width(centre[k], tangent[k], outline)
    return shapes.tube(centre, tangent, np.repeat(half[:, None], around, axis=1))


def _half_width(centre: np.ndarray, tangent: np.ndarray, outline: np.ndarray) -> float:
    """Half the distance between the nearest crossings of the outline on both sides of a point, across."""
    relative = outline - centre
    along, across = relative @ tangent, relative @ np.array([-tangent[1], tangent[0]])
    crossing = (along[:, 0] < 0) != (along[:, 1] < 0)
    t = along[crossing, 0] / (along[crossing, 0] - along[crossing, 1])
    where = across[crossing, 0] + t * (across[crossing, 1] - across[crossing, 0])
    right, left = where[where > 0], where[where <= 0]
    return (right.min() - left.max()) / 2 if len(right) and len(left) else 0.0


def outline_segments(coverage: np.ndarray) -> np.ndarray:
    """Segments (n, 2, 2) of the 0.5 iso-lines, (column, row)."""
    lines = find_contours(np.pad(coverage, 1).astype(float), 0.5)
    pieces = [np.stack([line[:-1], line[1:]], 1) for line in lines]
    return np.concatenate(pieces)[..., ::-1] - 1 if pieces else np.zeros((0, 2, 2))


def to_segments(points: np.ndarray, segments: np.ndarray, candidates: int = 6) -> np.ndarray:
    """Distance of each point (n, 2) to the nearest of the short segments (m, 2, 2)."""
    _, near = KDTree(segments.mean(1)).query(points, k=min(candidates, len(segments)))
    a, b = np.moveaxis(segments[near.reshape(len(points), -1)], 2, 0)
    d, p = b - a, points[:, None]
    t = np.clip(np.sum((p - a) * d, -1) / np.maximum(np.sum(d * d, -1), 1e-30), 0, 1)
    return np.linalg.norm(a + t[..., None] * d - p, axis=-1).min(1)


def _centred(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Triangles (F, 3, 3), shifted along Z so that the surface's mean Z is 0."""
    triangles = vertices[faces].astype(float)
    area = _area(triangles)
    triangles[..., 2] -= area @ triangles[..., 2].mean(1) / area.sum()
    return triangles


def _area(triangles: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def _spread(triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """`count` points (n, 3) spread over triangles in proportion to area, and the triangle of each (n,)."""
    total = np.cumsum(_area(triangles))
    k = np.arange(count)
    face = np.searchsorted(total, (k + 0.5) / count * total[-1])
    u, v = (k * 0.7548776662466927) % 1, (k * 0.5698402909980532) % 1  # the R2 sequence of low discrepancy
    u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])
    a, b, c = np.moveaxis(triangles[face], 1, 0)
    return a + u[:, None] * (b - a) + v[:, None] * (c - a), face


def to_surface(points: np.ndarray, mesh: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Distance of each point (n, 3) to a mesh (vertices, faces), shape (n,)."""
    vertices, faces = mesh
    return _to_surface(points, vertices[faces].astype(float))


def _to_surface(
    points: np.ndarray,
    triangles: np.ndarray,
    more: int = 40000,
    candidates: int = 5,
) -> np.ndarray:
    """Distance of points (n, 3) to the nearest of those triangles whose centre or other samples lie close."""
    cloud, face = _spread(triangles, more)  # large triangles need more than their centre
    cloud = np.concatenate([triangles.mean(1), cloud])
    face = np.concatenate([np.arange(len(triangles)), face])
    _, near = KDTree(cloud).query(points, k=candidates)
    return _to_triangles(points[:, None], triangles[face[near]]).min(1)


def _to_triangles(p: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance of points (n, 1, 3) to triangles (n, k, 3, 3), shape (n, k)."""
    a, b, c = np.moveaxis(triangles, -2, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
    height = np.sum((p - a) * normal, -1)
    inside = np.ones(height.shape, bool)
    to_edge = np.full(height.shape, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        d, r = end - start, p - start
        inside &= np.sum(np.cross(d, r) * normal, -1) >= 0
        t = np.clip(np.sum(r * d, -1) / np.maximum(np.sum(d * d, -1), 1e-30), 0, 1)
        to_edge = np.minimum(to_edge, np.linalg.norm(r - t[..., None] * d, axis=-1))
    return np.where(inside, np.abs(height), to_edge)
