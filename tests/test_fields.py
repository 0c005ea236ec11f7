"""Weights as fields: what a user may give, discontinuities read off zeros, and what a change costs."""

from typing import Any

import numpy as np
import pytest

from symseek.sim import fields
from symseek.sim.body import Body
from symseek.sim.material import Break, Material
from symseek.sim.problem import Settings, Tube
from symseek.sim.solvers import SCHEMES, adi, make_solver
from tests import reference
from tests.rig import Rig, circles, even_spine

GRID = (8, 11)
S = np.linspace(0, 1, 11)


def test_a_number_or_a_list_fills_the_grid():
    np.testing.assert_array_equal(fields.as_field("w2", 3, GRID), np.full(11, 3.0))
    np.testing.assert_array_equal(fields.as_field("w02", 3, GRID), np.full((11, 8), 3.0))
    along = list(range(11))
    np.testing.assert_array_equal(fields.as_field("w2", along, GRID), along)
    np.testing.assert_array_equal(fields.as_field("w1", along, GRID), along)  # value k: the edge from k to k + 1
    np.testing.assert_array_equal(fields.as_field("w1", along[:10], GRID)[:10], along[:10])
    np.testing.assert_array_equal(fields.as_field("w02", along, GRID), np.repeat(np.arange(11.0)[:, None], 8, axis=1))
    rows = np.arange(88.0).reshape(8, 11)
    np.testing.assert_array_equal(fields.as_field("w20", rows, GRID), rows.T)


def test_lists_on_another_grid_are_linear_along_and_periodic_around():
    middle = S[:-1] + 0.05
    np.testing.assert_allclose(fields.as_field("w2", [0, 1, 0], GRID), 1 - np.abs(2 * S - 1))
    np.testing.assert_allclose(fields.as_field("w1", [0, 1, 0], GRID)[:-1], 1 - np.abs(2 * middle - 1))
    rows = [[0.0], [1.0]]  # at x = 0 and x = 1/2
    x = np.arange(8) / 8
    np.testing.assert_allclose(fields.as_field("w20", rows, GRID)[3], 1 - np.abs(2 * x - 1))
    np.testing.assert_allclose(fields.as_field("w10", rows, GRID)[3], 1 - np.abs(2 * (x + 1 / 16) - 1))


def test_functions_of_time():
    table = {"times": [10, 20], "values": [1.0, [3.0, 5.0]]}
    for time, expected in ((0, 1 + 0 * S), (10, 1 + 0 * S), (15, 2 + S), (20, 3 + 2 * S), (99, 3 + 2 * S)):
        np.testing.assert_allclose(fields.as_field("w2", table, GRID, time), expected)
    np.testing.assert_allclose(fields.as_field("w2", lambda t: [t, 2 * t], GRID, 4.0), 4 + 4 * S)


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("w2", "soft", "a finite number"),
        ("w2", True, "a finite number"),
        ("w2", None, "a finite number"),
        ("w2", float("nan"), "a finite number"),
        ("w2", [], "a finite number"),
        ("w2", [1.0, "a"], "a finite number"),
        ("w2", [[1.0, 2.0]], "a finite number"),
        ("w02", [[1.0, 2.0], [3.0]], "N_x such lists"),
        ("w02", np.ones((2, 2, 2)), "N_x such lists"),
        ("w2", [1.0, -1.0], "from 0 to 1e"),
        ("c", 1e7, "from -1e"),
        ("w2", {"times": [1, 2]}, "these two lists"),
        ("w2", {"times": 1, "values": 2}, "these two lists"),
        ("w2", {"times": [1, 2], "values": [1]}, "a value for each time"),
        ("w2", {"times": [], "values": []}, "a value for each time"),
        ("w2", {"times": [2, 1], "values": [1, 2]}, "times that rise"),
        ("w2", {"times": [1, "b"], "values": [1, 2]}, "times that rise"),
        ("w2", {"times": [1], "values": [{"times": [1], "values": [1]}]}, "numbers or lists"),
        ("w2", {"times": [1, 2], "values": [1, -2]}, "from 0"),
    ],
)
def test_what_does_not_fit(name, value, wanted):
    with pytest.raises(ValueError, match=wanted):
        fields.as_field(name, value, GRID)
    with pytest.raises(ValueError, match=rf"material.{name}: .*{wanted}"):
        _body().material(**{name: value})
    with pytest.raises(ValueError, match=rf"material.{name}: .*{wanted}"):
        _body(Material(**{name: value}))


def test_changes_that_nothing_knows():
    with pytest.raises(ValueError, match=r"material.closed is not a weight"):
        _body().material(closed=False)
    with pytest.raises(ValueError, match=r"material.w3 is not a weight"):
        _body().material(w3=1.0)


def test_zeros_are_cuts():
    """One limp node is a crease, two with no tension between a gap, two with tension two creases, more none."""
    n, stiff, none = 15, np.ones(15), np.zeros(15)

    def found(*zeros, tension=none):
        return fields.cuts(tension, np.where(np.isin(np.arange(n), zeros), 0, stiff))

    assert found() == [] and found(7) == [(7, False)] and found(7, 8) == [(7, True)]
    assert found(7, 8, tension=stiff) == [(7, False), (8, False)]
    assert found(3, 4, 9) == [(3, True), (9, False)] and found(5, 6, 7) == [] and found(*range(n)) == []
    assert found(0) == found(1) == found(0, 1) == found(13) == found(13, 14) == []  # ends are free anyway


def test_pieces_and_how_far_rings_look():
    cuts = [(3, False), (6, True)]
    assert fields.pieces(10, cuts) == [(0, 3), (3, 6), (7, 9)]
    first, last = fields.bounds(10, cuts)
    assert first.tolist() == [0, 0, 0, 0, 3, 3, 3, 7, 7, 7]
    assert last.tolist() == [3, 3, 3, 6, 6, 6, 6, 9, 9, 9]


def _body(material=None, breaks=(), grid=(12, 17), **settings):
    tube = Tube(np.array([[0, 0, 0], [0, 1.0, 0]]), radius=0.1, grid=grid, material=material or Material(), breaks=breaks)
    return Body([tube], Settings(**settings))


@pytest.mark.parametrize("order", ["position", "tangent"])
@pytest.mark.parametrize("of", ["both", "tube", "spine"])
def test_a_break_is_written_as_zeros(order, of):
    """Of 17 rings that at .53: a crease at the 8th node, or a gap between it and the next; nowhere else."""
    body = _body(Material(w1=1.0, w01=1.0, w11=1e-8, k01=1.0, L01=1.0), (Break(0.53, order, of),))
    m, gap = body._fabric.model, order == "position"
    zero = {name: np.flatnonzero(getattr(m, name).numpy().reshape(17, -1).max(axis=1) == 0).tolist()
            for name in ("w1", "w2", "k1", "w01", "w02", "w11", "w10", "w20")}  # fmt: skip
    stretch = np.flatnonzero(m.stretch01.numpy().reshape(17, 12, 3)[..., 0].max(axis=1) == 0).tolist()
    nodes, edges = ([8, 9], [8]) if gap else ([8], [])
    spine, tube = of != "tube", of != "spine"
    assert zero["w2"] == nodes * spine and zero["w1"] == zero["k1"] == edges * spine
    assert zero["w02"] == nodes * tube and zero["w01"] == zero["w11"] == stretch == edges * tube
    assert len(zero["w10"]) == 17 and zero["w20"] == []
    np.testing.assert_array_equal(m.ring_last.numpy()[[0, 16]], [8 if tube else 16, 16])
    np.testing.assert_array_equal(m.spine_first.numpy()[[0, 16]], [0, (9 if gap else 8) if spine else 0])


def _at_rest(what, scheme, w1, w2, target, tied):
    """Spine, or centres of rings, on springs to rings, or a spine, that are held at `target`, in the end, (ns, 3)."""
    ns, nx = len(target), 8
    held = circles(target, 0.1, nx)
    given: dict[str, Any] = {"w1": w1, "w2": w2, "a": tied, "spine_curvature": [1.0, 0.0]}
    if what == "tube":
        given = {"w01": np.repeat(w1, nx), "w02": np.repeat(w2, nx), "reaction": tied}
    rig = Rig((circles(even_spine(ns), 0.1, nx), even_spine(ns)), **given)
    solver = make_solver(scheme, rig.model, None, None, 0.0)
    for _ in range(1500):
        if what == "tube":
            rig.state.spine.assign(target.astype(np.float32))
        else:
            rig.state.tube.assign(held.reshape(-1, 3).astype(np.float32))
        rig.forces()
        solver.step(rig.state)
    return rig.tube().mean(axis=1) if what == "tube" else rig.spine()


@pytest.mark.parametrize("what", ["tube", "spine"])
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("order", ["tangent", "position"])
def test_zero_weights_leave_one_kink_or_gap_and_no_other(what, scheme, order):
    """Rings, or a spine, drawn to a line with a kink (a jump) at s0: taken whole with weights 0 there, else rounded off.

    Against (M a + K) c = M a target.
    """
    ns, at, tied = 15, 7, 0.5
    s = np.linspace(0, 1, ns)
    target = even_spine(ns)
    target[:, 0] += 0.4 * np.maximum(s - s[at], 0) if order == "tangent" else 0.1 * (s > s[at])
    mass = reference.end_mass(ns)
    for broken in (False, True):
        w01, w02 = np.full(ns, 3e-3), np.full(ns, 1e-5)
        if order == "tangent":
            w01[:] = 0
        if broken:
            w02[at : at + 1 + (order == "position")] = 0
            w01[at] = 0
        centres = _at_rest(what, scheme, w01, w02, target, tied)
        stiff = np.diag(mass * tied) + reference.open_stiffness(w01, w02)
        expected = np.linalg.solve(stiff, tied * mass[:, None] * target)
        np.testing.assert_allclose(centres, expected, atol=2e-5)
        off = np.abs(centres - target)[:, 0]
        if broken and order == "tangent":
            assert off.max() < 2e-5  # straight pieces have no force at all
        elif broken:
            assert off.max() < 2e-5 and np.abs(np.diff(centres[:, 0])[at] - 0.1) < 2e-5
        else:
            assert off.max() > 2e-3


def _counted(monkeypatch):
    """Which matrices are factored from now on: rows of rings, and of lines along s by their number."""
    seen = []
    for name in ("factor_cyclic", "factor_open"):
        real = getattr(adi, name)
        monkeypatch.setattr(adi, name, lambda d, f, s, real=real, name=name: (seen.append((name, len(d))), real(d, f, s))[1])
    return seen


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"w2": 1e-5}, [("factor_open", 1)]),
        ({"k1": 0.1}, [("factor_open", 1)]),
        ({"C2": 1.0}, []),
        ({"w02": 1e-6}, [("factor_open", 12), ("factor_open", 1), ("factor_open", 1)]),
        ({"w20": 2e-4}, [("factor_cyclic", 17)]),
        ({"C20": 2.0}, [("factor_cyclic", 17), ("factor_open", 12), ("factor_open", 1), ("factor_open", 1)]),
        ({"C11": 2.0}, []),
        ({"c": 0.1}, []),
        ({"d": 0.1}, []),
        ({"reaction": 0.2}, [("factor_open", 1), ("factor_open", 1)]),
        ({"w2": 3e-6}, []),  # what it was
    ],
)
def test_only_what_changed_is_factored_again(monkeypatch, change, expected):
    body = _body()
    body.step()
    seen = _counted(monkeypatch)
    body.step(25)
    assert seen == []
    body.material(**change)
    body.step(25)
    assert seen == expected


def test_nothing_is_looked_at_while_nothing_depends_on_time(monkeypatch):
    body = _body()
    body.step()
    monkeypatch.setattr(body._fabric.weights, "write", lambda *_: pytest.fail("looked"))
    body.step(25)


FINAL = {"w02": np.linspace(1e-6, 3e-6, 17), "w2": 1e-5, "k01": 0.05, "L01": 1.3, "k10": 0.05, "L10": 2 * np.pi * 0.13}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_run_whose_weights_change_ends_where_a_fresh_one_does(scheme):
    open_ = Material(closed=False)
    changed, fresh = _body(open_, scheme=scheme), _body(Material(closed=False, **FINAL), scheme=scheme)
    changed.step(50)
    changed.material(**FINAL)
    for body in (changed, fresh):
        assert body.rest(most=40000), scheme
    np.testing.assert_allclose(changed.tube(), fresh.tube(), atol=3e-4)
    assert np.ptp(fresh.tube()[:, :, 1]) > 1.25
    assert changed.time > 50 * changed._loop.solver.dt > 0


def test_weights_over_time_end_at_the_last_ones():
    """Growth along written as a table; the run does not stop before its last time, though it rests before."""
    length = {"times": [0, 40, 80], "values": [1.0, 1.0, 1.4]}
    body = _body(Material(closed=False, k01=0.05, L01=length))
    assert body.rest() and body.time >= 80
    assert abs(np.ptp(body.tube()[0, :, 1]) - 1.4) < 0.014
    live = _body(Material(closed=False, k01=0.05, L01=lambda t: min(1.4, 1 + t / 100)))
    live.step(400)
    assert abs(np.ptp(live.tube()[0, :, 1]) - 1.4) < 0.014
