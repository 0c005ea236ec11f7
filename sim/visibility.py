"""Which parts of an image show an object, and which show another one in front of it: where beta of (11) is nulled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ..kernels import rays
from .assembly import Assembly
from .camera import Camera
from .hidden import Hidden, window
from .surface import silhouette

AHEAD = 1e-3
"""How much nearer a spine must be to lie in front [lengths of the other]: of spines as deep, neither hides the other."""
ROOM = 2.0
"""Pixels about what two objects share that are looked at too."""
FAR = 1.2
"""Between rings of one tube, in sums of their radii along the spine: nearer than that they are neighbours, no overlap."""
SPAN = 256.0
"""Depths among which rays are cast, whatever the view's own [px]."""
STILL = 0.2
"""Pixels by which a tube must have moved to be looked at anew."""
WANDERED, FURTHER = 1.5, 1.1
"""Pixels by which a place where outlines meet must have moved, and how much further the next time: what wavers, as the
outlines go with such places, comes to rest."""
CHANGED = 0.01
"""Share of an object's hidden pixels by which they must change to count as much."""

Pass = Callable[[Sequence[tuple[np.ndarray, np.ndarray]], tuple[int, int]], tuple[np.ndarray, np.ndarray]]
"""A depth pass: meshes as seen, (column, row, depth) (V, 3) with faces (F, 3) each, and the picture's (height, width); to
depth, infinite where nothing is, and number of the nearest mesh, -1 where none is, at each pixel's centre, (H, W)."""


def seen(camera: Camera, points: np.ndarray) -> np.ndarray:
    """World points (..., 3) as (column, row, depth) of a view; depth such that what is flat stays flat.

    Along the axis of an affine view; of any other minus one over the distance along its axis, in which the straight lines
    of the world are straight in the picture too. It grows away from the viewer in both.
    """
    if camera.affine:
        depth = camera.distance(points)
    else:
        m = camera.matrix * np.sign(np.linalg.det(camera.matrix[:, :3])) / np.linalg.norm(camera.matrix[2, :3])
        depth = -1 / (points @ m[2, :3] + m[2, 3])
    return np.concatenate([camera.project(points), depth[..., None]], axis=-1)


def cast_rays(
    meshes: Sequence[tuple[np.ndarray, np.ndarray]],
    shape: tuple[int, int],
    where: np.ndarray | None = None,
    device: str = "cpu",
) -> tuple[np.ndarray, np.ndarray]:
    """A depth pass (`Pass`) by a ray a pixel through Warp's tree of triangles; `where`, (H, W), bool, if given."""
    mesh, first, (nearest, unit) = _merged(meshes, device)
    rows, columns = np.nonzero(np.ones(shape, bool) if where is None else where)
    distance, face = _cast(mesh, np.stack([columns, rows, np.full(len(rows), -1.0)], axis=-1), 1.0)
    hit = face >= 0
    depth, owner = np.full(shape, np.inf), np.full(shape, -1)
    owner[rows[hit], columns[hit]] = np.searchsorted(first, face[hit], side="right") - 1
    depth[rows[hit], columns[hit]] = nearest + (distance[hit].astype(float) - 1) * unit
    return depth, owner


def hidden_by_rays(
    points: np.ndarray, meshes: Sequence[tuple[np.ndarray, np.ndarray]], margin: float, device: str = "cpu"
) -> np.ndarray:
    """Whether a surface lies in front of each point, both as seen: a ray from it to the viewer, shape (n,), bool.

    Args:
        points: (column, row, depth), shape (n, 3).
        meshes: as of a `Pass`.
        margin: depth by which it must be nearer.
        device: Warp device.
    """
    mesh, _, (nearest, unit) = _merged(meshes, device)
    start = np.column_stack([points[:, :2], (points[:, 2] - margin - nearest) / unit])
    return _cast(mesh, start, -1.0)[1] >= 0


def hidden_by_depth(points: np.ndarray, depth: np.ndarray, margin: float) -> np.ndarray:
    """The same from a depth pass (H, W), by the nearest pixel; of points that face the viewer: steep sides mislead it."""
    height, width = depth.shape
    column, row = np.rint(points[:, :2]).astype(int).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    nearest = depth[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return inside & (nearest < points[:, 2] - margin)


def _merged(meshes: Sequence[tuple[np.ndarray, np.ndarray]], device: str) -> tuple[wp.Mesh, np.ndarray, tuple[float, float]]:
    """All meshes as one, the first face of each, and least depth and unit of its depths, which go from 0 to `SPAN`."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = np.concatenate([f + start for (_, f), start in zip(meshes, starts, strict=False)]).astype(np.int32)
    vertices = np.concatenate([v for v, _ in meshes])
    nearest, unit = float(vertices[:, 2].min()), max(float(np.ptp(vertices[:, 2])), 1e-12) / SPAN
    vertices = np.column_stack([vertices[:, :2], (vertices[:, 2] - nearest) / unit]).astype(np.float32)
    mesh = wp.Mesh(wp.array(vertices, dtype=wp.vec3, device=device), wp.array(faces.ravel(), dtype=int, device=device))
    return mesh, np.cumsum([0, *(len(f) for _, f in meshes)])[:-1], (nearest, unit)


def _cast(mesh: wp.Mesh, start: np.ndarray, way: float) -> tuple[np.ndarray, np.ndarray]:
    device, count = mesh.points.device, len(start)
    distance = wp.zeros(count, dtype=float, device=device)
    face = wp.zeros(count, dtype=int, device=device)
    wp.launch(
        rays.cast,
        count,
        inputs=[mesh.id, wp.array(start.astype(np.float32), dtype=wp.vec3, device=device), way],
        outputs=[distance, face],
        device=device,
    )
    return distance.numpy(), face.numpy()


class Visibility:
    """Looks where the tubes of some assemblies hide each other, and tells each assembly.

    In front is whose spine is nearer to the viewer where both are seen, the painter's order: tubes that are laid into
    each other, as by a user who gave no more than an order, hide each other as they should. For that each ring is drawn
    at the depth of its centre. Where a tube lies before itself, neither part's edge can be told from its own colours: it
    counts as hidden there.

    Args:
        depth_pass: how; None: by rays.
    """

    def __init__(self, depth_pass: Pass | None = None):
        self.depth_pass = depth_pass
        # view and tube: with which others it was drawn, and where
        self._drawn: dict[tuple[int, int], tuple[tuple[int, ...], np.ndarray]] = {}
        # view and tube: how often places where outlines meet have moved
        self._wavers: dict[tuple[int, int], int] = {}

    def refresh(self, scenes: Sequence[Assembly]) -> list[bool | None]:
        """Writes `Assembly.hidden` and `meetings` of every tube in every view that has moved, or another about it.

        Returns:
            for each assembly None if nothing changed, else whether anything did by much.
        """
        where = [(number, k) for number, scene in enumerate(scenes) for k in range(len(scene.tubes))]
        changed: list[bool | None] = [None] * len(scenes)
        worlds = [scenes[number].world(k)[0] for number, k in where]
        for v, view in enumerate(scenes[0].views if scenes else ()):
            for i, (hidden, meetings) in self._view(v, view.camera, view.image.shape[:2], worlds).items():
                number, k = where[i]
                own, met = scenes[number].hidden[k], scenes[number].meetings[k]
                hidden = Hidden.of(scenes[number].own_views[k][v].ignore, hidden)
                much = _differ(own[v], hidden)
                if _far_off(met[v], meetings, WANDERED * FURTHER ** self._wavers.get((v, i), 0)):
                    much, met[v] = bool(much), meetings
                    self._wavers[v, i] = self._wavers.get((v, i), 0) + 1
                if much is not None:
                    changed[number] = bool(changed[number]) or much
                own[v] = hidden
        return changed

    def _view(
        self, v: int, camera: Camera, shape: tuple[int, ...], tubes: list[np.ndarray]
    ) -> dict[int, tuple[Hidden | None, np.ndarray]]:
        """What hides those tubes for which it may have changed, and where outlines behind meet theirs, by their numbers."""
        flat, margins = [], []
        for tube in tubes:
            own, centre = seen(camera, tube), tube.mean(axis=0)
            own[..., 2] = seen(camera, centre)[:, 2]
            flat.append(own)
            # a length at the tube's distance, as depth is measured
            unit = 1.0 if camera.affine else own[..., 2].mean() ** 2
            margins.append(AHEAD * unit * np.linalg.norm(np.diff(centre, axis=0), axis=1).sum())
        if len(tubes) == 1:
            if self._as_drawn(v, 0, (0,), flat[0], margins[0]):
                return {}
            self._drawn[v, 0] = (0,), flat[0]
            return {0: (_with_own(None, flat[0], shape), np.zeros((0, 2)))}
        boxes = np.array([[f[..., :2].min((0, 1)) - ROOM, f[..., :2].max((0, 1)) + ROOM] for f in flat])
        meets = np.ones((len(boxes), len(boxes)), bool)
        for first, last in boxes.transpose(2, 1, 0):
            np.logical_and(meets, first < last[:, None], out=meets)
            np.logical_and(meets, first[:, None] < last, out=meets)
        _, group = connected_components(csr_array(meets), directed=False)
        # what only others have brought to be looked at stays where it was drawn: what it meets was looked at with it there
        about = [tuple(np.flatnonzero(m).tolist()) for m in meets]
        moved = np.array(
            [not self._as_drawn(v, k, about[k], f, m) for k, (f, m) in enumerate(zip(flat, margins, strict=True))]
        )
        self._drawn.update({(v, k): (about[k], flat[k]) for k in np.flatnonzero(moved).tolist()})
        anew = np.any(meets[:, moved], axis=1)
        about_them = np.any(meets[:, anew], axis=1)
        found: dict[int, tuple[Hidden | None, np.ndarray]] = {}
        for g in np.unique(group[anew]):
            members = np.flatnonzero((group == g) & about_them)
            own = [flat[k] for k in members], [margins[k] for k in members]
            behind = self._group(*own, boxes[members], meets[np.ix_(members, members)], anew[members], shape)
            found |= {
                k: (_with_own(hidden, flat[k], shape), met)
                for k, (hidden, met) in zip(members[anew[members]].tolist(), behind, strict=True)
            }
        return found

    def _as_drawn(self, v: int, k: int, about: tuple[int, ...], flat: np.ndarray, margin: float) -> bool:
        """Whether a tube has been looked at with the same others about it where it is now."""
        before, where = self._drawn.get((v, k), ((), flat))
        way = np.abs(where - flat).max(axis=(0, 1))
        return before == about and bool(way[:2].max() < STILL and way[2] < margin)

    def _group(
        self,
        flat: list[np.ndarray],
        margins: list[float],
        boxes: np.ndarray,
        meets: np.ndarray,
        anew: np.ndarray,
        shape: tuple[int, ...],
    ) -> list[tuple[Hidden | None, np.ndarray]]:
        """The same for those of several tubes as seen, boxes (K, 2, 2), that are to be looked at `anew`, (K,).

        `meets` says whose boxes meet, (K, K), in an image of that shape.
        """
        near, far = (np.array([f(own[..., 2]) for own in flat]) for f in (np.min, np.max))
        # first of a pair may lie in front of second somewhere
        pairs = np.argwhere(
            meets & ~np.eye(len(flat), dtype=bool) & (near[:, None] < far - margins) & (anew | anew[:, None])
        )
        if not len(pairs):
            return [(None, np.zeros((0, 2)))] * int(anew.sum())
        size = np.array(shape[1::-1])
        shared = np.stack([boxes[pairs, 0].max(axis=1), boxes[pairs, 1].min(axis=1)], axis=1)
        first = np.clip(np.floor(shared[:, 0].min(axis=0)), 0, size - 1).astype(int)
        last = np.clip(np.ceil(shared[:, 1].max(axis=0)), first, size - 1).astype(int)
        meshes = [(own.reshape(-1, 3) - [*first, 0], _grid_faces(*own.shape[:2])) for own in flat]
        height, width = int(last[1] - first[1] + 1), int(last[0] - first[0] + 1)
        if self.depth_pass:
            depth, owner = self.depth_pass(meshes, (height, width))
        else:
            where = np.zeros((height, width), bool)
            corners = np.floor(shared - first) + np.array([[0, 0], [2, 2]])
            for (left, top), (right, bottom) in np.maximum(corners, 0).astype(int):
                where[top:bottom, left:right] = True
            depth, owner = cast_rays(meshes, (height, width), where)
        return [
            _behind(depth, owner, k, flat[k].mean(axis=0), boxes[k] - first, first, margins[k])
            for k in np.flatnonzero(anew).tolist()
        ]


def note_others(scenes: Sequence[Assembly]) -> None:
    """Writes `Assembly.others` of every tube in every view: which pixels of its map's crop any other tube covers."""
    where = [(scene, k) for scene in scenes for k in range(len(scene.tubes))]
    for v, view in enumerate(scenes[0].views):
        shape = view.image.shape[:2]
        count = np.zeros(shape, np.int32)
        covers = []
        for scene, k in where:
            flat = view.camera.project(scene.world(k)[0])
            part = rows, columns = window(np.stack([flat.min((0, 1)), flat.max((0, 1))]), shape)
            covers.append((part, silhouette(flat - [columns.start, rows.start], count[part].shape)))
            count[part] += covers[-1][1]
        for (scene, k), (part, cover) in zip(where, covers, strict=True):
            rows, columns = window(scene.maps[k][v].box, shape)
            count[part] -= cover
            mask = count[rows, columns] > 0
            scene.others[k][v] = Hidden(mask, (columns.start, rows.start)) if mask.any() else None
            count[part] += cover


def _behind(
    depth: np.ndarray, owner: np.ndarray, number: int, centre: np.ndarray, box: np.ndarray, first: np.ndarray, margin: float
) -> tuple[Hidden | None, np.ndarray]:
    """Where another mesh is nearer than the spine of mesh `number` beside it, in its box; and `_meetings`."""
    height, width = depth.shape
    left, top = np.clip(np.floor(box[0]), 0, [width, height]).astype(int)
    right, bottom = np.clip(np.ceil(box[1]) + 1, 0, [width, height]).astype(int)
    part = slice(top, bottom), slice(left, right)
    other = (owner[part] >= 0) & (owner[part] != number) & (depth[part] < centre[:, 2].max() - margin)
    mask = np.zeros(other.shape, bool)
    corner = int(left + first[0]), int(top + first[1])
    if other.any():
        rows, columns = np.nonzero(other)
        at = np.stack([columns, rows], axis=1) + corner
        nearest = KDTree(centre[:, :2]).query(at)[1]
        mask[rows, columns] = depth[part][rows, columns] < centre[nearest, 2] - margin
    return Hidden(mask, corner) if mask.any() else None, _meetings(owner[part], number, mask) + corner


def _meetings(owner: np.ndarray, number: int, hides: np.ndarray) -> np.ndarray:
    """Where outlines of what lies behind mesh `number` meet its own, (column, row), shape (n, 2).

    Those are pixels beside it with a neighbour that shows something third. Near what lies before it nothing counts anyway.

    Args:
        owner: which mesh each pixel shows, shape (h, w).
        number: of the mesh.
        hides: where it is hidden, shape (h, w), bool.
    """
    edge = np.zeros(owner.shape, bool)
    for o, e in ((owner, edge), (owner.T, edge.T)):
        apart = (o[:-1] != o[1:]) & (o[:-1] != number) & (o[1:] != number)
        e[:-1] |= apart
        e[1:] |= apart
    at = np.argwhere(edge)

    def beside(mask: Any, reach: int) -> Any:
        """Which of those pixels have one of a mask within reach in both directions."""
        steps = np.arange(2 * reach + 1)
        rows, columns = (at[:, i, None, None] + steps.reshape((-1, 1) if i == 0 else (1, -1)) for i in (0, 1))
        return np.pad(mask, reach)[rows, columns].any(axis=(1, 2))

    return at[beside(owner == number, 1) & ~beside(hides, 2)][:, ::-1]


def _with_own(found: Hidden | None, tube: np.ndarray, shape: tuple[int, ...]) -> Hidden | None:
    """Adds where a tube as seen, shape (N_x, N_s, 3), lies before itself in an image of that shape."""
    centre = tube[..., :2].mean(axis=0)
    radius = np.linalg.norm(tube[..., :2] - centre, axis=2).max(axis=0)
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    sums = radius[:, None] + radius
    near = np.linalg.norm(centre[:, None] - centre[None], axis=2) < sums
    pairs = np.argwhere(near & (arc[None] - arc[:, None] > 2 * FAR * sums))
    if not len(pairs):
        return found
    last = np.array(shape[1::-1]) - 1
    low = np.clip(np.floor((centre - radius[:, None])[pairs.ravel()].min(axis=0)), 0, last).astype(int)
    high = np.clip(np.ceil((centre + radius[:, None])[pairs.ravel()].max(axis=0)), 0, last).astype(int)
    if found is not None:
        low = np.minimum(low, found.corner)
        high = np.maximum(high, np.add(found.corner, found.mask.shape[::-1]) - 1)
    columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    within = {i: np.hypot(columns - centre[i, 0], rows - centre[i, 1]) < radius[i] for i in np.unique(pairs)}
    mask = np.zeros(columns.shape, bool)
    for i, j in pairs:
        mask |= within[i] & within[j]
    if found is not None:
        mask |= found.at(np.stack([columns, rows], axis=-1))
    return Hidden(mask, (int(low[0]), int(low[1])))


def _far_off(a: np.ndarray, b: np.ndarray, way: float) -> bool:
    """Whether a point of one of two lots, shape (n, 2), lies further than a way from all of the other."""
    if not (len(a) and len(b)):
        return len(a) != len(b)
    return max(KDTree(a).query(b)[0].max(), KDTree(b).query(a)[0].max()) > way


def _differ(a: Hidden | None, b: Hidden | None) -> bool | None:
    """Whether two looks differ much where both looked, None for not at all; how far they look goes with the tube."""
    if a is None or b is None:
        return True if a is not b else None
    low, high = np.maximum(a.corner, b.corner), np.minimum(*(np.add(h.corner, h.mask.shape[::-1]) for h in (a, b)))
    one, two = (
        h.mask[tuple(slice(max(lo - c, 0), max(hi - c, 0)) for lo, hi, c in zip(low, high, h.corner, strict=True))[::-1]]
        for h in (a, b)
    )
    far = one.size < 0.5 * min(a.mask.size, b.mask.size)
    apart = np.logical_xor(one, two).sum()
    if not apart and one.sum() == a.mask.sum() and two.sum() == b.mask.sum():
        return None
    return bool(far or apart > CHANGED * max(one.sum(), two.sum()))


def _grid_faces(around: int, along: int) -> np.ndarray:
    """Triangles (F, 3) of nodes (N_x, N_s), closed around, ends open."""
    x, s = np.meshgrid(np.arange(around), np.arange(along - 1), indexing="ij")
    a, b = x * along + s, (x + 1) % around * along + s
    return np.concatenate([np.stack([a, b, a + 1], -1), np.stack([b, b + 1, a + 1], -1)]).reshape(-1, 3)
