"""The command line and the files that a run writes."""

from __future__ import annotations

import copy
import io
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
import trimesh
from PIL import Image

import symseek
from benchmarks import truth
from symseek import cli, files, folder, pipeline
from symseek.record import FORMS
from symseek.render.platform import RenderError
from symseek.scene import Output
from symseek.scenes import raster
from symseek.sim.track import Shown

QUICK = ["object.grid=[12, 15]", "solver.iterations=60", "output.video_fps=1"]
ALL = {"result.json", "overlay.png", "views.png", "potentials.png", "foreground.png", "reconstruction.mp4"}
ALL |= {"squash.ply", "squash.glb", "squash.npz"}
SQUASH = str(cli.demos()["squash"])


def arguments(*more: str, out: object = None) -> list[str]:
    changes = [word for change in QUICK for word in ("--set", change)]
    return ["run", SQUASH, *changes, *(["--out", str(out)] if out else []), *more]


@pytest.fixture(scope="module")
def squash(tmp_path_factory):
    """One quick run of the squash with all files, its lengths in mm: folder, status, text printed."""
    out = tmp_path_factory.mktemp("run") / "deep" / "out"
    text = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdout", text)
        status = cli.main(arguments("--set", "units=mm", "--set", "scale=0.25", out=out))
    return out, status, text.getvalue()


@pytest.fixture(scope="module")
def record(squash):
    return json.loads((squash[0] / "result.json").read_text())


@pytest.fixture(scope="module")
def solved():
    """The quick squash, solved once."""
    return symseek.reconstruct(symseek.load(SQUASH, QUICK))


@pytest.fixture
def result(solved):
    return copy.deepcopy(solved)


@pytest.fixture
def at_once(result, monkeypatch):
    """Runs need not solve: the tests that use it look at what comes after."""
    monkeypatch.setattr(pipeline, "_solve", lambda *_: result)


def test_a_run_writes_all_its_files_and_says_so(squash, record):
    out, status, text = squash
    assert status == 0
    assert {f.name for f in out.iterdir()} == ALL == set(record["files"])
    assert all(name in text for name in ALL) and str(out) in text
    for line in ("length", "largest radius", "surface area", "volume", "supported", "seconds: read"):
        assert line in text
    assert "stage 1" in text and "\r" not in text, "plain lines where there is no terminal"


def test_record(record):
    assert record["run"]["scene"] == "squash" and record["versions"]["symseek"] == symseek.__version__
    assert record["settings"]["iterations"] == 60 and record["settings"]["scheme"] == "adi"
    assert record["forms"]["contour"] == FORMS["subnode"]
    assert record["units"]["volume"] == "mm^3" and record["units"]["scale"] == "0.25 mm per pixel"
    assert set(record["seconds"]) >= {"read", "solve", "meshes", "pictures", "video"}
    assert all(seconds >= 0 for seconds in record["seconds"].values())
    o = record["objects"]["squash"]
    assert o["grid"] == [12, 15] and o["material"]["w20"] == symseek.Material().w20
    assert len(o["radius"]) == len(o["station"]) == 15 and o["station"][-1] == pytest.approx(o["length"], rel=0.02)
    assert {"volume", "area", "asymmetry", "supported_share", "converged", "trusted", "warnings"} <= set(o)
    assert set(o["contour_residual_px"]) == {"mean", "p95", "max"}


def test_meshes_agree_with_the_measures(squash, record):
    out, o = squash[0], record["objects"]["squash"]
    ply = trimesh.load_mesh(out / "squash.ply")
    assert ply.is_watertight and ply.is_winding_consistent
    assert ply.volume == pytest.approx(o["volume"], rel=1e-4) and ply.area == pytest.approx(o["area"], rel=1e-4)
    # the squash is some 130 mm long at 0.25 mm a pixel, and about where it is in the photograph
    assert 100 < o["length"] < 150 and (ply.bounds[0] > 0).tolist()[:2] == [True, True]
    assert (ply.bounds[1][:2] < np.array([640, 480]) * 0.25).all()
    glb = trimesh.load_mesh(out / "squash.glb")
    assert glb.volume == pytest.approx(o["volume"] * 1e-9, rel=1e-3), "mm to metres"
    np.testing.assert_allclose(glb.bounds, (ply.bounds * 1e-3 * [1, -1, -1])[[[0, 1, 1], [1, 0, 0]], [0, 1, 2]], atol=1e-7)


def test_the_shipped_squash_meets_its_truth():
    """Its neck ends in its own shadow: a weak edge beside strong shading."""
    scene = symseek.load(SQUASH)
    solid = np.load(Path(SQUASH).with_name("truth.npz"))
    shape = scene.views[0].image.shape[:2]
    covered = raster.coverage(solid["vertices"][:, :2].astype(float), solid["faces"].astype(int), shape)
    found = symseek.reconstruct(scene).objects[0]
    outline = truth.silhouette(found.vertices, found.faces, scene.views[0].camera, shape)
    assert truth.overlap(outline, covered) > 0.996
    assert found.trusted and found.measures["volume"] == pytest.approx(float(solid["volume"]), rel=0.01)


def test_arrays(squash):
    arrays = np.load(squash[0] / "squash.npz")
    assert arrays["tube"].shape == (1, 12, 15, 3) and arrays["spine"].shape == (1, 15, 3)
    assert arrays["velocity"].shape == (1, 12, 15, 3) and not arrays["velocity"].any()
    assert arrays["time"].tolist() == [0] and str(arrays["units"]) == "mm"


def test_pictures_hold_something(squash):
    for name in sorted(n for n in ALL if n.endswith(".png")):
        image = np.asarray(Image.open(squash[0] / name), float)
        assert min(image.shape[:2]) > 100 and image.std() > 5, name


def test_video_plays_everywhere(squash):
    with av.open(str(squash[0] / "reconstruction.mp4")) as video:
        stream = video.streams.video[0]
        assert stream.codec_context.name == "h264" and stream.codec_context.pix_fmt == "yuv420p"
        assert stream.width % 2 == 0 and stream.height % 2 == 0
        frames = [f.to_ndarray(format="rgb24") for f in video.decode(stream)]
    assert len(frames) >= 5
    assert np.abs(frames[0].astype(int) - frames[-1]).mean() > 0.5, "nothing moves"


def test_a_second_run_leaves_no_stale_file_and_touches_no_other(squash, result, tmp_path):
    for file in squash[0].iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "notes.txt").write_text("mine")
    result.scene.output = Output(overlay=False, views=False, video=False, meshes=False, potentials=False)
    assert [f.name for f in result.save(tmp_path)] == ["result.json"]
    assert {f.name for f in tmp_path.iterdir()} == {"result.json", "notes.txt"}
    assert json.loads((tmp_path / "result.json").read_text())["units"]["world"] == "px"


def test_script_and_command_line_find_the_same(squash, tmp_path):
    seen = []
    result = symseek.reconstruct(
        cli.DEMOS / "squash" / "squash.jpg",
        spine=symseek.load(SQUASH).tubes[0].spine.tolist(),
        name="squash",
        grid=(12, 15),
        units="mm",
        scale=0.25,
        settings={"iterations": 60},
        output={"video": False, "views": False},
        callback=lambda p: seen.append((p.iteration, p.tube().shape)),
    )
    assert [i for i, _ in seen] == list(range(1, len(seen) + 1)) and seen[0][1] == (12, 15, 3)
    written = result.save(tmp_path / "out")
    assert {f.name for f in written} == ALL - {"views.png", "reconstruction.mp4"} and all(f.is_file() for f in written)
    np.testing.assert_array_equal(result.objects[0].tube, np.load(squash[0] / "squash.npz")["tube"])
    assert (tmp_path / "out" / "squash.ply").read_bytes() == (squash[0] / "squash.ply").read_bytes()


def test_callback_stops_a_run():
    scene = symseek.load(SQUASH, QUICK)
    result = symseek.reconstruct(scene, callback=lambda p: p.iteration == 7)
    volume: Any = result.objects[0].measures["volume"]
    assert result.objects[0].iterations == 7 and volume > 0
    with pytest.raises(TypeError, match="spine"):
        symseek.reconstruct(scene, spine=[[1, 2], [30, 40]])


def test_interruption_leaves_nothing(tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli.Show, "progress", interrupted)
    assert cli.main(arguments("--quiet", out=tmp_path / "a" / "b")) == 1
    assert capsys.readouterr().err == "\nsymseek: interrupted, nothing written\n"
    assert list(tmp_path.iterdir()) == []


def test_interruption_while_files_are_written_leaves_nothing(at_once, tmp_path, monkeypatch):
    def interrupted(result, path):
        path.write_bytes(b"half a vid")
        raise KeyboardInterrupt

    monkeypatch.setattr(files, "_write_pictures", lambda *_: None)
    monkeypatch.setattr(files, "_write_video", interrupted)
    assert cli.main(arguments("--quiet", out=tmp_path / "out")) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_process_cleanly(number, tmp_path):
    endless = [
        "--set",
        "solver.tolerance=0.0",
        "--set",
        "solver.iterations=1000000",
        "--set",
        "object.grid=[12, 15]",
    ]
    command = [sys.executable, "-m", "symseek", "run", SQUASH, *endless, "--out", str(tmp_path / "out")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout is not None
        while (line := process.stdout.readline()) and not line.startswith("stage 1"):
            pass
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 1 and "interrupted, nothing written" in err and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_a_signal_that_a_destructor_swallows_ends_the_run_at_the_next_iteration(monkeypatch):
    class Swallows:
        def __del__(self):
            cli.interrupt(signal.SIGINT, None)

    swallowed = []
    monkeypatch.setattr(sys, "unraisablehook", lambda row: swallowed.append(row.exc_type))
    monkeypatch.setattr(cli, "_interrupted", threading.Event())
    show, frame = cli.Show(quiet=True), Shown(0, [])
    show.progress(frame)
    Swallows()
    assert swallowed == [KeyboardInterrupt]
    with pytest.raises(KeyboardInterrupt):
        show.progress(frame)


def test_without_opengl_the_rest_is_written(at_once, tmp_path, monkeypatch, capsys):
    def absent(*_, **__):
        raise RenderError("no OpenGL here; install some")

    monkeypatch.setattr(files, "views_sheet", absent)
    monkeypatch.setattr(files, "evolution_frames", absent)
    assert cli.main(arguments(out=tmp_path / "out")) == 1
    out, err = capsys.readouterr()
    assert {f.name for f in (tmp_path / "out").iterdir()} == ALL - {"views.png", "reconstruction.mp4"}
    assert "views.png was not written: no OpenGL here; install some" in err and "reconstruction.mp4" in err
    assert "volume" in out
    assert set(json.loads((tmp_path / "out" / "result.json").read_text())["skipped"]) == {
        "views.png",
        "reconstruction.mp4",
    }


@pytest.mark.parametrize("wild", [np.nan, 1e30])
def test_a_model_gone_astray_is_recorded_without_pictures(wild, result, tmp_path):
    o = result.objects[0]
    o.tube = o.tube * wild
    o.vertices = o.vertices * wild
    o.history = [(tube * wild, *rest) for tube, *rest in o.history]
    o.measures["volume"] = wild
    written = {f.name for f in result.save(tmp_path)}
    assert written == ALL - {"overlay.png", "views.png", "reconstruction.mp4"} == {f.name for f in tmp_path.iterdir()}
    volume = json.loads((tmp_path / "result.json").read_text())["objects"]["squash"]["volume"]
    assert volume == (None if np.isnan(wild) else wild)


def test_trouble_of_the_machine_is_status_1(at_once, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pipeline.Result, "_write", full)
    assert cli.main(arguments("--quiet", out=tmp_path / "out")) == 1
    err = capsys.readouterr().err
    assert "No space left" in err and "doctor" in err and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_untrusted_result_is_loud(result):
    result.objects[0].trusted, result.objects[0].warnings = False, ["the contour lies on nothing"]
    text = cli.summary(result)
    assert "DO NOT TRUST 'squash'" in text and "the contour lies on nothing" in text
    result.objects[0].trusted, result.objects[0].warnings = True, []
    assert "DO NOT TRUST" not in cli.summary(result)


def test_default_folder_is_out_name(at_once, result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(files, "_write_pictures", lambda *_: None)
    monkeypatch.setattr(files, "_write_video", lambda *_: None)
    assert cli.main(arguments("--quiet", "--set", "name=my squash")) == 0
    assert (tmp_path / "out" / "my squash" / "result.json").is_file()


def test_demo_list_and_unknown_demo(capsys):
    assert cli.main(["demo", "--list"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in cli.demos()) and {"squash", "rocket"} <= set(cli.demos())
    assert cli.main(["demo", "sqash"]) == 2
    assert "squash" in capsys.readouterr().err


def test_wrong_usage_is_status_2(capsys):
    for words in ([], ["walk"], ["run"], ["run", "a.toml", "--fast"]):
        with pytest.raises(SystemExit) as ended:
            cli.main(words)
        assert ended.value.code == 2
    assert "usage" in capsys.readouterr().err


def test_version_and_help_load_nothing_heavy():
    code = "import sys, symseek.cli as c\ntry: c.main(['--version'])\nexcept SystemExit: print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.startswith(f"symseek {symseek.__version__}\n")
    assert not {"numpy", "warp", "skimage", "pyrender", "av"} & set(out.split())


def test_progress_bar_moves_on_a_terminal(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    class At:
        iteration, total, stage, sigma, residual = 50, 100, 2, 4.0, 1e-3

    screen = Terminal()
    monkeypatch.setattr(sys, "stdout", screen)
    show = cli.Show(quiet=False)
    show.progress(At())  # pyright: ignore
    show.line("done")
    assert screen.getvalue().startswith("\r[##########----------] stage 3, sigma 4.0 px: iteration 50, residual 1.0e-03")
    assert screen.getvalue().endswith("\ndone\n")


def test_doctor_names_what_is_there_and_what_is_not(monkeypatch, capsys):
    from symseek import doctor

    assert cli.main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert "MISSING" not in out and all(word in out for word in ("Python", "Warp", "OpenGL", "libx264"))

    monkeypatch.setattr(doctor, "version", _no_such_package)
    assert cli.main(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "MISSING  packages" in out and "pip install" in out


def _no_such_package(name: str) -> str:
    from importlib.metadata import PackageNotFoundError

    raise PackageNotFoundError(name)


def test_output_stays_whole_when_a_move_fails(tmp_path, monkeypatch):
    """The record goes last, so what it names is there."""
    moved: list[str] = []
    replace = os.replace

    def watched(source, target):
        moved.append(Path(target).name)
        replace(source, target)

    monkeypatch.setattr(folder.os, "replace", watched)
    with folder.staging(tmp_path / "out") as stage:
        for name in ("z.png", "result.json", "a.png"):
            (stage / name).write_text(name)
    assert moved == ["a.png", "z.png", "result.json"]
    assert sorted(f.name for f in (tmp_path / "out").iterdir()) == ["a.png", "result.json", "z.png"]
