"""Which of two objects lies in front: depths that are left to be found, from what the image shows of their outlines.

Of two objects that overlap, the front one's outline runs on as an edge within the other, which goes on below it; the hidden
one's has no edge within the front one. And where both outlines meet what is behind them, the front one's runs straight on
past the other's end (a T-junction), so that of a small disc it takes the larger part.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from skimage.measure import find_contours

from .foreground import Foreground, axis_curve
from .neighbours import completed, foregrounds
from .problem import Tube, View
from .result import ObjectResult
from .sampling import colours, resample

FINE = 32.0
"""Most samples for the smaller object's half width: finer images are sampled down."""
SIGMA, ASIDE, DEEP = 1.5, 0.06, 0.36
"""Smoothing of edges [samples]; how far beside an outline they are looked for, and depth from which a point of an outline
inside the other object counts in full, in half widths."""
DISC, GROUND, SLIVER = 0.3, 0.05, 3
"""Radius of a junction's disc [half widths]; least share of it that is background, most that both claim; half width of gaps
that are no background [samples]."""
TOUCH = 0.5
"""Length along which two objects must touch for their order to matter [smaller half width]."""
PLAIN = 0.1
"""Cue below which the order is not known."""
GAP = 1.1
"""Depth from one axis to that of the next object behind it, in their half widths together: they do not touch."""


@dataclass(frozen=True)
class Found:
    """The depth that was found for an object."""

    depth: float
    """[world units]."""
    certainty: float
    """how plain the least plain of its cues is, 0 to 1; 1 where no other object overlaps it."""
    unsure: tuple[str, ...]
    """names of objects that may lie in front of it or behind it; the image does not tell."""


def in_order(view: View, tubes: Sequence[Tube]) -> tuple[list[Tube], list[Found | None]]:
    """Tubes with a depth each, and what was found of those whose depth was to be found (`Tube.find_depth`), else None.

    Pairs are put in order from the plainest cue on, those that would contradict it left out; each object then lies as
    close behind those in front of it as it can without touching them. Given depths stay.

    Args:
        view: affine.
        tubes: with rough axes; those whose depth is to be found in image points.
    """
    if not any(tube.find_depth for tube in tubes):
        return list(tubes), [None] * len(tubes)
    camera, count = view.camera, len(tubes)
    spines = [np.asarray(tube.spine, float) for tube in tubes]
    flat = [s if s.shape[1] == 2 else camera.project(s) for s in spines]
    maps = foregrounds(view, flat, [tube.not_here for tube in tubes], [0.0] * count)
    given = [
        None if t.find_depth else t.depth if s.shape[1] == 2 else float(camera.distance(s).mean())
        for t, s in zip(tubes, spines, strict=True)
    ]
    cues = cues_of(view.image, maps, flat, [[a is None or b is None for b in given] for a in given])
    behind = np.zeros((count, count), bool)  # behind[i, j]: j lies behind i, itself or what is between
    for i, j in np.ndindex(count, count):
        a, b = given[i], given[j]
        behind[i, j] = a is not None and b is not None and a < b
    left_out = set()
    for (i, j), cue in sorted(cues.items(), key=lambda item: -abs(item[1])):
        front, back = (i, j) if cue > 0 else (j, i)
        if behind[back, front]:
            left_out.add((i, j))
            continue
        before, after = behind[:, front].copy(), behind[back].copy()
        before[front] = after[back] = True
        behind |= before[:, None] & after
    pixel = 1 / np.linalg.norm(camera.matrix[:2, :3], 2)
    depths = list(given)
    for k in sorted(range(count), key=lambda k: int(behind[:, k].sum())):
        if depths[k] is None:
            depths[k] = _depth(
                k, depths, behind, [float(pixel) * GAP * (m.half_width + maps[k].half_width) for m in maps], cues
            )
    found: list[Found | None] = []
    for k, tube in enumerate(tubes):
        own = {pair: cue for pair, cue in cues.items() if k in pair}
        doubtful = [pair for pair, cue in own.items() if abs(cue) < PLAIN or pair in left_out]
        names = tuple(tubes[sum(pair) - k].name for pair in doubtful)
        certainty = min([1.0, *(0.0 if pair in left_out else abs(cue) for pair, cue in own.items())])
        found.append(Found(float(depths[k] or 0.0), certainty, names) if tube.find_depth else None)
    settled = [
        tube if f is None else dataclasses.replace(tube, depth=f.depth, find_depth=False)
        for tube, f in zip(tubes, found, strict=True)
    ]
    return settled, found


def tell(result: ObjectResult, found: Found | None) -> None:
    """Adds to an object's result the depth that was found, its certainty, and a warning where the image does not tell."""
    if found is None:
        return
    result.measures |= {"depth": found.depth, "depth_certainty": found.certainty}
    if found.unsure:
        others = ", ".join(found.unsure)
        result.trusted = False
        result.warnings.append(
            f"the image does not tell whether this lies in front of {others} or behind: it is a guess; give depths"
        )


def _depth(
    k: int,
    depths: Sequence[float | None],
    behind: np.ndarray,
    gaps: Sequence[float],
    cues: dict[tuple[int, int], float],
) -> float:
    """Depth of object k, when all in front of it have theirs: `gaps` behind those it overlaps, before what is behind it."""
    near = [(min(k, j), max(k, j)) in cues for j in range(len(depths))]
    nearest = [d + near[j] * gaps[j] for j, d in enumerate(depths) if d is not None and behind[j, k]]
    furthest = [d - near[j] * gaps[j] for j, d in enumerate(depths) if d is not None and behind[k, j]]
    if not nearest:
        return min([0.0, *furthest])
    if not furthest or max(nearest) <= min(furthest):
        return max(nearest)
    # no room for the gaps
    before = max(d for j, d in enumerate(depths) if d is not None and behind[j, k])
    return (before + min(d for j, d in enumerate(depths) if d is not None and behind[k, j])) / 2


def cues_of(
    image: np.ndarray, maps: Sequence[Foreground], axes: Sequence[np.ndarray], wanted: Sequence[Sequence[bool]]
) -> dict[tuple[int, int], float]:
    """How plainly i lies in front of j, for each wanted pair i < j that overlaps: -1 to 1; below 0, j lies in front of i.

    Args:
        image: shape (H, W) or (H, W, 3).
        maps: of each object, made with the others in mind but without an order.
        axes: rough axis of each, shape (n, 2), image points.
        wanted: which pairs.
    """
    boxes = [m.box for m in maps]
    out: dict[tuple[int, int], float] = {}
    for i in range(len(maps)):
        for j in range(i + 1, len(maps)):
            low, high = np.minimum(boxes[i][0], boxes[j][0]), np.maximum(boxes[i][1], boxes[j][1])
            if not wanted[i][j] or np.any(high - low >= np.sum([np.diff(boxes[k], axis=0)[0] for k in (i, j)], axis=0)):
                continue
            cue = _cue(image, (maps[i], maps[j]), (axes[i], axes[j]), low, high)
            if cue is not None:
                out[i, j] = cue
    return out


def _cue(
    image: np.ndarray,
    maps: tuple[Foreground, Foreground],
    axes: tuple[np.ndarray, np.ndarray],
    low: np.ndarray,
    high: np.ndarray,
) -> float | None:
    """The cue of one pair, in a box of image points; None where they do not overlap."""
    half = min(m.half_width for m in maps)
    step = max(1.0, half / FINE)
    columns, rows = (int(n) for n in np.ceil((high - low) / step))
    seen = [m.in_image(image.shape[:2]) > 0.5 for m in maps]
    whole = [completed(maps[k], axis_curve(axes[k]), seen[1 - k] & ~seen[k]) for k in (0, 1)]
    shapes = [m.in_image((rows, columns), (low[0], low[1]), step) > 0.5 for m in whole]
    parts = [m.in_image((rows, columns), (low[0], low[1]), step) > 0.5 for m in maps]
    if np.logical_and(*(ndimage.binary_dilation(s) for s in shapes)).sum() < 2 * TOUCH * half / step:
        return None
    x = resample(colours(image), low, step, (rows, columns))
    edges, junctions = _edges(x, parts, shapes, half / step), _junctions(parts, half / step)
    return edges + (1 - abs(edges)) * junctions


def _edges(x: np.ndarray, parts: Sequence[np.ndarray], shapes: Sequence[np.ndarray], half: float) -> float:
    """How much more edge lies along the first one's outline within the second, completed, than the other way round.

    Each point counts by the square of its depth, so that of one border the object gets more that lets the other go on below.

    Args:
        x: image, shape (h, w, channels).
        parts: what is seen of both objects, shape (h, w), bool.
        shapes: both completed, likewise.
        half: smaller half width [samples].

    Returns:
        difference of both over their sum and the image's own unrest, -1 to 1.
    """
    slope = np.stack([ndimage.gaussian_filter(x, (SIGMA, SIGMA, 0), order=o) for o in ((0, 1, 0), (1, 0, 0))])  # pyright: ignore
    unrest = float(np.median(np.sqrt((slope**2).sum((0, -1)))[parts[0] | parts[1]]))
    aside = max(1, round(ASIDE * half))
    # the edge of what is behind both is nobody's within the other
    clear = np.asarray(ndimage.distance_transform_edt(~_ground(parts))) > aside + 2 * SIGMA
    edge = []
    for own, other in ((0, 1), (1, 0)):
        depth, total = clear * np.asarray(ndimage.distance_transform_edt(shapes[other])), 0.0
        for line in find_contours(np.pad(parts[own], 1).astype(float), 0.5):
            deep = ndimage.map_coordinates(depth, (line - 1).T, order=1)
            weight = np.clip(deep, 0, DEEP * half) ** 2 * (deep > 1)
            total += float((weight * (_along(slope, line - 1, aside) - unrest)).sum())
        edge.append(max(total, 0.0))
    least = unrest * (DEEP * half) ** 2 * half
    return (edge[0] - edge[1]) / (edge[0] + edge[1] + least + 1e-12)


def _ground(parts: Sequence[np.ndarray]) -> np.ndarray:
    """What neither object covers, slivers between them apart, (h, w), bool."""
    return np.asarray(ndimage.binary_opening(~(parts[0] | parts[1]), iterations=SLIVER))


def _along(slope: np.ndarray, line: np.ndarray, aside: int) -> np.ndarray:
    """Strongest slope (2, h, w, channels) across a closed line (n, 2), (row, column), within `aside` samples of it."""
    line = ndimage.gaussian_filter1d(line, 2, axis=0, mode="wrap")
    along = np.gradient(line, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    across /= np.linalg.norm(across, axis=1, keepdims=True) + 1e-12
    best = np.zeros(len(line))
    for off in range(-aside, aside + 1):
        at = (line + off * across).T
        x, y = (np.stack([ndimage.map_coordinates(c, at, order=1) for c in np.moveaxis(s, -1, 0)]) for s in slope)
        best = np.maximum(best, np.linalg.norm(x * across[:, 1] + y * across[:, 0], axis=0))
    return best


def _junctions(parts: Sequence[np.ndarray], half: float) -> float:
    """By how much the first object takes more of discs about the T-junctions than the second, of what both take, -1 to 1.

    Args:
        parts: what is seen of each, shape (h, w), bool; what both claim is half of each.
        half: smaller half width [samples].
    """
    ground = _ground(parts)
    shares = [part - 0.5 * (parts[0] & parts[1]) for part in parts]
    near = [ndimage.binary_dilation(m, iterations=2) for m in (shares[0] == 1, shares[1] == 1, ground)]
    labels, count = ndimage.label(near[0] & near[1] & near[2], np.ones((3, 3)))  # pyright: ignore
    rows, columns = np.indices(labels.shape)
    taken = np.zeros(2)
    for row, column in ndimage.center_of_mass(labels > 0, labels, range(1, count + 1)):
        disc = np.hypot(rows - row, columns - column) <= max(DISC * half, 3.0)
        if ground[disc].mean() > GROUND and (parts[0] & parts[1])[disc].mean() < GROUND:
            taken += [float(share[disc].sum()) / disc.sum() for share in shares]
    return float((taken[0] - taken[1]) / max(taken.sum(), 1e-12))
