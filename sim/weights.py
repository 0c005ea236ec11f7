"""Materials of all tubes as the model's arrays: written, changed while a run goes on, and refreshed over time."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .fields import PLACES, Cut, as_field, bounds, break_ring, cuts, depends_on_time
from .material import Break, Material
from .model import BEND_DEGREE, Model, bend_basis

COUPLING = ("a", "reaction", "b", "c", "balance", "d", "centre", "depth", "free")
"""Columns of `Model.coupling`, by name."""
FREED = 1.5
"""Power of the share with which w20 and b fall where the views tell sections."""
TOLD_SHARE = 0.1
"""Most of the share of w2 where the views tell sections."""
FLAT = 0.05
"""Least |dv| for the tension of natural curvatures; rings near a pole are smaller."""


class Weights:
    """Hands the materials of all tubes to the model.

    Attributes:
        materials: of each tube, as they are now.
        share: of the rigidities w2 and w02, which falls with sigma (continuation).
        stiffer: of each tube, what w02 has more at the coarsest scale; it falls with the square of `share`.
        cuts: discontinuities of each tube and of each spine, lists over tubes.
        stale: whether a material was changed since the last `write`.
        told: whether the views tell each tube's depth, so that nothing need hold it.
        untold: how much of its sections they leave to symmetry (`sights.untold`), a number or shape (N_s,) each.
    """

    def __init__(self, model: Model, materials: Sequence[Material], breaks: Sequence[Sequence[Break]]):
        self.model, self.materials = model, list(materials)
        self.breaks: list[Sequence[Break]] = list(breaks)
        for k, material in enumerate(materials):
            for name in PLACES:
                check(name, getattr(material, name), model.grids[k])
        self.share, self.stale, self._timed = 1.0, True, self._any_timed()
        self.told = [model.views != 1] * len(materials)
        self.untold: list[float | np.ndarray] = [1.0] * len(materials)
        self.stiffer = [0.0] * len(materials)
        self.cuts: list[list[Cut]] = [[] for _ in materials]
        self.spine_cuts: list[list[Cut]] = [[] for _ in materials]
        self._host: dict[str, np.ndarray] = {}
        self._lasting: dict[int, dict[str, Any]] = {}

    def change(self, k: int, values: Mapping[str, Any]) -> None:
        """Changes weights of tube k, from the next `write` on.

        Raises:
            ValueError: no such weight, or a value that does not fit; the message names it.
        """
        for name, value in values.items():
            if name not in PLACES:
                raise ValueError(f"material.{name} is not a weight that can change: known are {', '.join(PLACES)}")
            check(name, value, self.model.grids[k])
        self.materials[k] = dataclasses.replace(self.materials[k], **values)
        self._timed, self.stale = self._any_timed(), True

    @property
    def timed(self) -> bool:
        """Whether any weight is a function of time."""
        return self._timed or any(b.time > 0 for own in self.breaks for b in own)

    def _any_timed(self) -> bool:
        return any(depends_on_time(getattr(m, name)) for m in self.materials for name in PLACES)

    def settled(self, time: float) -> bool:
        """Whether every change that is written down with its time lies before `time`; functions nobody can foresee."""
        tables = (getattr(m, name) for m in self.materials for name in PLACES)
        ends = [v["times"][-1] for v in tables if isinstance(v, Mapping)]
        return time >= max([*ends, *(b.time for own in self.breaks for b in own)], default=0.0)

    def write(self, time: float, tube: np.ndarray, spine: np.ndarray) -> set[str]:
        """Writes what has changed into the model.

        Args:
            time: of the solver.
            tube, spine: nodes now, shape (N, 3), (R, 3): tension of natural lengths is held where an edge is stretched
                beyond its natural length by more than this or by as much as it is long now (`kernels.elastic.stretch`).

        Returns:
            Names of the model's arrays, and of the columns of `coupling`, that are not as they were.
        """
        m = self.model
        fresh = {n: np.zeros(m.nodes) for n in ("w10", "w20", "w11", "w01", "w02", "mu", "gamma", "bound10", "bound01")}
        fresh |= {n: np.zeros((m.nodes, 3)) for n in ("stretch10", "stretch01", "curvature")}
        fresh |= {n: np.zeros(m.rings) for n in ("w1", "w2", "k1", "spine_mu", "spine_gamma", "bound1", "guide")}
        fresh |= {"spine_stretch": np.tile([-1.0, 0.0], (m.rings, 1)), "spine_curvature": np.zeros((m.rings, 2))}
        fresh |= {"bend_basis": np.zeros((m.rings, BEND_DEGREE + 1))}
        looks = ("ring_first", "ring_last", "spine_first", "spine_last", "look_first", "look_last")
        fresh |= {n: np.zeros(m.rings, np.int32) for n in looks}
        coupling, uneven = np.zeros((m.rings, len(COUPLING))), False
        for k, (nx, ns) in enumerate(m.grids):
            nodes, rings = m.nodes_of(k), m.rings_of(k)
            f = self._fields(k, time)
            self.cuts[k] = cuts((f["w01"] + f["k01"]).max(axis=1), f["w02"].max(axis=1))
            self.spine_cuts[k] = cuts(f["w1"] + (0 if f["L1"] is None else f["k1"]), f["w2"])
            for at, gap in self.spine_cuts[k]:
                f["k1"][at] *= not gap
            freed = np.broadcast_to(self.share ** (FREED * (1 - self.untold[k])), ns)
            f["w20"], f["b"] = f["w20"] * freed[:, None], f["b"] * freed
            # a stiff spine would straighten, and by that roll up, what views all around hold less firmly than one does
            spine_share = np.minimum(self.share, np.broadcast_to(TOLD_SHARE ** (1 - self.untold[k]), ns))
            share = np.full((ns, 1), self.share)
            for at, gap in self.cuts[k]:
                if gap:  # what carries a rim on straight
                    share[[at - 1, at + 2]] = 1.0
            for name in ("w10", "w20", "w11", "w01", "w02", "mu", "gamma"):
                fresh[name][nodes] = (f[name] * (share if name == "w02" else 1.0)).reshape(-1)
            fresh["w02"][nodes] += self.share**2 * self.stiffer[k] * (fresh["w02"][nodes] > 0)
            for name in ("w1", "w2", "k1"):
                fresh[name][rings] = f[name] * (spine_share if name == "w2" else 1.0)
            for name in ("mu", "gamma"):
                fresh["spine_" + name][rings] = _mean(f[name])
            own, line = tube[nodes].reshape(ns, nx, 3), spine[rings]
            around = nx * np.linalg.norm(np.roll(own, -1, axis=1) - own, axis=2)
            along = (ns - 1) * np.linalg.norm(np.diff(own, axis=0, append=own[-1:]), axis=2)
            turning = _turning(own, f)
            for edge, now in (("10", around), ("01", along)):
                bound = 2 * turning / np.maximum(now, FLAT) ** 2
                if f["L" + edge] is not None:
                    stretch, steepest = _stretch(f["k" + edge], f["L" + edge], now)
                    fresh["stretch" + edge][nodes] = stretch.reshape(-1, 3)
                    bound += steepest
                fresh["bound" + edge][nodes] = _rounded_up(bound).reshape(-1)
            for column, name in enumerate(("C20", "C11", "C02")):
                if f[name] is not None:
                    fresh["curvature"][nodes, column] = f[name].reshape(-1)
            if f["L1"] is not None:
                now = (ns - 1) * np.linalg.norm(np.diff(line, axis=0, append=line[-1:]), axis=1)
                stretch, steepest = _stretch(f["k1"], f["L1"], now)
                fresh["spine_stretch"][rings], fresh["bound1"][rings] = stretch[:, 1:], _rounded_up(steepest)
            if f["C2"] is not None:
                fresh["spine_curvature"][rings] = np.stack([np.ones(ns), f["C2"]], axis=1)
            fresh["ring_first"][rings], fresh["ring_last"][rings] = bounds(ns, self.cuts[k])
            fresh["spine_first"][rings], fresh["spine_last"][rings] = bounds(ns, self.spine_cuts[k])
            gaps = [cut for cut in self.spine_cuts[k] if cut[1]]
            fresh["look_first"][rings], fresh["look_last"][rings] = bounds(ns, gaps)
            fresh["bend_basis"][rings] = bend_basis(ns, self.spine_cuts[k])
            lap = (2 * np.sin(np.pi / nx) * nx) ** 2
            cancelled, varies = f["c_balance"] * (f["C20"] is None), np.ptp(f["w20"], axis=1) > 0
            f["free"] = cancelled * varies
            # by the least w10 of a ring: what pushes it is then nowhere more than what draws it together
            f["balance"] = f["c_balance"] * f["w10"].min(axis=1) * lap + (cancelled - f["free"]) * f["w20"][:, 0] * lap**2
            f["reaction"] = f["a"] * f["reaction"]
            uneven |= bool(f["free"].any())
            if self.told[k] and not self.spine_cuts[k]:
                fresh["guide"][rings] = f["depth"]
            f["depth"] = f["depth"] * (not self.told[k])
            coupling[rings] = np.stack([f[name] for name in COUPLING], axis=1)
        changed = {name for name, value in fresh.items() if self._assign(name, value)}
        before = self._host.get("coupling", np.full(coupling.shape, np.nan, np.float32))
        if self._assign("coupling", coupling):
            now = self._host["coupling"]
            changed |= {name for i, name in enumerate(COUPLING) if not np.array_equal(before[:, i], now[:, i])}
        m.shaped = any(np.any(fresh[n][:, 0] > 0) for n in ("stretch10", "stretch01")) or bool(fresh["curvature"].any())
        m.torn, m.uneven = any(gap for found in self.cuts for _, gap in found), uneven
        m.tense, m.twisted = bool(fresh["w10"].any() or fresh["w01"].any()), bool(fresh["w11"].any())
        self.stale = False
        return changed

    def _fields(self, k: int, time: float) -> dict[str, Any]:
        """All fields of tube k, discontinuities written in as zeros; None where a natural shape is not given."""
        if self.stale or self.timed:
            self._lasting.clear()
        if k not in self._lasting:
            self._lasting[k] = self._made(k, time)
        return {name: None if field is None else field.copy() for name, field in self._lasting[k].items()}

    def _made(self, k: int, time: float) -> dict[str, Any]:
        grid = self.model.grids[k]
        values = {name: getattr(self.materials[k], name) for name in PLACES}
        f: dict[str, Any] = {n: None if v is None else as_field(n, v, grid, time).copy() for n, v in values.items()}
        for b in self.breaks[k]:
            if time < b.time:
                continue
            gap = b.order == "position"
            at = break_ring(b, grid[1])
            zeros: list[str] = []
            if b.of != "tube":
                f["w2"][at : at + 1 + gap] = 0
                zeros += ["w1", "k1"]
            if b.of != "spine":
                f["w02"][at : at + 1 + gap] = 0
                zeros += ["w01", "k01", "w11"]
            for name in zeros if gap else []:
                f[name][at] = 0
        return f

    def _assign(self, name: str, value: np.ndarray) -> bool:
        """Hands an array to the model if it differs from what the model has."""
        value = value if value.dtype == np.int32 else value.astype(np.float32)
        if name in self._host and np.array_equal(self._host[name], value):
            return False
        self._host[name] = value
        getattr(self.model, name).assign(value)
        return True


def check(name: str, value: Any, grid: tuple[int, int]) -> None:
    """Raises ValueError where a weight's value does not fit; the message names both."""
    if value is None and getattr(Material, name) is None:
        return
    try:
        as_field(name, value, grid)
    except ValueError as wanted:
        text = " ".join(repr(value).split())[:60]
        raise ValueError(f"material.{name}: {text} does not fit; it must be {wanted}") from None


def _stretch(factor: np.ndarray, length: np.ndarray, now: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """K, L and most of |dv| - L for each edge, shape (..., 3), and the steepest that K (|dv| - L) |dv| can become."""
    most = np.maximum(length, now)
    return np.stack([factor, length, most], axis=-1), factor * (length + 2 * most)


def _rounded_up(bound: np.ndarray) -> np.ndarray:
    """To the next of eight steps an octave: matrices need no more, and so are not made anew for every little growth."""
    return np.where(bound > 0, 2 ** (np.ceil(8 * np.log2(np.maximum(bound, 1e-30))) / 8), 0.0)


def _turning(v: np.ndarray, f: Mapping[str, Any]) -> np.ndarray:
    """w C |q| of natural curvatures C at each node, q the second derivative or C itself if that is larger, (ns, nx).

    As the normal turns by u' / |v'| this adds w C |q| (u' / |v'|)^2 to the energy: a tension.
    """
    ns, nx = v.shape[:2]
    around = nx**2 * np.linalg.norm(np.roll(v, -1, axis=1) - 2 * v + np.roll(v, 1, axis=1), axis=2)
    along = np.zeros((ns, nx))
    along[1:-1] = (ns - 1) ** 2 * np.linalg.norm(np.diff(v, 2, axis=0), axis=2)
    out = np.zeros((ns, nx))
    for weight, natural, now in (("w20", "C20", around), ("w02", "C02", along)):
        if f[natural] is not None:
            out += f[weight] * np.abs(f[natural]) * np.maximum(np.abs(f[natural]), now)
    return out


def _mean(values: np.ndarray) -> np.ndarray:
    """Mean around each ring, shape (ns,); of equal values their value to the bit."""
    return values[:, 0] + (values - values[:, :1]).mean(axis=1)
