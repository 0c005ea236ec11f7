"""Snakes, sheets and tubes from scene file and script to files: figure 6, and all three in one scene."""

from __future__ import annotations

import json

import numpy as np
import pytest

import symseek
from symseek import cli

STILL_LIFE = cli.demos()["snake"]


def test_figure_6(tmp_path, capsys):
    """The demo: both outlines within a third of a pixel, the pear's pulled off by 40 px on the way, files and record."""
    out = tmp_path / "out"
    assert cli.main(["demo", "snake", "--out", str(out), "--set", "output.video_fps=4"]) == 0
    printed = capsys.readouterr().out
    assert "pear" in printed and "trusted" in printed and "volume" not in printed
    record = json.loads((out / "result.json").read_text())
    assert sorted(f.name for f in out.iterdir()) == sorted(record["files"])
    assert {"overlay.png", "reconstruction.mp4", "pear.npz", "potato.npz", "foreground.png"} <= set(record["files"])
    assert "views.png" not in record["files"] and record["skipped"] == {}
    for name, outline in np.load(STILL_LIFE.parent / "truth.npz").items():
        o = record["objects"][name]
        assert o["kind"] == "snake" and o["converged"] and o["trusted"] and o["iterations"] > 700
        curve = np.load(out / f"{name}.npz")
        assert curve["curve"].shape == (1, 200, 2) and str(curve["units"]) == "px"
        gap = np.linalg.norm(curve["curve"][0][:, None] - outline[None], axis=2).min(axis=1)
        assert gap.mean() < 0.33
        assert o["supported_share"] > 0.95 and o["contour_residual_px"]["mean"] < 0.3
        x, y = outline.T
        np.testing.assert_allclose(o["area"], abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2, rtol=0.01)


def test_tube_snake_and_sheet_in_one_scene(tmp_path):
    """From Python, by the keys of a scene file; lengths in mm, a mesh of the sheet, one film for all."""
    given = symseek.load(STILL_LIFE).lines[1]
    assert isinstance(given, symseek.Snake)
    result = symseek.reconstruct(
        STILL_LIFE.parent / "still_life.jpg",
        objects=[
            {"name": "pear", "spine": [[208, 90], [206, 240], [206, 390]], "grid": [12, 15]},
            {"name": "potato", "kind": "snake", "points": given.points, "nodes": 60},
            {"name": "cloth", "kind": "sheet", "corners": [[400, 60], [560, 60], [560, 160], [400, 160]], "image": False,
             "load": [0, 0, 0.5], "grid": [9, 7],
             "spring": [{"point": [0, 0], "anchor": [200, 30, 0]}, {"point": [1, 1], "anchor": [280, 80, 0]},
                        {"point": [0, 1], "anchor": [200, 80, 0]}]},
        ],
        units="mm",
        scale=0.5,
        settings={"iterations": 300},
        output={"views": False, "video_fps": 2},
    )  # fmt: skip
    assert [o.name for o in result.objects] == ["pear"] and [(o.name, o.kind) for o in result.lines] == [
        ("potato", "snake"),
        ("cloth", "sheet"),
    ]
    potato, cloth = result.lines
    assert potato.nodes.shape == (1, 60, 2) and cloth.nodes.shape == (1, 9, 7, 3)
    x, y = np.load(STILL_LIFE.parent / "truth.npz")["potato"].T
    area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2 * 0.5**2
    np.testing.assert_allclose(potato.measures["area"], area, rtol=0.02)
    assert cloth.measures["area"] > 80 * 50 and "supported_share" not in cloth.measures
    written = {f.name for f in result.save(tmp_path)}
    assert {"cloth.ply", "cloth.glb", "cloth.npz", "potato.npz", "overlay.png", "reconstruction.mp4"} <= written
    assert "potato.ply" not in written
    with pytest.raises(TypeError, match="not both"):
        symseek.reconstruct(STILL_LIFE.parent / "still_life.jpg", [[1, 2], [30, 40]], objects=[])
