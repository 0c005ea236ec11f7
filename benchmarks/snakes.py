"""Snakes beside scikit-image's `active_contour`: contour error, time, and what the number of nodes changes.

`python -m benchmarks.snakes [--quick] [--out FILE.md]`. The peer is given its best: for each image its weights are chosen
from a list by the true error at 100 nodes, where ours are the defaults; on the smoothed image, as its documentation has
it, and "helped", on a picture that we made for it, the logarithm of its edges, whose pull reaches far and does not depend
on contrast. 50 and 400 nodes get the same weights. Curves begin as rough polygons about 10 % outside. Errors are
distances between the smooth curve and the true outline; times are seconds of CPU, of all threads.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, gaussian_gradient_magnitude
from scipy.spatial import cKDTree
from skimage.segmentation import active_contour

from symseek.cli import demos
from symseek.sim.curve import evenly
from symseek.sim.problem import Snake, View
from symseek.sim.snake import deform

from .tables import as_text, command

RADIUS, SIZE, MIDDLE = 50.0, 200, (101.3, 98.7)
NODES = (50, 100, 400)
DENSE = 60_000
"""Points of a curve to which distances are measured."""
PLAIN = {"alpha": (0.0005, 0.002, 0.01, 0.015), "beta": (0.02, 0.1, 1.0, 10.0), "gamma": (0.001, 0.01), "sigma": (1.0, 3.0)}
"""Weights tried on the smoothed image; the function's own defaults and its documentation's example are among them."""
LOGGED = {"alpha": (0.0005, 0.002, 0.02, 0.2), "beta": (0.02, 0.1, 1.0), "gamma": (0.1, 0.3), "sigma": (2.0, 4.0)}


@dataclass(frozen=True)
class Case:
    """An image, its true outline (m, 2) as a dense curve, and a rough polygon (n, 2)."""

    name: str
    image: np.ndarray
    truth: np.ndarray
    start: np.ndarray


def disc(noise: float = 0.01, seed: int = 0) -> np.ndarray:
    """A grey disc, by 8 x 8 points a pixel, shape (SIZE, SIZE)."""
    fine = (np.arange(8 * SIZE) + 0.5) / 8 - 0.5
    inside = np.hypot(fine - MIDDLE[0], fine[:, None] - MIDDLE[1]) < RADIUS
    cover = inside.reshape(SIZE, 8, SIZE, 8).mean(axis=(1, 3))
    return (0.1 + 0.8 * cover + noise * np.random.default_rng(seed).standard_normal(cover.shape)).astype(np.float32)


def cases() -> list[Case]:
    """The disc of radius 50 px, and the pear of the demo."""
    angle = 2 * np.pi * np.arange(4000) / 4000
    circle = np.array(MIDDLE) + RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rough = np.random.default_rng(1)
    out = [Case("disc", disc(), circle, _rough(circle, rough))]
    folder = demos()["snake"].parent
    image = np.asarray(Image.open(folder / "still_life.jpg"), np.float32) / 255
    pear = np.load(folder / "truth.npz")["pear"]
    return [*out, Case("pear", image, evenly(pear[::6], 4000, True), _rough(pear, rough))]


def _rough(outline: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    points = outline[np.linspace(0, len(outline), 14, endpoint=False).astype(int)]
    size = np.ptp(outline, axis=0).mean()
    return points.mean(axis=0) + 1.1 * (points - points.mean(axis=0)) + 0.02 * size * rng.standard_normal(points.shape)


def ours(case: Case, nodes: int) -> np.ndarray:
    """Smooth curve, shape (m, 2)."""
    return deform([View(case.image)], [Snake(case.start, nodes=nodes)]).objects[0].contour[0]


def peer(case: Case, nodes: int, logged: bool, sigma: float, **weights: float) -> np.ndarray:
    """The same by scikit-image, through its nodes by the same spline."""
    grey = case.image if case.image.ndim == 2 else case.image.mean(axis=2)
    line = np.concatenate([case.start, case.start[:1]])
    t = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    want = np.linspace(0, t[-1], nodes, endpoint=False)
    start = np.stack([np.interp(want, t, line[:, i]) for i in (1, 0)], axis=1)
    if logged:
        edges = gaussian_gradient_magnitude(grey, sigma, mode="nearest")
        picture, pull = np.log(edges / edges.max() + 0.03), {"w_line": 1, "w_edge": 0}
    else:
        picture, pull = gaussian_filter(grey, sigma, mode="nearest"), {"w_line": 0, "w_edge": 1}
    end = active_contour(picture, start, max_num_iter=2500, convergence=0.02, **pull, **weights)
    return evenly(end[:, ::-1], 8 * nodes, True)


def error(curve: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Mean and largest distance of a curve (m, 2) from a dense outline [px], both ways."""
    # points of the one beside points of the other lie at most 1/100 px off where they are nearest
    there = cKDTree(evenly(truth[::10], DENSE, True)).query(curve)[0]
    back = cKDTree(evenly(curve[:-1:4], DENSE, True)).query(truth)[0]
    return float((there.mean() + back.mean()) / 2), float(max(there.max(), back.max()))


def chosen(case: Case, logged: bool, quick: bool) -> dict[str, float]:
    """The peer's weights of least true error at 100 nodes."""
    grid = LOGGED if logged else PLAIN
    choices = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    return min(choices[:: 5 if quick else 1], key=lambda weights: error(peer(case, 100, logged, **weights), case.truth)[0])


def _timed(run: Callable[[], np.ndarray], runs: int) -> tuple[np.ndarray, float]:
    times = []
    curve = run()
    for _ in range(runs):
        began = time.process_time()
        curve = run()
        times.append(time.process_time() - began)
    return curve, float(np.median(times))


def measure(quick: bool = False) -> tuple[list[list[str]], list[str]]:
    """Table, head first, and which weights the peer took."""
    rows, notes = [["image, method", "nodes", "mean px", "max px", "CPU s", "from 400 nodes, mean px"]], []
    for case in cases():
        methods: dict[str, Callable[[int], np.ndarray]] = {"symseek": lambda n, case=case: ours(case, n)}
        for name, logged in (("active_contour", False), ("active_contour, helped", True)):
            weights = chosen(case, logged, quick)
            notes.append(f"{name} on the {case.name}: " + ", ".join(f"{k} {v:g}" for k, v in weights.items()))
            methods[name] = lambda n, case=case, logged=logged, weights=weights: peer(case, n, logged, **weights)
        for name, method in methods.items():
            found = {n: _timed(lambda n=n, method=method: method(n), 1 if quick else 3) for n in NODES}
            fine = evenly(found[NODES[-1]][0][:-1:4], 4000, True)
            for n, (curve, seconds) in found.items():
                mean, most = error(curve, case.truth)
                rows.append([f"{case.name}, {name}", str(n), f"{mean:.3f}", f"{most:.2f}", f"{seconds:.3f}",
                             f"{error(curve, fine)[0]:.3f}"])  # fmt: skip
    return rows, notes


def main(arguments: Sequence[str] | None = None) -> int:
    def run(quick: bool) -> Callable[[bool], str]:
        rows, notes = measure(quick)
        return lambda markdown: "\n".join([as_text(rows, markdown), "", *notes])

    return command(arguments, "snakes", "Snakes beside scikit-image's active_contour.", "fewer weights tried", run)


if __name__ == "__main__":
    sys.exit(main())
