"""Moving scenes: runs that were stopped, and the files that play, opened by others' readers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest

from symseek.device import start_quietly
from symseek.render.animation import write_animated_glb, write_usd
from symseek.scenes.finger import Finger
from symseek.sim.kept import Kept
from symseek.sim.material import Material
from symseek.sim.problem import Settings, Tube, View
from symseek.sim.track import Tracking, track

COUNT = 8


class Killed(Exception):
    """What ends a run between two frames, or in one."""


@pytest.fixture(scope="module")
def finger() -> Finger:
    start_quietly()
    return Finger(seed=3)


@pytest.fixture(scope="module")
def stream(finger):
    images: list = [finger.frame(i).images for i in range(COUNT)]
    images[3] = "left.png is broken"
    return images


def run(finger, stream, tracking=None, material=None, **how):
    views = [View(np.zeros((1, 1)), camera, name) for camera, name in zip(finger.cameras, ("left", "right"), strict=True)]
    tube = Tube(finger.rough, material=material or Material())
    return track(stream, views, [tube], Settings(iterations=400), tracking or Tracking(fps=30.0), **how)


@pytest.fixture(scope="module")
def whole(finger, stream):
    return run(finger, stream).objects[0]


@pytest.mark.parametrize("seed", range(3))
def test_a_killed_run_goes_on_to_the_same_bits(finger, stream, whole, tmp_path, seed):
    """Killed at a frame by chance, once more while it goes on, and with half a record left in its file."""
    rng = np.random.default_rng(seed)
    first = int(rng.integers(1, COUNT - 1))
    kills = first, int(rng.integers(first, COUNT))
    path = tmp_path / "finger.kept"
    for resume, at in zip((False, True), kills, strict=True):

        def kill(shown, at=at):
            if shown.frame == at:
                raise Killed

        with pytest.raises(Killed):
            run(finger, stream, kept=Kept(path, "stamp", resume), callback=kill)
        with path.open("ab") as file:
            file.write(rng.bytes(1000))
    frames: list[int] = []
    found = run(finger, stream, kept=Kept(path, "stamp", True), callback=lambda s: frames.append(s.frame)).objects[0]
    assert frames[0] == kills[1]  # the last whole frame is solved once more, none before it
    for name in ("tube", "spine", "velocity"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    assert found.notes == whole.notes and found.warnings == whole.warnings and found.measures == whole.measures


RUN = """
import sys
from pathlib import Path

import numpy as np
from symseek.device import start_quietly
from symseek.scenes.finger import Finger
from symseek.sim.kept import Kept
from symseek.sim.material import Material
from tests.test_motion import run

start_quietly()
with np.load(sys.argv[1]) as file:
    stream = [list(file[str(i)]) if str(i) in file else "left.png is broken" for i in range(int(sys.argv[3]))]
run(Finger(seed=3), stream, kept=Kept(Path(sys.argv[2]), "stamp", False))
"""


def test_a_process_killed_at_any_moment_goes_on_to_the_same_bits(finger, stream, whole, tmp_path):
    """By SIGKILL, at a moment by chance: in a frame, or while one is written."""
    whole_ones = {str(i): np.stack(f) for i, f in enumerate(stream) if not isinstance(f, str)}
    np.savez(tmp_path / "stream.npz", allow_pickle=False, **whole_ones)
    path, rng = tmp_path / "finger.kept", np.random.default_rng()
    command = [sys.executable, "-c", RUN, str(tmp_path / "stream.npz"), str(path), str(COUNT)]
    process = subprocess.Popen(command, cwd=Path(__file__).parents[1])
    until = monotonic() + 120
    while not (path.is_file() and path.stat().st_size > 64):  # one whole frame is there
        assert process.poll() is None and monotonic() < until
        sleep(0.005)
    sleep(rng.uniform(0.0, 0.3))
    process.kill()
    process.wait()
    found = run(finger, stream, kept=Kept(path, "stamp", True)).objects[0]
    for name in ("tube", "spine", "velocity"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    assert found.notes == whole.notes and found.warnings == whole.warnings


def test_another_scene_is_not_gone_on_from(tmp_path):
    path = tmp_path / "finger.kept"
    with pytest.raises(ValueError, match="to go on from"):
        Kept(path, "one", True)
    Kept(path, "one", False)
    with pytest.raises(ValueError, match="another scene"):
        Kept(path, "two", True)


def moving(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    return rng.standard_normal((count, 4, 3)), faces


def test_glb_plays_its_frames(tmp_path):
    """Each keyframe's weights give that frame's points, in metres and Y up, at its time."""
    pygltflib = pytest.importorskip("pygltflib")
    vertices, faces = moving(6)
    time = np.array([0.0, 0.1, 0.2, 0.4, 0.5, 0.6])
    write_animated_glb(tmp_path / "a.glb", vertices, faces, time, 1e-3)
    gltf = pygltflib.GLTF2().load(str(tmp_path / "a.glb"))
    blob = gltf.binary_blob()

    def read(index: int) -> np.ndarray:
        a = gltf.accessors[index]
        view, wide = gltf.bufferViews[a.bufferView], {"SCALAR": 1, "VEC3": 3}[a.type]
        kind = {5125: "<u4", 5126: "<f4"}[a.componentType]
        assert a.count * wide * 4 <= view.byteLength and view.byteOffset + view.byteLength <= len(blob)
        values = np.frombuffer(blob, kind, a.count * wide, view.byteOffset).reshape(-1, wide)
        if a.min:
            np.testing.assert_allclose([a.min, a.max], [values.min(axis=0), values.max(axis=0)], rtol=1e-6)
        return values

    (part,) = gltf.meshes[0].primitives
    sampler = gltf.animations[0].samplers[0]
    assert gltf.animations[0].channels[0].target.path == "weights"
    np.testing.assert_allclose(read(sampler.input)[:, 0], time, rtol=1e-6)
    np.testing.assert_array_equal(read(part.indices).reshape(-1, 3), faces)
    base, ways = read(part.attributes.POSITION), [read(t["POSITION"]) for t in part.targets]
    weights = read(sampler.output).reshape(len(time), len(ways))
    for frame, own in zip(vertices, weights, strict=True):
        shown = base + sum(w * way for w, way in zip(own, ways, strict=True))
        np.testing.assert_allclose(shown, 1e-3 * frame * [1, -1, -1], atol=1e-8)


def test_usd_holds_its_frames(tmp_path):
    usd, geom = (pytest.importorskip(f"pxr.{name}") for name in ("Usd", "UsdGeom"))
    vertices, faces = moving(6)
    write_usd(tmp_path / "a.usdc", vertices, faces, 25.0, 1e-3, name="my finger")
    stage = usd.Stage.Open(str(tmp_path / "a.usdc"))
    assert stage.GetTimeCodesPerSecond() == 25 and (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 5)
    assert geom.GetStageUpAxis(stage) == "Y" and geom.GetStageMetersPerUnit(stage) == 1e-3
    mesh = geom.Mesh(stage.GetDefaultPrim())
    np.testing.assert_array_equal(np.reshape(mesh.GetFaceVertexIndicesAttr().Get(), (-1, 3)), faces)
    assert mesh.GetPointsAttr().GetTimeSamples() == [0, 1, 2, 3, 4, 5]
    for i, frame in enumerate(vertices):
        np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(i)), frame * [1, -1, -1], rtol=1e-6)


@pytest.mark.parametrize("first", ["none", "rigid"])
def test_other_beginnings(finger, stream, whole, first):
    """Without moves of the whole tube, and by rigid ones, a frame's iterations lead to about the same place."""
    o = run(finger, stream[:3], Tracking(fps=30.0, first=first)).objects[0]
    away = np.linalg.norm(o.spine[2] - whole.spine[2], axis=1)
    moved = np.linalg.norm(whole.spine[2] - whole.spine[0], axis=1)
    assert away.mean() < 0.02 * finger.length and moved.max() > 0 and not any(o.notes)


@pytest.mark.parametrize("mu", [0.1, 1.0])
def test_mass(finger, stream, whole, mu):
    """With mass a frame's iterations lead to about the same place, and nothing builds up from frame to frame."""
    frames = [*stream[:3], *stream[4:], *stream[-2:0:-1]]  # on, and back again
    o = run(finger, frames, material=Material(mu=mu)).objects[0]
    assert not any(note.startswith("lost") for note in o.notes)
    for i, frame in ((5, 6), (6, 7)):
        away = np.linalg.norm(o.spine[i] - whole.spine[frame], axis=1)
        assert away.mean() < 0.01 * finger.length
