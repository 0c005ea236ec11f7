"""Triangles to pixels in plain numpy: how much of each pixel a mesh covers, and which triangle is seen there.

Points are (column, row) with pixel centres at whole numbers. A pixel holds samples x samples points.
"""

from __future__ import annotations

import numpy as np


def coverage(points: np.ndarray, faces: np.ndarray, shape: tuple[int, int], samples: int = 8) -> np.ndarray:
    """Share of each pixel inside the union of triangles, float32 (H, W), a multiple of 1 / samples^2.

    `points` (V, 2) are projected vertices; parts outside the image are cut off.
    """
    row, start, end, _ = _spans(points, faces, shape, samples)
    out = np.zeros(shape, np.float32)
    if len(row) == 0:
        return out
    top, bottom = row.min() // samples, row.max() // samples + 1
    left, right = start.min() // samples, (end.max() - 1) // samples + 1
    stride = (right - left) * samples + 1
    at = (row - top * samples) * stride - left * samples
    size = (bottom - top) * samples * stride
    layers = np.bincount(at + start, minlength=size) - np.bincount(at + end, minlength=size)
    inside = np.cumsum(layers.astype(np.int16).reshape(-1, stride)[:, :-1], axis=1, dtype=np.int16) > 0
    hits = np.count_nonzero(inside.reshape(-1, right - left, samples), axis=2)
    out[top:bottom, left:right] = hits.reshape(bottom - top, samples, -1).sum(1) / samples**2
    return out


def visible(
    points: np.ndarray,
    depth: np.ndarray,
    faces: np.ndarray,
    shape: tuple[int, int],
    samples: int,
) -> np.ndarray:
    """Face nearest to the viewer at each sample, -1 where there is none, shape (H * samples, W * samples).

    `depth` (V,) grows away from the viewer. Faces are painted from far to near, so they must be small
    beside the distance between the surfaces that hide each other.
    """
    order = np.argsort(-depth[faces].sum(1), kind="stable")
    row, start, end, face = _spans(points, faces[order], shape, samples)
    count = end - start
    first = np.repeat(row * (shape[1] * samples) + start, count)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    seen = np.full(shape[0] * shape[1] * samples**2, -1, np.int64)
    seen[first + within] = order[np.repeat(face, count)]  # numpy keeps the last one
    return seen.reshape(shape[0] * samples, shape[1] * samples)


def barycentric(
    points: np.ndarray,
    faces: np.ndarray,
    seen: np.ndarray,
    samples: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where `seen` shows a face: row and column of the sample, face (k,) and coordinates in it (k, 3)."""
    row, column = np.nonzero(seen >= 0)
    face = seen[row, column]
    a, b, c = np.moveaxis(points[faces[face]], 1, 0)
    p = (np.stack([column, row], 1) + 0.5) / samples - 0.5
    u, v, w = b - a, c - a, p - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
    t = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
    return row, column, face, np.stack([1 - s - t, s, t], 1)


def _spans(
    points: np.ndarray,
    faces: np.ndarray,
    shape: tuple[int, int],
    samples: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Row of samples, first column, column after the last and face of each piece of a triangle on a row.

    Borders are half open, so that neighbours neither overlap nor leave gaps.
    """
    triangles = (points[faces] + 0.5) * samples - 0.5
    triangles = np.take_along_axis(triangles, np.argsort(triangles[..., 1], axis=1)[..., None], axis=1)
    top = np.clip(np.ceil(triangles[:, 0, 1]), 0, None).astype(np.int64)
    bottom = np.clip(np.ceil(triangles[:, 2, 1]), None, shape[0] * samples).astype(np.int64)
    rows = np.clip(bottom - top, 0, None)
    face = np.repeat(np.arange(len(faces)), rows)
    row = np.arange(len(face)) - np.repeat(np.cumsum(rows) - rows, rows) + top[face]
    a, b, c = np.moveaxis(triangles[face], 1, 0)
    upper = row < b[:, 1]
    long_edge = _cross(a, c, row)
    short_edge = _cross(np.where(upper[:, None], a, b), np.where(upper[:, None], b, c), row)
    limits = np.ceil(np.sort(np.stack([long_edge, short_edge], 1), axis=1))
    start, end = np.clip(limits, 0, shape[1] * samples).astype(np.int64).T
    some = end > start
    return row[some], start[some], end[some], face[some]


def _cross(p: np.ndarray, q: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Column at which the edge from p up to q, both (k, 2), meets the row."""
    return p[:, 0] + (row - p[:, 1]) * (q[:, 0] - p[:, 0]) / (q[:, 1] - p[:, 1])
