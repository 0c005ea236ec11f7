"""Every kind of bad input: one message that names file, field and remedy, exit status 2, nothing written."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from symseek import cli, scene
from symseek.checks import SceneError

GOOD = {
    "name": '"thing"',
    "view": {"image": '"photo.png"'},
    "object": {"name": '"thing"', "spine": "[[20, 30], [40, 32], [60, 30]]"},
}


def toml(**changes) -> str:
    """The good scene with keys changed; "view.image" is written view__image, None removes a key."""
    tables: dict[str, dict[str, str]] = {
        "": {"name": GOOD["name"]},
        "view": {**GOOD["view"]},
        "object": {**GOOD["object"]},
    }
    for key, value in changes.items():
        table, _, field = key.rpartition("__")
        tables.setdefault(table, {})[field] = value
    lines = [f"{k} = {v}" for k, v in tables.pop("").items() if v is not None]
    for table, keys in tables.items():
        lines.append(f"[[{table}]]" if table in ("view", "object") else f"[{table.replace('__', '.')}]")
        lines += [f"{k} = {v}" for k, v in keys.items() if v is not None]
    return "\n".join(lines)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """A folder with photographs good and bad."""
    path = tmp_path_factory.mktemp("photographs")
    rows, columns = np.mgrid[:64, :80]
    grey = np.where((rows - 30) ** 2 / 15**2 + (columns - 40) ** 2 / 28**2 < 1, 200, 40).astype(np.uint8)
    unit = grey / 255
    holed = unit.copy()
    holed[5, 7] = np.nan
    pictures = {
        "photo": grey,
        "half": grey[:32],
        "flat": np.full((64, 80), 77, np.uint8),
        "white": np.full((64, 80), 255, np.uint8),
        "tiny": grey[:3, :3],
        "transparent": np.dstack([grey, grey, grey, np.zeros_like(grey)]),
    }
    for name, pixels in pictures.items():
        Image.fromarray(pixels).save(path / f"{name}.png")
    arrays = {
        "nan": holed,
        "bytes_as_floats": grey.astype(float),
        "complex": unit.astype(complex),
        "cube": np.zeros((20, 20, 7)),
    }
    for name, pixels in arrays.items():
        np.save(path / f"{name}.npy", pixels)
    png = (path / "photo.png").read_bytes()
    (path / "torn.png").write_bytes(png[: len(png) // 2])
    # only the header says how large: signature (8 bytes), length, IHDR, width, height, five more, checksum
    header = b"IHDR" + struct.pack(">II", 20000, 9000) + png[24:29]
    (path / "huge.png").write_bytes(png[:12] + header + struct.pack(">I", zlib.crc32(header)) + png[33:])
    (path / "empty.jpg").write_bytes(b"")
    (path / "words.jpg").write_text("not a photograph")
    (path / "a_file").write_text("in the way")
    return path


@pytest.fixture
def folder(photographs, monkeypatch):
    """The photographs, as the working folder."""
    monkeypatch.chdir(photographs)
    monkeypatch.delenv("SYMSEEK_NOWHERE", raising=False)
    return photographs


SPINE = "object__spine"
IMAGE = "view__image"
CASES = {
    # images
    "missing image": ({IMAGE: '"phto.png"'}, ["view[0].image", "does not exist", "did you mean photo.png"]),
    "image is a folder": ({IMAGE: '"."'}, ["view[0].image", "is a folder"]),
    "no image": ({IMAGE: '"words.jpg"'}, ["view[0].image", "words.jpg", "is not an image"]),
    "torn image": ({IMAGE: '"torn.png"'}, ["view[0].image", "torn.png", "is not an image"]),
    "empty file": ({IMAGE: '"empty.jpg"'}, ["view[0].image", "is empty (0 bytes)"]),
    "too large": ({IMAGE: '"huge.png"'}, ["view[0].image", "20000 x 9000", "180 megapixels", "at most 100"]),
    "too small": ({IMAGE: '"tiny.png"'}, ["view[0].image", "3 x 3", "at least 16"]),
    "one grey value": ({IMAGE: '"flat.png"'}, ["view[0].image", "one grey value", "0.302"]),
    "all transparent": ({IMAGE: '"transparent.png"'}, ["view[0].image", "one grey value"]),
    "NaN": ({IMAGE: '"nan.npy"'}, ["view[0].image", "1 values NaN", "column 7, row 5"]),
    "floats beyond 1": ({IMAGE: '"bytes_as_floats.npy"'}, ["view[0].image", "from 40 to 200", "by 255"]),
    "complex": ({IMAGE: '"complex.npy"'}, ["view[0].image", "complex"]),
    "seven channels": ({IMAGE: '"cube.npy"'}, ["view[0].image", "(20, 20, 7)"]),
    "unset variable": ({IMAGE: '"$SYMSEEK_NOWHERE/a.png"'}, ["view[0].image", "SYMSEEK_NOWHERE", "not set"]),
    "unknown skimage": ({IMAGE: '"skimage:rockt"'}, ["view[0].image", "rockt", "did you mean rocket"]),
    "image no text": ({IMAGE: "3"}, ["view[0].image", "3 is not a path"]),
    "no image key": ({IMAGE: None}, ["view[0].image", "is missing"]),
    "frames": ({"view__frames": '"left_*.png"'}, ["view[0].image", "stands beside frames", "not both"]),
    "ends by another word": ({"object__goes_on": '"end"'}, ["object[0].goes_on", "'end'", "no, first, last, both"]),
    "ends by a number": ({"object__goes_on": "1"}, ["object[0].goes_on", "1"]),
    "ends by flags": ({"object__goes_on": "[true, false]"}, ["object[0].goes_on"]),
    "crops of a still": ({"view__crops": "true"}, ["view[0].crops", "is for moving scenes"]),
    "crops by a word": ({IMAGE: None, "view__frames": '["photo.png"]', "view__crops": '"yes"'}, ["view[0].crops", "'yes'"]),
    "crops and a mask": (
        {IMAGE: None, "view__frames": '["photo.png"]', "view__crops": "true", "view__ignore": '"white.png"'},
        ["view[0].ignore", "stands beside crops"],
    ),
    # masks and marks
    "mask of another size": ({"view__ignore": '"half.png"'}, ["view[0].ignore", "80 x 32", "80 x 64"]),
    "mask covers all": ({"view__ignore": '"white.png"'}, ["view[0].ignore", "whole image"]),
    "mark outside": ({"object__not_here": "[[3, 3], [90, 1]]"}, ["[0].not_here[1]", "[90, 1]", "80 x 64"]),
    # spines
    "no spine": ({SPINE: None}, ["object[0].spine", "is missing"]),
    "one point": ({SPINE: "[[20, 30]]"}, ["object[0].spine", "has 1 point", "at least two"]),
    "no point": ({SPINE: "[]"}, ["object[0].spine"]),
    "outside": ({SPINE: "[[20, 30], [80, 30]]"}, ["object[0].spine[1]", "[80, 30]", "80 x 64"]),
    "repeated": ({SPINE: "[[20, 30], [40, 30], [40, 30]]"}, ["object[0].spine", "points 1 and 2"]),
    "closed loop": ({SPINE: "[[20, 30], [40, 50], [60, 30], [20, 30]]"}, ["[0].spine", "points 0 and 3"]),
    "crossing": ({SPINE: "[[20, 20], [60, 50], [60, 20], [20, 50]]"}, ["crosses itself", "0 to 1", "2 to 3"]),
    "turning back": ({SPINE: "[[20, 30], [60, 30], [40, 30]]"}, ["object[0].spine", "crosses itself"]),
    "too short": ({SPINE: "[[20, 30], [22, 30]]"}, ["object[0].spine", "2.0 pixels", "at least 10"]),
    "ragged": ({SPINE: "[[20, 30], [40]]"}, ["object[0].spine", "is not a list"]),
    "words": ({SPINE: '[["a", 30], [40, 30]]'}, ["object[0].spine", "finite numbers"]),
    "infinite": ({SPINE: "[[inf, 30], [40, 30]]"}, ["object[0].spine", "finite numbers"]),
    # numbers
    "grid too small": ({"object__grid": "[4, 25]"}, ["object[0].grid", "[4, 25]", "[8, 6]"]),
    "grid of floats": ({"object__grid": "[25.0, 25]"}, ["object[0].grid"]),
    "grid of one": ({"object__grid": "25"}, ["object[0].grid", "25"]),
    "negative radius": ({"object__radius": "-3"}, ["object[0].radius", "-3", "above 0"]),
    "radius beyond the image": ({"object__radius": "300"}, ["object[0].radius", "300", "at most 51"]),
    "radius no number": ({"object__radius": '"thick"'}, ["object[0].radius", "'thick'"]),
    "depth no number": ({"object__depth": "true"}, ["object[0].depth", "True"]),
    "negative scale": ({"units": '"mm"', "scale": "-1"}, ["scale", "-1", "above 0"]),
    "units without scale": ({"units": '"mm"'}, ["scale", "missing", "'mm'"]),
    "scale without units": ({"scale": "0.5"}, ["units", "px", "0.5"]),
    "unknown units": ({"units": '"yards"'}, ["units", "'yards'", "mm"]),
    # keys
    "unknown key": ({"nam": '"x"'}, ["nam", "unknown key", "did you mean name"]),
    "unknown view key": ({"view__imge": '"x"'}, ["view[0].imge", "did you mean image"]),
    "unknown object key": ({"object__spin": "[]"}, ["object[0].spin", "did you mean spine"]),
    "unknown setting": ({"solver__schem": '"adi"'}, ["solver.schem", "did you mean scheme"]),
    "unknown scheme": ({"solver__scheme": '"eular"'}, ["solver.scheme", "'eular'", "did you mean euler"]),
    "setting of the wrong kind": ({"solver__iterations": '"many"'}, ["solver.iterations", "a whole number"]),
    "setting out of bounds": ({"solver__step": "-0.1"}, ["solver.step", "-0.1", "from 1e-06"]),
    "rising sigmas": ({"solver__sigmas": "[2, 8]"}, ["solver.sigmas", "[2.0, 8.0]", "coarse to fine"]),
    "sigmas no list": ({"solver__sigmas": "3"}, ["solver.sigmas", "a list, each a finite number"]),
    "unknown material": ({"object__material": "{w03 = 1.0}"}, ["object[0].material.w03", "unknown key"]),
    "negative material": ({"object__material": "{w20 = -1.0}"}, ["object[0].material.w20", "-1.0", "from 0"]),
    "weight of words": ({"object__material": '{w02 = ["a"]}'}, ["[0].material.w02", "['a']", "a finite number, a list"]),
    "negative list": ({"object__material": "{w2 = [1.0, -1.0]}"}, ["[0].material.w2", "[1.0, -1.0]", "from 0"]),
    "weight that is no number": ({"object__material": "{w2 = nan}"}, ["[0].material.w2", "nan", "a finite number"]),
    "rows for the spine": ({"object__material": "{w2 = [[1.0, 2.0]]}"}, ["[0].material.w2", "along s"]),
    "times that fall": (
        {"object__material": "{w2 = {times = [2, 1], values = [1, 2]}}"},
        ["[0].material.w2", "times that rise"],
    ),
    "closed no flag": ({"object__material": "{closed = 1}"}, ["[0].material.closed", "true"]),
    "length without factor": ({"object__material": "{L01 = 1.0}"}, ["[0].material.L01", "give k01 too"]),
    "material no table": ({"object__material": "3"}, ["object[0].material", "not a table"]),
    "break without place": ({"object__break": '[{order = "tangent"}]'}, ["[0].break[0].at", "is missing"]),
    "break beyond the end": ({"object__break": "[{at = 1.5}]"}, ["[0].break[0].at", "1.5", "at most 1"]),
    "break outside": ({"object__break": "[{at = [90, 1]}]"}, ["[0].break[0].at", "[90.0, 1.0]", "80 x 64"]),
    "break of a kind": ({"object__break": '[{at = 0.5, order = "crack"}]'}, ["[0].break[0].order", "'crack'"]),
    "break of what": ({"object__break": '[{at = 0.5, of = "tub"}]'}, ["[0].break[0].of", "did you mean tube"]),
    "break unknown key": ({"object__break": "[{at = 0.5, when = 3}]"}, ["[0].break[0].when", "unknown key"]),
    "breaks too close": ({"object__break": "[{at = 0.5}, {at = 0.52}]"}, ["object[0].break", "too often", "25"]),
    "break no list": ({"object__break": "0.5"}, ["[0].break[0]", "not a table"]),
    "unknown output": ({"output__vidoe": "true"}, ["output.vidoe", "did you mean video"]),
    "output no flag": ({"output__video": '"yes"'}, ["output.video", "true or false"]),
    "name with a slash": ({"object__name": '"../x"'}, ["object[0].name", "'../x'", "file name"]),
    "empty name": ({"name": '""'}, ["name", "not text"]),
    # cameras
    "unknown projection": ({"view__projection": '"fisheye"'}, ["view[0].projection", "'fisheye'"]),
    "stereo without alpha": ({"view__projection": '"stereo"'}, ["view[0].alpha", "is missing"]),
    "alpha without stereo": ({"view__alpha": "0.2"}, ["view[0].alpha", "stereo"]),
    "matrix without P": ({"view__projection": '"matrix"'}, ["view[0].P", "is missing"]),
    "P of rank 2": (
        {"view__projection": '"matrix"', "view__P": "[[1,0,0,0],[1,0,0,0],[0,0,0,1]]"},
        ["view[0].P", "rank 3"],
    ),
    "scale beside a matrix": (
        {"scale": "1.0", "view__projection": '"matrix"', "view__P": "[[1,0,0,0],[0,1,0,0],[0,0,0,1]]"},
        ["scale", "no meaning"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_bad_scene_is_named(case, folder, capsys):
    changes, expected = CASES[case]
    (folder / "scene.toml").write_text(toml(**changes))
    before = sorted(folder.rglob("*"))
    assert cli.main(["run", "scene.toml", "--quiet"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("symseek: scene.toml: "), err
    assert all(text in err for text in expected), err
    assert "; " in err, "no remedy"
    assert sorted(folder.rglob("*")) == before


def test_perspective_needs_a_camera_and_a_depth(folder):
    good = {
        "view__projection": '"perspective"',
        "view__K": "[[100, 0, 40], [0, 100, 32], [0, 0, 1]]",
        "view__R": "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
        "view__t": "[0, 0, 0]",
    }
    faults = {
        "depth": {"object__depth": "0.0"},
        "view[0].K": {"view__K": "[[1, 2], [3, 4]]"},
        "view[0].R": {"view__R": "[[1, 0, 0], [0, 1, 0], [0, 0, -1]]"},
        "view[0].t": {"view__t": "[0, 0]"},
        "behind the camera": {SPINE: "[[0, 0, 5], [0.1, 0, -5]]"},
    }
    for expected, fault in faults.items():
        (folder / "scene.toml").write_text(toml(**{**good, "object__depth": "5.0", **fault}))
        with pytest.raises(SceneError, match=expected.replace("[", r"\[")):
            scene.load("scene.toml")
    (folder / "scene.toml").write_text(toml(**good, object__depth="5.0"))
    assert not scene.load("scene.toml").views[0].camera.affine


SNAKE = {"object__kind": '"snake"', SPINE: None, "object__points": "[[20, 20], [60, 20], [60, 50], [20, 50]]"}
SHEET = {"object__kind": '"sheet"', SPINE: None, "object__corners": "[[20, 20], [60, 20], [60, 50], [20, 50]]"}
POINTS, CORNERS, SPRING = "object__points", "object__corners", "object__spring"
LINES = {
    "unknown kind": ({**SNAKE, "object__kind": '"snail"'}, ["object[0].kind", "'snail'", "did you mean snake"]),
    "key of another kind": ({**SNAKE, "object__radius": "3"}, ["object[0].radius", "does not belong to a snake", "tube's"]),
    "spine of a snake": ({**SNAKE, SPINE: "[[1, 2], [30, 40]]"}, ["object[0].spine", "snake"]),
    "no points": ({**SNAKE, POINTS: None}, ["object[0].points", "is missing", "rough curve"]),
    "two points closed": ({**SNAKE, POINTS: "[[20, 20], [60, 20]]"}, ["object[0].points", "has 2 points", "at least 3"]),
    "one point open": ({**SNAKE, POINTS: "[[20, 20]]", "object__closed": "false"}, ["has 1 point", "at least 2"]),
    "points outside": ({**SNAKE, POINTS: "[[20, 20], [90, 20], [60, 50]]"}, ["object[0].points[1]", "[90, 20]"]),
    "points knotted": (
        {**SNAKE, POINTS: "[[20, 20], [60, 50], [60, 20], [20, 50]]"},
        ["object[0].points", "crosses itself"],
    ),
    "shut across": ({**SNAKE, POINTS: "[[20, 20], [60, 20], [60, 50], [40, 10]]"}, ["object[0].points", "crosses itself"]),
    "encloses little": (
        {**SNAKE, POINTS: "[[20, 20], [40, 20], [30, 26]]"},
        ["object[0].points", "60 pixels", "at least 100"],
    ),
    "closed no flag": ({**SNAKE, "object__closed": "1"}, ["object[0].closed", "neither true nor false"]),
    "few nodes": ({**SNAKE, "object__nodes": "5"}, ["object[0].nodes", "5", "12 to 2000"]),
    "material of a tube": ({**SNAKE, "object__material": "{ w20 = 1.0 }"}, ["object[0].material.w20", "unknown"]),
    "three corners": ({**SHEET, CORNERS: "[[20, 20], [60, 20], [60, 50]]"}, ["object[0].corners", "four"]),
    "crossed corners": ({**SHEET, CORNERS: "[[20, 20], [60, 50], [60, 20], [20, 50]]"}, ["object[0].corners", "crosses"]),
    "twist too stiff": ({**SHEET, "object__material": "{ w11 = 1.0 }"}, ["object[0].material.w11", "at most", "0.0001"]),
    "load no vector": ({**SHEET, "object__load": "[1, 2]"}, ["object[0].load", "a vector"]),
    "scheme for tubes": ({**SNAKE, "solver__scheme": '"euler"'}, ["solver.scheme", "'euler'", "tubes"]),
    "spring no table": ({**SNAKE, SPRING: "3"}, ["object[0].spring", "3", "[[object.spring]]"]),
    "spring without anchor": ({**SNAKE, SPRING: "[{ point = 0.5 }]"}, ["object[0].spring[0].anchor", "is missing"]),
    "spring tied nowhere": ({**SNAKE, SPRING: "[{ anchor = [3, 4] }]"}, ["object[0].spring[0].near", "is missing", "point"]),
    "spring tied twice": (
        {**SNAKE, SPRING: "[{ anchor = [3, 4], point = 0.5, near = [20, 20] }]"},
        ["near", "beside point"],
    ),
    "point beyond": ({**SNAKE, SPRING: "[{ anchor = [3, 4], point = 1.5 }]"}, ["spring[0].point", "1.5", "0 to 1"]),
    "point of a tube": ({SPRING: "[{ anchor = [3, 4], point = 0.5 }]"}, ["spring[0].point", "[x, s]"]),
    "snake in space": ({**SNAKE, SPRING: "[{ anchor = [3, 4, 5], point = 0.5 }]"}, ["spring[0].anchor", "[column, row]"]),
    "near outside": ({**SNAKE, SPRING: "[{ anchor = [3, 4], near = [99, 4] }]"}, ["spring[0].near[0]", "[99, 4]"]),
    "volcano tied": (
        {**SNAKE, SPRING: "[{ anchor = [3, 4], reach = 5, point = 0.5 }]"},
        ["spring[0].point", "beside reach"],
    ),
    "stops first": (
        {**SNAKE, SPRING: "[{ anchor = [3, 4], point = 0.5, start = 9, stop = 9 }]"},
        ["spring[0].stop", "10 to"],
    ),
    "stops too late": ({**SNAKE, SPRING: "[{ anchor = [3, 4], point = 0.5, stop = 9999 }]"}, ["stop", "solver.iterations"]),
    "no stiffness": (
        {**SNAKE, SPRING: "[{ anchor = [3, 4], point = 0.5, stiffness = 0 }]"},
        ["spring[0].stiffness", "above 0"],
    ),
}


@pytest.mark.parametrize("case", LINES)
def test_bad_snake_sheet_or_spring_is_named(case, folder):
    changes, expected = LINES[case]
    (folder / "scene.toml").write_text(toml(**changes))
    with pytest.raises(SceneError) as raised:
        scene.load(folder)
    for words in expected:
        assert words in str(raised.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (toml() + '\n[[view]]\nimage = "photo.png"', ["object[0].spine", "from one side only", "alpha"]),
        (toml() + "\n[[object]]\nspine = [[1, 2], [30, 40]]", ["object[1].name", "is missing"]),
        (
            toml() + '\n[[object]]\nname = "thing"\nspine = [[1, 2], [30, 40]]',
            ["object[1].name", "'thing'", "twice"],
        ),
        ('[[view]]\nimage = "photo.png"', ["object", "is missing", "[[object]]"]),
        ('[object]\nspine = 3\n[[view]]\nimage = "photo.png"', ["object", "not a list of tables"]),
        ("spine = [[1, 2", ["not valid TOML", "Unclosed array"]),
        ("", ["view", "is missing"]),
        ("solver = 3\n" + toml(), ["solver", "not a table"]),
    ],
)
def test_bad_structure_is_named(text, expected, folder, capsys):
    (folder / "scene.toml").write_text(text)
    assert cli.main(["run", "scene.toml", "--quiet"]) == 2
    err = capsys.readouterr().err
    assert all(part in err for part in expected), err


def test_missing_scene_file(folder, capsys):
    (folder / "scene.toml").write_text(toml())
    assert cli.main(["run", "scenes.toml", "--quiet"]) == 2
    assert "did you mean scene.toml" in capsys.readouterr().err
    assert cli.main(["run", "photo.png", "--quiet"]) == 2
    assert "not text" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("solver.scheme", "is not KEY=VALUE"),
        ("solver.sheme=adi", "did you mean scheme"),
        ("object.3.grid=[9, 9]", "nothing called object.3"),
        ("name.x=3", "nothing called name"),
        ("=3", "is not KEY=VALUE"),
    ],
)
def test_bad_override_is_named(override, expected, folder, capsys):
    (folder / "scene.toml").write_text(toml())
    assert cli.main(["run", "scene.toml", "--quiet", "--set", override]) == 2
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("out", ["a_file", "a_file/below", "/proc/nowhere"])
def test_output_folder_that_cannot_be_written(out, folder, capsys):
    (folder / "scene.toml").write_text(toml())
    before = sorted(folder.rglob("*"))
    assert cli.main(["run", "scene.toml", "--quiet", "--out", out]) == 2
    err = capsys.readouterr().err
    assert "cannot be written" in err and out in err and "--out" in err and err.count("\n") == 1
    assert sorted(folder.rglob("*")) == before


def test_unknown_device(folder, capsys):
    (folder / "scene.toml").write_text(toml())
    assert cli.main(["run", "scene.toml", "--quiet", "--device", "abacus"]) == 2
    assert "abacus" in capsys.readouterr().err


def test_odd_images_that_are_good(folder):
    """16 bits, alpha, palette and colour floats read as the same picture."""
    grey = np.asarray(Image.open("photo.png"))
    Image.fromarray(grey.astype(np.uint16) * 257).save("deep.png")
    Image.fromarray(grey).convert("P").save("palette.png")
    opaque = np.dstack([grey, np.full_like(grey, 255)])
    Image.fromarray(opaque).save("alpha.png")
    np.save("floats.npy", np.dstack([grey / 255] * 3))
    for name in ("deep.png", "palette.png", "alpha.png", "floats.npy"):
        (folder / "scene.toml").write_text(toml(view__image=f'"{name}"'))
        image = scene.load("scene.toml").views[0].image
        assert image.dtype == np.float32
        np.testing.assert_allclose(image if image.ndim == 2 else image[..., 0], grey / 255, atol=1e-6)


def test_alpha_is_laid_over_mid_grey(folder):
    grey = np.full((32, 40, 4), 255, np.uint8)
    grey[:, :20, 3] = 0
    grey[:, 20:30, 3] = 51  # a fifth
    Image.fromarray(grey).save("cut.png")
    (folder / "scene.toml").write_text(toml(view__image='"cut.png"', object__spine="[[5, 5], [30, 20]]"))
    row = scene.load("scene.toml").views[0].image[0, [0, 25, 35]]
    np.testing.assert_allclose(row, np.repeat([[0.5], [0.6], [1.0]], 3, axis=1), atol=1e-6)


def test_exif_turn_is_applied(folder):
    image = Image.open("photo.png").convert("RGB")
    exif = image.getexif()
    exif[0x0112] = 6  # turn right to view
    image.save("turned.jpg", exif=exif, quality=95)
    (folder / "scene.toml").write_text(toml(view__image='"turned.jpg"', object__spine="[[30, 20], [30, 60]]"))
    assert scene.load("scene.toml").views[0].image.shape == (80, 64, 3)
