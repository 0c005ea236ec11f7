"""From an image and rough clicks to a surface: accuracy on one known solid, and what must not change it."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import rest, truth
from symseek.scenes.synthetic import Sample, make
from symseek.sim.assembly import Assembly, maps_of
from symseek.sim.camera import Camera
from symseek.sim.material import Material
from symseek.sim.problem import Settings, Tube, View
from symseek.sim.reconstruct import ObjectResult, reconstruct
from symseek.sim.relax import LONGEST, SNAPSHOTS, Relaxation, limit
from symseek.sim.visibility import Visibility

SIZE = 256


@pytest.fixture(scope="module")
def sample() -> Sample:
    return make(3, kind="pear", size=SIZE)


@pytest.fixture(scope="module")
def pear(sample) -> ObjectResult:
    """With all defaults."""
    return _solve(sample.image, sample.clicks)


def _solve(image, clicks, camera=None, grid=(25, 25), callback=None, material=None, **settings) -> ObjectResult:
    view = View(np.ascontiguousarray(image), camera or Camera.orthographic())
    tube = Tube(clicks, grid=grid, material=material or Material())
    result = reconstruct([view], [tube], Settings(**settings), callback=callback)
    # what "auto" chose is told
    asked = Settings(**settings)
    assert result.settings == replace(asked, scheme="adi" if asked.scheme == "auto" else asked.scheme) and set(
        result.seconds
    ) >= {"map", "solve"}
    return result.objects[0]


def _apart(a, b, sample):
    """Mean distance between two surfaces (vertices, faces), % of the object's length."""
    (v, f), (true_v, true_f) = a, b
    return truth.surface_error(v, f, true_v, true_f, sample.length)


def test_accuracy(pear, sample):
    errors = truth.compare(pear.vertices, pear.faces, sample)
    assert errors.iou > 0.985
    assert errors.surface < 0.3 and abs(errors.volume) < 2 and errors.contour < 0.3
    assert pear.converged and pear.trusted and not pear.warnings
    assert pear.measures["supported_share"] > 0.95
    assert pear.measures["length"] == pytest.approx(sample.length, rel=0.02)
    assert pear.measures["volume"] == pytest.approx(truth.volume(pear.vertices, pear.faces))


@pytest.mark.parametrize("scheme", ["sor", "direct", "jacobi"])
def test_every_scheme_finds_the_shape(pear, sample, scheme):
    found = _solve(sample.image, sample.clicks, scheme=scheme, iterations=12000)  # over-relaxation takes thousands
    assert found.converged and found.trusted
    assert _apart((found.vertices, found.faces), (pear.vertices, pear.faces), sample) < 0.1


def test_mass_ends_near_and_tells_its_velocity(pear, sample):
    """Damped motion of second order: world units per unit of time, the way of the last step of its own h."""
    places = []

    def watch(progress):
        places.append(progress.tube())

    material = Material(mu=0.05, gamma=0.5)
    found = _solve(sample.image, sample.clicks, callback=watch, material=material, iterations=1500, step=0.25)
    assert _apart((found.vertices, found.faces), (pear.vertices, pear.faces), sample) < 0.3
    np.testing.assert_allclose(found.velocity[0], (places[-1] - places[-2]) / 0.25, atol=1e-3)
    assert np.abs(found.velocity).max() > 0


def test_a_step_too_long_is_refused_before_any_is_made(sample):
    steps = []
    with pytest.raises(ValueError, match=r"solver\.step = 9 is too long for alternating directions.*at most 0"):
        _solve(sample.image, sample.clicks, step=9.0, callback=steps.append)
    with pytest.raises(ValueError, match=r'"sor" does not integrate material\.mu'):
        _solve(sample.image, sample.clicks, scheme="sor", material=Material(mu=0.1), callback=steps.append)
    assert not steps


def test_result_is_whole(pear):
    """Shapes, the paths of the history, and a contour of points with their support."""
    assert pear.tube.shape == (1, 25, 25, 3) and pear.spine.shape == (1, 25, 3)
    assert pear.velocity.shape == pear.tube.shape and not pear.velocity.any()
    assert len(pear.history) <= 120
    tube, spine, sigma, cuts = pear.history[-1]
    np.testing.assert_array_equal(tube, pear.tube[0].astype(np.float32))
    np.testing.assert_array_equal(spine, pear.spine[0].astype(np.float32))
    sigmas = [h[2] for h in pear.history]
    assert sigmas == sorted(sigmas, reverse=True) and sigma < sigmas[0] and not cuts
    assert [len(p) for p in pear.contour] == [len(s) for s in pear.support]
    for values in (pear.tube, pear.spine, pear.vertices, *pear.contour):
        assert np.all(np.isfinite(values))


def _part(sample, pool, **settings) -> Relaxation:
    """A small tube, at one scale."""
    view, tube = View(np.ascontiguousarray(sample.image), Camera.orthographic()), Tube(sample.clicks, grid=(9, 13))
    settings = Settings(**{"scheme": "adi", "tolerance": 1e-12, "sigmas": (4.0,)} | settings)
    return Relaxation(Assembly([view], [tube], settings, "cpu", maps_of([view], [tube])), pool)


def test_a_long_run_remembers_few_states_evenly_spread(sample):
    passed = []
    with ThreadPoolExecutor(1) as pool:
        part = _part(sample, pool, iterations=5000)
        while not part.done:
            passed.append(part.scene.world(0)[0].astype(np.float32))
            part.advance(10)
    assert part.iteration == 5000
    states = part.history[0]
    assert SNAPSHOTS <= len(states) <= 2 * SNAPSHOTS
    when, far = [], len(passed) // len(states)
    for tube_then, *_ in states[:40]:  # later ones hardly differ
        when.append(min(range(len(passed)), key=lambda i: np.abs(passed[i] - tube_then).max()))
        np.testing.assert_array_equal(passed[when[-1]], tube_then)
    assert set(np.diff(when)) == {when[1]} and far <= when[1] <= 2 * far


@pytest.mark.parametrize(("iterations", "scales"), [(60, [8.0, 4.0, 2.0, 1.0]), (40, [4.0, 2.0, 1.0]), (10, [1.0])])
def test_few_iterations_leave_coarse_scales_out(sample, iterations, scales):
    """Each scale then has its share, and a tube begins softer than at the coarsest."""
    passed = []
    with ThreadPoolExecutor(1) as pool:
        part = _part(sample, pool, iterations=iterations, sigmas=(8.0, 4.0, 2.0, 1.0))
        while not part.done:
            part.advance(1)
            passed.append((part.sigma, part.scene.weights.share))
    assert len(passed) == iterations and list(dict.fromkeys(sigma for sigma, _ in passed)) == scales
    counts = np.bincount([scales.index(sigma) for sigma, _ in passed])
    assert np.ptp(counts) <= 1 and passed[0][1] == pytest.approx(max(0.01, (scales[0] / 8) ** 2) if scales[1:] else 0.01)


def test_what_does_not_slow_down_goes_on_with_less_momentum(sample, monkeypatch):
    """And only that; what creeps leaps as well. With none left it goes as if none had been asked for."""
    with ThreadPoolExecutor(1) as pool:
        for way, momentum, leaps in (
            (lambda i: 0.5 ** (i / 390), 0.9, 0),
            (lambda i: 1e-2, 0.0, 0),
            (lambda i: 9e-4, 0.0, 5),
        ):
            part, jumps = _part(sample, pool, iterations=2401), []
            monkeypatch.setattr(part.scene, "moved", lambda before, part=part, way=way: way(part.iteration))
            monkeypatch.setattr(part, "_jump", lambda jumps=jumps: jumps.append(1))
            part.advance(2400)
            assert part.loop.solver.momentum == pytest.approx(momentum) and len(jumps) == leaps
        calm, plain = _part(sample, pool), _part(sample, pool, momentum=0.0)
        for _ in range(4):
            calm.loop.calm()
        for part in (calm, plain):
            part.advance(40)
        np.testing.assert_array_equal(calm.scene.world(0)[0], plain.scene.world(0)[0])
        assert calm.loop.solver.momentum == 0
        calm.change(0, {"w2": 1e-5})  # an event rouses what was calmed
        assert calm.loop.solver.momentum == 0.9


def test_same_bits_twice(pear, sample):
    again = _solve(sample.image, sample.clicks)
    np.testing.assert_array_equal(again.tube, pear.tube)
    np.testing.assert_array_equal(again.spine, pear.spine)
    assert again.iterations == pear.iterations and again.measures == pear.measures


def test_each_of_several_as_alone_and_on_any_threads(sample):
    """Apart from each other, tubes of different grids end as they do alone, to the bit, each at its own iteration."""
    other = make(5, kind="banana", size=SIZE)
    image = np.concatenate([sample.image, other.image], axis=1)
    tubes = [Tube(sample.clicks, name="pear"), Tube(np.add(other.clicks, [SIZE, 0]), name="banana", grid=(21, 31))]
    alone = [reconstruct([View(image)], [tube]).objects[0] for tube in tubes]
    assert alone[0].iterations != alone[1].iterations
    for threads in (1, 2):
        for one, own in zip(reconstruct([View(image)], tubes, threads=threads).objects, alone, strict=True):
            np.testing.assert_array_equal(one.tube, own.tube)
            assert one.iterations == own.iterations and one.measures == own.measures
    seen = []
    watched = reconstruct([View(image)], tubes, callback=lambda p: seen.append(p.iteration), every=50).objects
    last = max(o.iterations for o in alone)
    assert seen == [*range(50, last, 50), last]
    np.testing.assert_array_equal(watched[1].tube, alone[1].tube)


@pytest.mark.parametrize("count", [1, 2])
def test_what_hides_is_looked_for_whether_or_not_somebody_watches(sample, count, monkeypatch):
    """At the same places of all tubes, so that a callback changes no bit."""
    looks: list[list] = []

    def refresh(self, scenes):
        looks[-1].append([scene.time for scene in scenes])
        return [False] * len(scenes)

    monkeypatch.setattr(Visibility, "refresh", refresh)
    tubes = [Tube(sample.clicks, name="a"), Tube(sample.clicks[::-1], name="b")][:count]
    for every, callback in ((1, None), (1, lambda progress: None), (7, lambda progress: None)):
        looks.append([])
        reconstruct([View(sample.image)], tubes, Settings(iterations=330), callback=callback, every=every)
    assert looks[0] == looks[1] == looks[2] and len(looks[0]) > 3


def test_callback_sees_each_iteration_and_stops(sample):
    seen = []

    def callback(progress):
        seen.append((progress.iteration, progress.tube().copy(), progress.sigma))
        return progress.iteration == 25

    stopped = _solve(sample.image, sample.clicks, callback=callback)
    assert [s[0] for s in seen] == list(range(1, 26)) and stopped.iterations == 25
    assert not stopped.converged
    np.testing.assert_array_equal(seen[-1][1], stopped.tube[0])
    assert seen[0][1].shape == (25, 25, 3) and np.abs(seen[-1][1] - seen[0][1]).max() > 1
    assert seen[0][2] > 0


def test_weights_change_while_a_run_goes_on(pear, sample):
    """From the callback: what is no weight is refused, what is one leads where it would have led from the start."""
    stiff = {"w20": 3e-3, "w02": list(np.linspace(5e-5, 2e-4, 25))}
    fresh = reconstruct([View(sample.image)], [Tube(sample.clicks, material=Material(**stiff))]).objects[0]

    def callback(progress):
        if progress.iteration == 100:
            assert progress.time == pytest.approx(100 * 0.4)
            with pytest.raises(ValueError, match=r"material.w20: -1 does not fit; it must be from 0"):
                progress.material(0, w20=-1)
            progress.material(0, **stiff)

    live = _solve(sample.image, sample.clicks, callback=callback)
    assert _apart((live.vertices, live.faces), (fresh.vertices, fresh.faces), sample) < 0.1
    assert _apart((pear.vertices, pear.faces), (fresh.vertices, fresh.faces), sample) > 0.3


TURNS = {
    "turned": (lambda image: np.rot90(image), lambda x, y: (y, SIZE - 1 - x)),
    "mirrored": (lambda image: image[:, ::-1], lambda x, y: (SIZE - 1 - x, y)),
    "reversed": (lambda image: 1 - image, lambda x, y: (x, y)),
}


@pytest.mark.parametrize(("change", "move"), TURNS.values(), ids=TURNS)
def test_turned_mirrored_or_reversed_image(pear, sample, change, move):
    """The same shape, turned, mirrored, or from the negative; depth apart, which a mirror image leaves as it was."""
    other = _solve(change(sample.image), np.stack(move(*sample.clicks.T), -1))
    moved = pear.vertices.copy()
    moved[:, 0], moved[:, 1] = move(*pear.vertices.T[:2])
    faces = pear.faces if truth.volume(moved, pear.faces) > 0 else pear.faces[:, ::-1]
    assert _apart((moved, faces), (other.vertices, other.faces), sample) < 0.1


def test_world_units_only_scale(pear, sample):
    """A pixel of 0.002 units: everything 0.002 times as large, volumes by its cube."""
    other = _solve(sample.image, sample.clicks, Camera.orthographic(0.002))
    assert _apart((other.vertices / 0.002, other.faces), (pear.vertices, pear.faces), sample) < 1e-2
    assert other.measures["volume"] == pytest.approx(0.002**3 * pear.measures["volume"], rel=1e-3)
    residual, own = (o.measures["contour_residual_px"]["mean"] for o in (other, pear))
    assert residual == pytest.approx(own, abs=0.01)  # in pixels still


def test_larger_image_of_the_same_scene(pear, sample):
    double = make(3, kind="pear", size=2 * SIZE)
    large = _solve(double.image, double.clicks)
    vertices = large.vertices / 2 - [0.25, 0.25, 0]  # pixel centres lie at whole numbers
    assert _apart((vertices, large.faces), (pear.vertices, pear.faces), sample) < 0.2


def test_finer_grid(pear, sample):
    fine = _solve(sample.image, sample.clicks, grid=(49, 49))
    assert _apart((fine.vertices, fine.faces), (pear.vertices, pear.faces), sample) < 0.1


def test_twice_the_iterations_change_nothing(sample):
    """A state of rest: as many iterations again at the finest scale move surface and poles by less than 0.1 %."""
    moved = rest.measure(sample)
    assert moved.converged and moved.iterations > 100
    assert 0 < moved.rms <= moved.most < 0.1
    assert max(moved.poles) < 0.1


def test_limit_of_a_linear_relaxation():
    """States x + a q^k + b p^k, two modes of decay: four in a row tell x."""
    rng = np.random.default_rng(0)
    x, a, b = rng.standard_normal((3, 40, 3))
    trail = [(y[:30], y[30:]) for y in (x + a * 0.9**k + 0.1 * b * 0.5**k for k in range(4))]
    found = np.concatenate(limit(trail))
    np.testing.assert_allclose(found, x, atol=1e-3)
    assert np.abs(trail[-1][0] - x[:30]).max() > 0.5  # far from there yet


def test_limit_goes_no_further_than_its_longest_leap():
    """A mode that hardly decays has its limit far off."""
    trail = [(np.full((4, 3), 0.9999**k),) for k in range(4)]
    way = np.linalg.norm(trail[-1][0] - trail[-2][0])
    leap = np.linalg.norm(limit(trail)[0] - trail[-1][0])
    assert leap == pytest.approx(LONGEST * way, rel=1e-6)


@pytest.mark.parametrize("seed", [25433, 25435])
def test_object_cut_by_the_border_is_as_accurate_where_it_is_seen(seed):
    """A fifth of the axis lies beyond the image: no runaway, and the result says that it is partial."""
    whole = make(seed)
    cut = whole.spine[int(0.8 * len(whole.spine)), :2]
    axis = int(np.argmax(np.abs(whole.spine[-1, :2] - cut)))
    assert whole.spine[-1, axis] > cut[axis]
    edge = round(float(cut[axis]))
    part = (slice(None), slice(edge)) if axis == 0 else (slice(edge),)
    clicks = whole.clicks[whole.clicks[:, axis] < edge - 3]
    found = _solve(whole.image[part], clicks)
    cover = whole.coverage[part]
    assert truth.overlap(truth.silhouette(found.vertices, found.faces, whole.camera, cover.shape), cover) > 0.99
    assert found.converged and found.trusted and found.measures["partial"]
    assert len(found.warnings) == 1 and "leaves the image" in found.warnings[0]
    assert found.measures["supported_share"] > 0.9
    beyond = found.tube[0, 0, :, axis].max() - edge
    assert 0 < beyond < 0.5 * whole.length


def test_vase_comes_to_rest():
    """Flat ends neither tremble nor let rings slide for ever: as many iterations more move nothing."""
    moved = rest.measure(make(25217))
    assert moved.converged and max(moved.most, *moved.poles) < 0.1
