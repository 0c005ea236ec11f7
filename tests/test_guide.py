"""Ends whose depth eyes tell badly: the course they are led along, and the pull to it."""

import numpy as np
import pytest
import warp as wp
from scipy.optimize import minimize

from symseek.kernels import depth
from symseek.sim import guide
from symseek.sim.camera import Camera
from symseek.sim.sights import stiffness

N = 17
PLACE = np.linspace(0, 1, N) - 0.05 * np.sin(2 * np.pi * np.linspace(0, 1, N))
RADIUS = np.full(N, 0.12)


def _line(depth_of) -> np.ndarray:
    return np.column_stack([100 * PLACE, np.zeros(N), depth_of(PLACE)])


def test_an_even_bend_is_its_own_course():
    spine = _line(lambda s: 3 + 20 * s - 15 * s**2)
    modes, say = guide.course(_line(lambda s: 0 * s), 100 * RADIUS, np.linspace(0.1, 1, N))
    np.testing.assert_allclose(modes @ modes.T @ (say[:, None] * spine), spine, atol=1e-8)


def test_course_minimises_what_it_says():
    """By a general minimiser on evenly spaced nodes, where the third difference over h^3 is the third derivative."""
    s = np.linspace(0, 1, N)
    spine = np.column_stack([s, 0 * s, 0 * s])
    say = np.where((s < 0.2) | (s > 0.8), 0.1, 1.0)
    modes, weight = guide.course(spine, RADIUS, say)
    v = 0.1 * np.sin(5 * s) + 0.01 * np.cos(20 * s)
    h, own = 1 / (N - 1), np.full(N, 1 / (N - 1))
    np.testing.assert_allclose(weight, say * own)
    stiff = 0.12**6 * np.append(np.append(h, np.full(N - 5, h)), h)
    cost = lambda u: (weight * (v - u) ** 2).sum() + (stiff * (np.diff(u, 3) / h**3) ** 2).sum()  # noqa: E731
    best = minimize(cost, v, method="BFGS", options={"gtol": 1e-9, "maxiter": 5000}).x
    np.testing.assert_allclose(modes @ modes.T @ (weight * v), best, atol=3e-4)


def test_ends_go_on_as_the_body_does():
    """An end that curls off into depth has next to no say, and hardly moves the body."""
    curled = _line(lambda s: 5 * s + 40 * np.maximum(s - 0.9, 0))
    say = guide.LEAST + (1 - guide.LEAST) * guide.ends(curled, 100 * RADIUS) ** 2
    modes, weight = guide.course(curled, 100 * RADIUS, say)
    led = modes @ modes.T @ (weight * curled[:, 2])
    assert abs(led[-1] - 5) < 0.5 * abs(curled[-1, 2] - 5)
    np.testing.assert_allclose(led[6:11], 5 * PLACE[6:11], atol=0.15)  # of a curl of 4
    np.testing.assert_array_equal(guide.ends(curled, 100 * RADIUS)[6:11], 1.0)
    assert guide.ends(curled, 100 * RADIUS)[[0, -1]].max() == 0.0


@pytest.mark.parametrize(("degrees", "needed"), [((-6, 6), True), ((-45, 45), False), ((0, 120, 240), False)])
def test_only_eyes_on_one_side_need_it(degrees, needed):
    eyes = [Camera(np.array([[np.cos(a), 0, -np.sin(a), 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])) for a in np.radians(degrees)]
    sights = np.array([[c.sight(np.zeros(3)) for c in eyes]])
    weak = guide.weakest(*stiffness(sights, np.ones((1, len(eyes)))))[0]
    assert (np.linalg.norm(weak) > 0.9) == needed and (np.linalg.norm(weak) == 0) != needed
    if needed:
        np.testing.assert_allclose(np.abs(weak) / np.linalg.norm(weak), [0, 0, 1], atol=1e-6)


def test_pull_acts_in_the_weak_direction_across_the_axis():
    """Force of (d d^T)(course - place) with d the weak direction less its part along the tangent; half at the ends."""
    rng = np.random.default_rng(5)
    nx, strength = 3, rng.uniform(0.1, 0.3, N)
    spine, centroid = rng.normal(size=(2, N, 3))
    tangent = rng.normal(size=(N, 3))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    weak, modes, say = rng.normal(size=(N, 3)), rng.normal(size=(N, 4)), rng.uniform(0.1, 1, N)
    course = modes @ modes.T @ (say[:, None] * spine)
    d = weak - (weak * tangent).sum(axis=1, keepdims=True) * tangent
    load = (strength * np.where(np.isin(np.arange(N), (0, N - 1)), 0.5, 1.0))[:, None]
    expected = [load * (d * (course - v)).sum(axis=1, keepdims=True) * d for v in (spine, centroid)]

    def ints(*values: int) -> wp.array:
        return wp.array(values, dtype=int)

    def vectors(a: np.ndarray) -> wp.array:
        return wp.array(a.astype(np.float32), dtype=wp.vec3)

    outputs = [wp.zeros((1, 4), dtype=wp.vec3), wp.zeros(nx * N, dtype=wp.vec3), wp.zeros(N, dtype=wp.vec3)]
    inputs = [
        ints(0), ints(N), ints(nx), ints(*range(0, nx * N, nx)), wp.array(strength.astype(np.float32), dtype=float),
        vectors(weak), wp.array(modes.astype(np.float32), dtype=float), wp.array(say.astype(np.float32), dtype=float),
        vectors(spine), vectors(centroid), vectors(tangent),
    ]  # fmt: skip
    wp.launch(depth.guide, 1, inputs=inputs, outputs=outputs)
    np.testing.assert_allclose(outputs[2].numpy(), expected[0], rtol=2e-4, atol=2e-4)
    np.testing.assert_allclose(outputs[1].numpy(), np.repeat(expected[1], nx, axis=0), rtol=2e-4, atol=2e-4)
