"""One scene file over many images: each as if alone, and what is at fault in one does not touch the others."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from PIL import Image

import symseek
from symseek import cli
from symseek.checks import SceneError
from symseek.many import batch
from symseek.scenes.synthetic import make

QUICK = ["object.grid=[12, 15]", "solver.iterations=60", "output.meshes=true"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two pictures, a broken one, a scene file with the axis of the first, and a table with that of the second."""
    base = tmp_path_factory.mktemp("batch")
    samples = {"one.png": make(3, kind="pear", size=128), "two.png": make(5, kind="banana", size=128)}
    for name, sample in samples.items():
        Image.fromarray(np.rint(sample.image * 255).astype(np.uint8)).save(base / name)
    (base / "lost.png").write_bytes(b"no picture")
    spine = np.round(samples["one.png"].clicks, 2).tolist()
    (base / "fruit.toml").write_text(f'[[view]]\nimage = "one.png"\n[[object]]\nname = "fruit"\nspine = {spine}\n')
    lines = [f"two.png,fruit,{x:.2f},{y:.2f}" for x, y in samples["two.png"].clicks]
    (base / "axes.csv").write_text("\n".join(["image,object,x,y", *lines]))
    return base


@pytest.fixture(scope="module")
def done(folder):
    images = [folder / name for name in ("one.png", "lost.png", "two.png")]
    seen = []
    entries = batch(
        folder / "fruit.toml", images, folder / "out", axes=folder / "axes.csv", overrides=QUICK, processes=2,
        callback=seen.append,
    )  # fmt: skip
    assert seen == entries
    return entries


def test_each_image_as_if_alone(folder, done):
    """Same bits as `symseek run`, its own axis where the table gives one."""
    alone = symseek.reconstruct(symseek.load(folder / "fruit.toml", QUICK))
    stored = np.load(folder / "out" / "one" / "fruit.npz")
    np.testing.assert_array_equal(stored["tube"], alone.objects[0].tube)
    other = np.load(folder / "out" / "two" / "fruit.npz")["spine"][0, :, :2]
    clicks = make(5, kind="banana", size=128).clicks
    assert all(np.linalg.norm(other - click, axis=1).min() < 10 for click in clicks)
    assert not (folder / "out" / "one" / "reconstruction.mp4").exists()


def test_what_is_at_fault_is_told_and_leaves_nothing(folder, done):
    assert [bool(entry.error) for entry in done] == [False, True, False]
    assert "lost.png" in done[1].error and "not an image" in done[1].error and not done[1].trusted
    assert not (folder / "out" / "lost").exists()
    with (folder / "out" / "batch.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["object"] for row in rows] == ["fruit", "", "fruit"]
    assert float(rows[0]["volume_px3"]) == done[0].objects[0]["volume"] > 0
    assert rows[1]["error"] == done[1].error


def test_bad_tables_and_names(folder, tmp_path):
    def refused(message: str, images: list, axes: str | None = None) -> None:
        if axes is not None:
            (tmp_path / "axes.csv").write_text(axes)
        with pytest.raises(SceneError, match=message):
            batch(folder / "fruit.toml", images, tmp_path / "o", axes=None if axes is None else tmp_path / "axes.csv")
        assert not (tmp_path / "o").exists()

    one = folder / "one.png"
    refused("header is not image,object,x,y", [one], "x,y\n1,2")
    refused(r"line 2: '4', 'b' is not a point", [one], "image,object,x,y\none.png,fruit,4,b")
    refused("'three.png' is not among the images", [one], "image,object,x,y\nthree.png,fruit,4,5")
    refused("none is called 'frui'", [one], "image,object,x,y\none.png,frui,4,5")
    refused("has the name of", [one, tmp_path / "one.jpg"])


def test_command(folder, tmp_path, capsys):
    """A folder of images; status 2 when one is at fault, which is named on stderr."""
    (tmp_path / "in").mkdir()
    for name in ("one.png", "lost.png"):
        (tmp_path / "in" / name).write_bytes((folder / name).read_bytes())
    changes = [word for change in QUICK for word in ("--set", change)]
    where = ["batch", str(folder / "fruit.toml"), str(tmp_path / "in"), "--out", str(tmp_path / "out"), *changes]
    assert cli.main([*where, "--processes", "1"]) == 2
    said = capsys.readouterr()
    assert "lost.png" in said.err and "1 of 2 images reconstructed" in said.out
    (tmp_path / "none").mkdir()
    assert cli.main(["batch", str(folder / "fruit.toml"), str(tmp_path / "none")]) == 2
    assert "holds no image" in capsys.readouterr().err
