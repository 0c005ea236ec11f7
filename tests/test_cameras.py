"""Cameras from COLMAP's and nerfstudio's files, and lenses, by the projections of known points."""

import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import symseek
from benchmarks import truth
from symseek.checks import SceneError
from symseek.scenes import views as generator
from symseek.sim.lens import Lens

pytest.importorskip("pycolmap")

POINTS = np.array([[0.3, -0.2, 4.0], [-0.5, 0.4, 5.0], [0.1, 0.6, 3.5], [0.0, 0.0, 6.0]])
F, MIDDLE, SIZE = np.array([500.0, 510.0]), np.array([311.0, 236.0]), (640, 480)
TURNS = Rotation.from_euler("yxz", [[10, 5, 3], [-12, 4, 170]], degrees=True)
SHIFTS = np.array([[0.2, -0.1, 0.3], [-0.3, 0.2, 0.1]])
NAMES = ("left/a.png", "b.png")
BEND = (-0.28, 0.07, 0.002, -0.001)


def opencv(flat: np.ndarray, k1: float, k2: float, p1: float, p2: float) -> np.ndarray:
    """OpenCV's documented formula, points of the plane at depth 1, shape (n, 2)."""
    x, y = flat.T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2
    return np.stack([
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
        y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
    ], axis=1)  # fmt: skip


def straightened(flat: np.ndarray, bend=BEND) -> np.ndarray:
    """Its inverse, by fixed points."""
    found = flat.copy()
    for _ in range(200):
        found += flat - opencv(found, *bend)
    return found


def seen(k: int, bend=None) -> np.ndarray:
    """Image points of POINTS, pixel centres at .5, written out."""
    turned = np.array([TURNS[k].as_matrix() @ p + SHIFTS[k] for p in POINTS])
    flat = turned[:, :2] / turned[:, 2:]
    return F * (flat if bend is None else opencv(flat, *bend)) + MIDDLE


def colmap_text(folder: Path, bend=None):
    numbers = " ".join(map(str, [*F, *MIDDLE, *(bend or ())]))
    (folder / "cameras.txt").write_text(
        f"# made by hand\n7 {'OPENCV' if bend else 'PINHOLE'} {SIZE[0]} {SIZE[1]} {numbers}\n"
    )
    lines = []
    for k, name in enumerate(NAMES):
        x, y, z, w = TURNS[k].as_quat()
        lines += [f"{k + 3} {w} {x} {y} {z} {' '.join(map(str, SHIFTS[k]))} 7 {name}", ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")


def colmap_binary(folder: Path, bend=None):
    numbers = [*F, *MIDDLE, *(bend or ())]
    head = struct.pack("<QIiQQ", 1, 7, 4 if bend else 1, *SIZE)
    (folder / "cameras.bin").write_bytes(head + struct.pack(f"<{len(numbers)}d", *numbers))
    out = struct.pack("<Q", 2)
    for k, name in enumerate(NAMES):
        x, y, z, w = TURNS[k].as_quat()
        out += struct.pack("<I7dI", k + 3, w, x, y, z, *SHIFTS[k], 7) + name.encode() + b"\0" + struct.pack("<Q", 0)
    (folder / "images.bin").write_bytes(out)


def nerfstudio(folder: Path, bend=None):
    frames = []
    for k, name in enumerate(NAMES):
        out = np.eye(4)
        out[:3, :3] = TURNS[k].as_matrix().T
        out[:3, 3] = -out[:3, :3] @ SHIFTS[k]
        out[:3, 1:3] *= -1  # Y up, Z back
        frames.append({"file_path": name, "transform_matrix": out.tolist()})
    top = {"fl_x": F[0], "fl_y": F[1], "cx": MIDDLE[0], "cy": MIDDLE[1], "w": SIZE[0], "h": SIZE[1], "frames": frames}
    top |= {"camera_model": "OPENCV"} | dict(zip(("k1", "k2", "p1", "p2"), bend or (), strict=False))
    (folder / "transforms.json").write_text(json.dumps(top))


FORMATS = {"text": (colmap_text, "."), "binary": (colmap_binary, "."), "nerfstudio": (nerfstudio, "transforms.json")}


@pytest.fixture
def folder(tmp_path):
    """Two photographs whose cameras a file will hold."""
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    grey = np.where((rows - 240) ** 2 / 100**2 + (columns - 320) ** 2 / 200**2 < 1, 200, 40).astype(np.uint8)
    (tmp_path / "left").mkdir()
    for name in NAMES:
        Image.fromarray(grey).save(tmp_path / name)
    return tmp_path


def _built(folder: Path, cameras: str, **more) -> symseek.Scene:
    data = {"cameras": cameras, "images": ".", "object": [{"spine": POINTS[:2].tolist()}], **more}
    return symseek.scene.build(data, folder, "ring.toml")


@pytest.mark.parametrize("bend", [None, BEND], ids=["pinhole", "distorted"])
@pytest.mark.parametrize("form", FORMATS)
def test_a_files_cameras_see_known_points_where_they_are(form, bend, folder):
    write, name = FORMATS[form]
    write(folder, bend)
    scene = _built(folder, name)
    assert [view.name for view in scene.views] == ["b", "left_a"]
    for view, k in zip(scene.views, (1, 0), strict=True):
        np.testing.assert_allclose(view.camera.project(POINTS), seen(k) - 0.5, atol=1e-6)
        assert (view.lens is None) == (bend is None)
        if view.lens is not None:
            np.testing.assert_allclose(view.lens.straight(seen(k, bend) - 0.5), seen(k) - 0.5, atol=1e-6)


def test_a_scaled_image_takes_its_camera_along(folder):
    colmap_text(folder, BEND)
    for name in NAMES:
        Image.open(folder / name).resize((320, 240)).save(folder / name)
    views = [{"name": "a", "image": "left/a.png"}, {"name": "b", "image": "b.png"}]
    for k, view in enumerate(_built(folder, ".", view=views).views):
        np.testing.assert_allclose(view.camera.project(POINTS), seen(k) / 2 - 0.5, atol=1e-6)
        assert view.lens is not None
        np.testing.assert_allclose(view.lens.bent(seen(k) / 2 - 0.5), seen(k, BEND) / 2 - 0.5, atol=1e-6)


@pytest.mark.parametrize("more", [(), (0.01,), (0.01, 0.02, -0.01, 0.003)])
def test_opencvs_coefficients_in_their_order(more):
    K = np.array([[F[0], 0, MIDDLE[0]], [0, F[1], MIDDLE[1]], [0, 0, 1]])
    flat = np.random.default_rng(1).uniform(-0.4, 0.4, (20, 2))
    k3, k4, k5, k6 = [*more, 0, 0, 0, 0][:4]
    r2 = (flat**2).sum(axis=1)
    k1, k2, p1, p2 = BEND
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    expected = F * (opencv(flat, 0, 0, p1, p2) + (radial - 1)[:, None] * flat) + MIDDLE
    lens = Lens.opencv(K, [*BEND, *more], SIZE)
    np.testing.assert_allclose(lens.bent(F * flat + MIDDLE), expected, atol=1e-9)


def test_a_fisheye_is_made_straight():
    lens = Lens("OPENCV_FISHEYE", [*F, *(MIDDLE + 0.5), 0.05, -0.01, 0.002, 0.0], SIZE)
    flat = np.random.default_rng(2).uniform(-0.8, 0.8, (20, 2))
    r = np.linalg.norm(flat, axis=1)
    angle = np.arctan(r)
    bent = angle * (1 + 0.05 * angle**2 - 0.01 * angle**4 + 0.002 * angle**6)
    np.testing.assert_allclose(lens.straight(F * flat * (bent / r)[:, None] + MIDDLE), F * flat + MIDDLE, atol=1e-6)


def _pattern(points: np.ndarray) -> np.ndarray:
    return 0.5 + 0.3 * np.sin(points[..., 0] / 9) * np.cos(points[..., 1] / 7)


@pytest.mark.parametrize("bend", [BEND, (0.25, 0.05, 0.0, 0.0)], ids=["barrel", "pincushion"])
def test_an_image_is_made_straight(bend):
    K = np.array([[150.0, 0, 79.2], [0, 150, 61.0], [0, 0, 1]])
    size, middle = (160, 120), K[:2, 2]
    grid = np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)), axis=-1)
    flat = ((grid - middle) / 150).reshape(-1, 2)
    bent = _pattern(150 * straightened(flat, bend) + middle).reshape(120, 160).astype(np.float32)
    lens = Lens.opencv(K, bend, size)
    places = 150 * opencv(flat, *bend) + middle
    inside = ((places >= -0.5) & (places <= [159.5, 119.5])).all(axis=1).reshape(120, 160)
    np.testing.assert_array_equal(lens.covered, inside)
    assert inside.all() == (bend == BEND)
    well = ((places >= 0) & (places <= [159, 119])).all(axis=1).reshape(120, 160)
    error = np.abs(lens.image(bent) - _pattern(grid))[well]
    assert error.max() < 0.3 / 49 / 2  # linear between pixels: an eighth of the second derivatives along both
    np.testing.assert_array_equal(lens.mask(np.zeros((120, 160), bool)), ~inside)


def test_clicks_in_bent_images_lead_to_the_true_solid():
    made = generator.pair(2, True, kind="bent", size=256)
    views, spines = [], {}
    for k, (image, camera) in enumerate(zip(made.images, made.cameras, strict=True)):
        # K and pose of a camera that looks at the origin, see generator.looking_in
        far, middle = camera.matrix[2, 3], camera.matrix[:2, 3] / camera.matrix[2, 3]
        R = camera.matrix[:, :3].copy()
        R[:2] -= middle[:, None] * R[2]
        f = np.linalg.norm(R[0])
        R[:2] /= f
        bend = (-4.0, 0.0, 0.0, 0.0)  # some px at the ends of the solid
        grid = np.stack(np.meshgrid(np.arange(256.0), np.arange(256.0)), axis=-1).reshape(-1, 2)
        source = f * straightened((grid - middle) / f, bend) + middle
        bent = _sampled(image, source).reshape(256, 256)
        K = [[f, 0, middle[0]], [0, f, middle[1]], [0, 0, 1]]
        views.append({"name": f"eye{k}", "image": bent, "projection": "perspective", "K": K, "R": R, "t": [0, 0, far],
                      "distortion": list(bend)})  # fmt: skip
        spines[f"eye{k}"] = f * opencv((made.clicks[k] - middle) / f, *bend) + middle
    scene = symseek.scene.build({"view": views, "object": [{"spines": spines}]}, Path(), "bent")
    straight = symseek.reconstruct(scene).objects[0]
    for view in views:
        del view["distortion"]
    bent = symseek.reconstruct(symseek.scene.build({"view": views, "object": [{"spines": spines}]}, Path(), "bent")).objects[
        0
    ]
    errors = [truth.to_surface(o.vertices, (made.vertices, made.faces)).mean() / made.length for o in (straight, bent)]
    assert errors[0] < 0.0025 < 0.004 < errors[1], errors


def _sampled(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values at places (n, 2), linear between pixels."""
    low = np.clip(np.floor(places).astype(int), 0, np.array(image.shape[::-1]) - 2)
    (x, y), (u, v) = low.T, np.clip(places - low, 0, 1).T
    left, right = (image[y, x + i] * (1 - v) + image[y + 1, x + i] * v for i in (0, 1))
    return (left * (1 - u) + right * u).astype(np.float32)


def _without(key: str):
    def change(folder: Path):
        nerfstudio(folder)
        data = json.loads((folder / "transforms.json").read_text())
        del data[key]
        (folder / "transforms.json").write_text(json.dumps(data))

    return change


def _torn(folder: Path):
    colmap_text(folder)
    (folder / "images.txt").write_text("1 0")


@pytest.mark.parametrize(
    ("write", "changes", "expected"),
    [
        (None, {"cameras": "spars"}, ["cameras", "does not exist", "sparse/0"]),
        (None, {"cameras": "left"}, ["cameras", "holds no cameras and images"]),
        (None, {"cameras": "b.png"}, ["cameras", "neither a folder nor a .json"]),
        (lambda f: (f / "transforms.json").write_text("{"), {"cameras": "transforms.json"}, ["transforms.json", "as JSON"]),
        (_without("fl_x"), {"cameras": "transforms.json"}, ["transforms.json", "frames[0].fl_x", "is missing"]),
        (_without("frames"), {"cameras": "transforms.json"}, ["transforms.json: frames", "is missing"]),
        (_torn, {}, ["cameras", "cannot be read"]),
        (colmap_text, {"view": [{"image": "c.png"}]}, ["view[0].image", "'c.png' is no image", "did you mean b.png"]),
        (colmap_text, {"view": [{"image": np.eye(32)}]}, ["view[0].camera", "is missing"]),
        (colmap_text, {"view": [{"image": np.eye(32), "camera": "b.png"}]}, ["view[0].image", "32 x 32", "640 x 480"]),
        (colmap_text, {"view": [{"image": "b.png", "K": [[1]]}]}, ["view[0].K", "does not belong to a view that is file"]),
        (colmap_text, {"images": "elsewhere"}, ["view[0].image", "elsewhere"]),
        (colmap_text, {"scale": 2.0}, ["scale", "has no meaning beside a file view"]),
    ],
)  # fmt: skip
def test_files_at_fault_are_named(write, changes, expected, folder):
    if write is not None:
        write(folder)
    with pytest.raises(SceneError) as raised:
        _built(folder, **{"cameras": ".", **changes})
    for words in expected:
        assert words in str(raised.value)


def test_a_lens_needs_its_package_and_good_numbers(folder, monkeypatch):
    K = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]
    view = {"image": "b.png", "projection": "perspective", "K": K, "R": np.eye(3), "t": [0, 0, 0], "distortion": [0.1, 0]}
    data = {"view": [view], "object": [{"spine": POINTS[:2]}]}
    with pytest.raises(SceneError, match=r"view\[0\].distortion: holds 2 numbers"):
        symseek.scene.build(data, folder, "bent.toml")
    view["distortion"] = [0.1, 0, 0, 0]
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(SceneError, match=r"symseek\[cameras\]"):
        symseek.scene.build(data, folder, "bent.toml")
