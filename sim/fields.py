"""Weights as fields: from what a user gives to arrays on a tube's grid, and from zero weights to discontinuities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .material import Break


@dataclass(frozen=True)
class Place:
    """Where the values of a weight live."""

    sheet: bool = False
    """over (x, s); else over s."""
    edge_x: bool = False
    """value i belongs to the edge from i to i + 1 around."""
    edge_s: bool = False
    """value k belongs to the edge from k to k + 1 along; the last is unused."""
    low: float = 0.0
    """least value allowed."""


SIGNED = -1e6
MOST = 1e6
"""Largest magnitude of any weight."""
PLACES = {
    "w1": Place(edge_s=True), "k1": Place(edge_s=True), "L1": Place(edge_s=True),
    "w2": Place(), "C2": Place(low=SIGNED),
    "w10": Place(True, edge_x=True), "k10": Place(True, edge_x=True), "L10": Place(True, edge_x=True),
    "w01": Place(True, edge_s=True), "k01": Place(True, edge_s=True), "L01": Place(True, edge_s=True),
    "w20": Place(True), "C20": Place(True, low=SIGNED),
    "w11": Place(True, True, True), "C11": Place(True, True, True, SIGNED),
    "w02": Place(True), "C02": Place(True, low=SIGNED),
    "mu": Place(True), "gamma": Place(True),
    "a": Place(), "reaction": Place(), "b": Place(), "c": Place(low=SIGNED), "c_balance": Place(), "d": Place(),
    "centre": Place(), "depth": Place(),
}  # fmt: skip
"""Every field of a material, by name."""


def as_field(name: str, value: Any, grid: tuple[int, int], time: float = 0.0) -> np.ndarray:
    """A weight on the grid, as the kernels order it.

    A list on another grid than the tube's is resampled, linearly along s (its ends are the object's) and, where it has
    rows, around x (which closes on itself). A list of as many values as the grid has is taken value by value; where values
    belong to edges along s, N_s - 1 of them will do.

    Args:
        name: of the weight, a key of `PLACES`.
        value: see `material.Weight`.
        grid: nodes around, nodes along.
        time: of the solver.

    Returns:
        shape (N_s,), or (N_s, N_x) for weights of the tube; float64.

    Raises:
        ValueError: its text says what is wanted.
    """
    place, (nx, ns) = PLACES[name], grid
    if callable(value):
        value = value(time)
    if isinstance(value, Mapping):
        return _at_time(name, value, grid, time)
    wanted = "a finite number, a list of them along s" + (", N_x such lists" if place.sheet else "")
    wanted += ", or { times = [...], values = [...] }"
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf" or array.size == 0 or array.ndim > 1 + place.sheet:
            raise ValueError
        array = array.astype(float)
    except (TypeError, ValueError):
        raise ValueError(wanted) from None
    if not np.isfinite(array).all():
        raise ValueError(wanted)
    if not (array.min() >= place.low and array.max() <= MOST):
        raise ValueError(f"from {place.low:g} to {MOST:g}")
    if array.ndim == 2:
        return _around(_along(array, ns, place.edge_s), nx, place.edge_x).T
    line = _along(np.atleast_1d(array), ns, place.edge_s)
    return np.repeat(line[:, None], nx, axis=1) if place.sheet else line


def _at_time(name: str, table: Mapping[str, Any], grid: tuple[int, int], time: float) -> np.ndarray:
    wanted = "{ times = [...], values = [...] } with "
    times, values = table.get("times"), table.get("values")
    if set(table) != {"times", "values"} or not all(isinstance(v, list | tuple | np.ndarray) for v in (times, values)):
        raise ValueError(wanted + "these two lists alone")
    times, values = [list(v) for v in (times, values)]  # pyright: ignore
    if len(times) != len(values) or not times:
        raise ValueError(wanted + "a value for each time")
    if any(isinstance(v, Mapping) or callable(v) for v in values):
        raise ValueError(wanted + "numbers or lists as values")
    when = np.array([t if isinstance(t, int | float) else np.nan for t in times], float)
    if not (np.isfinite(when).all() and np.all(np.diff(when) > 0)):
        raise ValueError(wanted + "finite times that rise")
    fields = [as_field(name, v, grid) for v in values]
    after = int(np.searchsorted(when, time, side="right"))
    if after in (0, len(when)):
        return fields[min(after, len(when) - 1)]
    share = (time - when[after - 1]) / (when[after] - when[after - 1])
    return (1 - share) * fields[after - 1] + share * fields[after]


def _along(values: np.ndarray, ns: int, edge: bool) -> np.ndarray:
    """Values along the last axis on ns nodes, or on their edges."""
    m = values.shape[-1]
    if m == ns:
        return values
    if edge and m == ns - 1:
        return np.concatenate([values, values[..., -1:]], axis=-1)
    want = np.minimum((np.arange(ns) + 0.5 * edge) / (ns - 1), 1.0)
    if m == 1:
        return np.repeat(values, ns, axis=-1)
    return np.apply_along_axis(lambda v: np.interp(want, np.linspace(0, 1, m), v), -1, values)


def _around(values: np.ndarray, nx: int, edge: bool) -> np.ndarray:
    """Values along the first axis, periodic, on nx nodes, or on their edges."""
    m = len(values)
    if m == nx:
        return values
    want = (np.arange(nx) + 0.5 * edge) / nx
    return np.apply_along_axis(lambda v: np.interp(want, np.arange(m) / m, v, period=1.0), 0, values)


def depends_on_time(value: Any) -> bool:
    """Whether a weight is a function of time."""
    return callable(value) or isinstance(value, Mapping)


Cut = tuple[int, bool]
"""A discontinuity at ring k: (k, False) a crease at it, (k, True) a gap between it and the next."""


def cuts(tension: np.ndarray, rigidity: np.ndarray) -> list[Cut]:
    """Discontinuities of a line by its weights (section 3), each shape (n,): of edges, of nodes.

    Rigidity 0 at one node leaves a crease; at two in a row, a gap if the edge between has no tension. More in a row are
    a limp stretch and not a discontinuity.
    """
    n, found = len(rigidity), []
    limp = rigidity == 0
    k = 1
    while k < n - 1:
        if not limp[k]:
            k += 1
            continue
        end = k
        while end < n - 1 and limp[end]:
            end += 1
        if k > 1 and end < n - 1 and end - k <= 2:
            torn = end - k == 2 and tension[k] == 0
            found += [(k, True)] if torn else [(j, False) for j in range(k, end)]
        k = end
    return found


def pieces(n: int, found: Sequence[Cut]) -> list[tuple[int, int]]:
    """First and last ring of each piece of a line of n rings; pieces on both sides of a crease share its ring."""
    out, first = [], 0
    for k, gap in sorted(found):
        out.append((first, k))
        first = k + gap
    return [*out, (first, n - 1)]


def bounds(n: int, found: Sequence[Cut]) -> tuple[np.ndarray, np.ndarray]:
    """How far each ring may look back and ahead: first and last ring, shape (n,); a crease's ring looks to both sides."""
    at = np.arange(n)
    first, last = np.zeros(n, np.int32), np.full(n, n - 1, np.int32)
    for k, gap in found:
        first = np.where(at > k, np.maximum(first, k + gap), first)
        last = np.where(at < k + gap, np.minimum(last, k), last)
    return first.astype(np.int32), last.astype(np.int32)


def joined(*several: Sequence[Cut]) -> list[Cut]:
    """Discontinuities of any of several lines; a crease beside a gap goes."""
    every = {cut for each in several for cut in each}
    beside = {j for k, gap in every if gap for j in (k, k + 1)}
    return sorted((k, gap) for k, gap in every if gap or k not in beside)


def break_ring(b: Break, ns: int) -> int:
    """The ring of ns that a crease lies at, or the first of the two that a gap lies between."""
    gap = b.order == "position"
    return int(np.clip(np.floor(share(b) * (ns - 1) + (0.0 if gap else 0.5)), 2, ns - 3 - gap))


def marks(breaks: Sequence[Break], ns: int) -> list[tuple[float, float]]:
    """Where breaks lie among ns rings, and at which share of the axis' length, as `initial.initial_tube` takes them."""
    return [(break_ring(b, ns) + 0.5 * (b.order == "position"), share(b)) for b in breaks]


def share(b: Break) -> float:
    """Share of the axis' length at a break.

    Raises:
        ValueError: it is given by a point, which only a view can turn into a share.
    """
    if not isinstance(b.at, int | float):
        raise ValueError("a break without an image needs the share of the axis' length where it is")
    return float(b.at)
