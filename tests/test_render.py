"""Pictures, films and files against closed forms: discs, lines, boxes, counts."""

import gc
import threading
from pathlib import Path

import av
import numpy as np
import pytest
import trimesh

from symseek.render import platform
from symseek.render.evolution import Snapshot, evolution_frames
from symseek.render.export import write_glb, write_ply
from symseek.render.figures import potentials_sheet, views_sheet
from symseek.render.lighting import vertex_normals
from symseek.render.lines import Pen, coverage, dashes, runs, stroke
from symseek.render.overlay import Drawing, Photo, draw_overlay, line_width, window_around
from symseek.render.platform import RenderError
from symseek.render.raster import Renderer, Viewpoint
from symseek.render.video import write_mp4

ORANGE = (226, 142, 52)
ORIGIN = np.zeros(3)


def sphere(centre=(0, 0, 0), radius=1.0, subdivisions=4):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces)


# ---- shaded frames


@pytest.mark.parametrize(
    ("azimuth", "elevation", "at", "right", "down"),
    [
        (0, 0, (0.5, 0.3, 0.2), 0.5, 0.3),
        (90, 0, (0.2, 0.3, 0.5), 0.5, 0.3),  # from the right side what lies behind is on the right
        (0, 90, (0.5, 0.2, -0.3), 0.5, 0.3),  # from above what lies near the front viewer is below
        (180, 0, (-0.5, 0.3, 0.2), 0.5, 0.3),
    ],
)
@pytest.mark.parametrize(("width", "height", "supersample"), [(180, 120, 2), (101, 160, 3), (150, 150, 1)])
def test_sphere_is_its_disc(azimuth, elevation, at, right, down, width, height, supersample):
    viewpoint = Viewpoint(ORIGIN, 1.0, azimuth, elevation, margin=1.1)
    with Renderer(width, height, supersample) as renderer:
        alpha = renderer.alpha([(*sphere(at, 0.35), ORANGE)], viewpoint)
    scale = min(width, height) / 2 / 1.1
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    centre = [(alpha * axis).sum() / alpha.sum() for axis in (column, row)]
    # the sphere's image is a disc about the middle ((W - 1) / 2, (H - 1) / 2) plus its offset
    np.testing.assert_allclose(centre, [(width - 1) / 2 + right * scale, (height - 1) / 2 + down * scale], atol=0.1)
    assert np.sqrt(alpha.sum() / np.pi) == pytest.approx(0.35 * scale, abs=0.15)


def test_light_falls_from_the_upper_left_and_the_backdrop_stays():
    with Renderer(120, 120) as renderer:
        picture = renderer.shade([(*sphere(), ORANGE)], Viewpoint(ORIGIN, 1.0, margin=1.5)).astype(float)
        moved = renderer.shade([(*sphere((9, 9, 0)), ORANGE)], Viewpoint(ORIGIN, 1.0, margin=1.5))
    brightness = picture.mean(axis=2)
    assert brightness[40:55, 40:55].mean() > 1.3 * brightness[65:80, 65:80].mean()
    assert picture[45:60, 45:60, 0].mean() > 1.5 * picture[45:60, 45:60, 2].mean()  # orange
    np.testing.assert_array_equal(picture[:15], moved[:15])


def test_nearer_mesh_hides_the_further_one():
    near, far = (*sphere((0, 0, -0.5), 0.3), (255, 0, 0)), (*sphere((0, 0, 0.5), 0.4), (0, 0, 255))
    with Renderer(80, 80) as renderer:
        red, _, blue = renderer.shade([near, far], Viewpoint(ORIGIN, 1.0)).astype(int)[40, 40]
        back_red, _, back_blue = renderer.shade([near, far], Viewpoint(ORIGIN, 1.0, 180)).astype(int)[40, 40]
    assert red > 2 * blue and back_blue > 2 * back_red


def test_wire_frame_hides_its_back():
    angle = np.linspace(0, 2 * np.pi, 200)
    ring = np.column_stack([np.cos(angle), np.zeros(200), np.sin(angle)]) * 0.8
    viewpoint = Viewpoint(ORIGIN, 1.0, elevation=30.0)
    mesh = (*sphere(radius=0.8), ORANGE)
    with Renderer(200, 200) as renderer:
        plain = renderer.shade([mesh], viewpoint).astype(int)
        wired = renderer.shade([mesh], viewpoint, [ring], line_colour=(0, 0, 255), line_width=2.0).astype(int)
    changed = np.abs(wired - plain).sum(axis=2) > 60
    place = np.rint(viewpoint.project(ring, 200, 200)).astype(int)
    drawn = changed[place[:, 1], place[:, 0]]
    depth = np.sin(angle)  # Z away: negative is the front
    assert drawn[depth < -0.05].all()
    assert not drawn[depth > 0.35].any()  # nearer to the rim, less than 5 px, it may show


@pytest.mark.parametrize(("x", "supersample"), [(0.25, 2), (0.31, 3)])
def test_wire_frame_is_drawn_in_its_place(x, supersample):
    line = np.array([[x, -0.5, -1.0], [x, 0.5, -1.0]])
    viewpoint, mesh = Viewpoint(ORIGIN, 1.0, margin=1.0), (*sphere(radius=0.8), (0, 0, 0))
    with Renderer(100, 100, supersample) as renderer:
        wired = renderer.shade([mesh], viewpoint, [line]).astype(float)[50, :, 0]
        wired -= renderer.shade([mesh], viewpoint)[50, :, 0]
    assert (wired * np.arange(100)).sum() / wired.sum() == pytest.approx(49.5 + 50 * x, abs=0.1)


def test_mesh_that_is_not_finite_is_refused():
    vertices, faces = sphere(subdivisions=1)
    vertices[0] = np.nan
    with Renderer(16, 16) as renderer, pytest.raises(ValueError, match="finite"):
        renderer.shade([(vertices, faces, ORANGE)], Viewpoint(ORIGIN, 1.0))


def test_one_renderer_a_process_even_from_another_thread():
    caught = []

    def second():
        try:
            Renderer(16, 16)
        except RenderError as error:
            caught.append(error)

    with Renderer(16, 16) as renderer:
        thread = threading.Thread(target=second)
        thread.start()
        thread.join()
    assert "another Renderer" in str(caught[0])
    renderer.close()  # twice is harmless
    Renderer(16, 16).close()


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_memory_stays_flat():
    mesh = (*sphere(subdivisions=2), ORANGE)
    held = []
    with Renderer(64, 64) as renderer:
        for frames in (20, 200):
            for _ in range(frames):
                renderer.shade([mesh], Viewpoint(ORIGIN, 1.0))
            gc.collect()
            held.append(resident())
    assert held[1] - held[0] < 12e6  # 200 frames that compile their shaders anew take 600 MB


def resident() -> float:
    """Memory held by this process, bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096.0


# ---- platform


def test_platform_keeps_the_users_choice_and_falls_back_to_egl(monkeypatch):
    monkeypatch.setenv(platform.VARIABLE, "glx")
    assert platform.choose() == "glx"
    report = platform.describe()
    assert not report.works and "glx" in report.problem and report.remedy
    for loads, name in ((True, "osmesa"), (False, "egl")):
        monkeypatch.delenv(platform.VARIABLE)
        monkeypatch.setattr(platform, "_loads", lambda library, loads=loads: loads)
        assert platform.choose() == name
    monkeypatch.undo()
    report = platform.describe()
    assert report.works and report.renderer and not report.remedy


# ---- lines and overlay


@pytest.mark.parametrize("width", [0.5, 1.0, 2.3])
def test_line_covers_length_times_width(width):
    line = np.array([[10.3, 12.1], [52.7, 37.9]])
    whole = coverage([line], width, (50, 64))
    length = np.hypot(*(line[1] - line[0]))
    caps = np.pi * max(width, 1.0) ** 2 / 4 * min(width, 1.0)
    assert whole.sum() == pytest.approx(length * width + caps, rel=0.02)
    bent = np.insert(line, 1, line.mean(axis=0), axis=0)  # a point more changes nothing
    np.testing.assert_allclose(coverage([bent], width, (50, 64)), whole, atol=1e-4)


def test_lines_out_of_the_picture_or_not_finite_are_harmless():
    far = np.array([[-1e9, 20.0], [1e9, 20.0]])
    cover = coverage([far, np.array([[np.nan, 1.0], [3.0, 4.0]]), np.zeros((0, 2))], 1.0, (40, 30))
    np.testing.assert_allclose(cover[20], 1.0, rtol=1e-6)
    assert cover.sum() == pytest.approx(30)


def test_dashes_and_runs_part_a_line():
    line = np.column_stack([np.linspace(0, 100, 37), np.zeros(37)])
    cut = dashes(line, 6.0, 4.0)
    assert len(cut) == 10 and sum(part[-1, 0] - part[0, 0] for part in cut) == pytest.approx(60)
    flags = np.arange(37) % 10 < 6
    lengths = [sum(part[-1, 0] - part[0, 0] for part in runs(line, flags, value)) for value in (True, False)]
    assert lengths == pytest.approx([100 * 20 / 36, 100 * 16 / 36])  # of 36 steps 5 between 6 flagged points


@pytest.mark.parametrize("size", [960, 1600, 320])
@pytest.mark.parametrize("column", [40.0, 40.5, 41.0])
@pytest.mark.parametrize("window", [None, (20.25, 10.0, 84.25, 74.0), (-30.5, -0.5, 69.5, 99.5)])
def test_line_falls_where_the_photograph_shows_its_place(size, column, window):
    """A line along an edge of the photograph must lie on that edge in the picture, at any scale."""
    image = np.zeros((100, 120))
    image[:, 41:] = 1.0  # the edge is at column 40.5, half way between two pixel centres
    photo = Photo(image, (size, size), window)
    profile = photo.picture[size // 2, :, 0] / 255.0
    # no part of the ramp is cut off: the area of brightness gives the edge to a fraction of a pixel
    bright = np.flatnonzero(profile > 0.5)[0]
    span = slice(max(bright - 40, 0), bright + 40)
    edge = span.stop - 0.5 - profile[span].sum()
    canvas = np.zeros((size, size, 3), np.uint8)
    stroke(canvas, [photo.place(np.array([[column, -500.0], [column, 500.0]]))], Pen((255, 255, 255), 2.0))
    row = canvas[size // 2, :, 0].astype(float)
    centre = (row * np.arange(size)).sum() / row.sum()
    pixel = size / 120 if window is None else size / (window[2] - window[0])
    assert centre == pytest.approx(edge + (column - 40.5) * pixel, abs=0.06)


def test_window_stays_on_the_photograph():
    points = np.array([[90.0, 40.0], [99.0, 60.0]])
    left, top, right, bottom = window_around(points, (100, 100))
    assert right == pytest.approx(99.5) and right - left == pytest.approx(29) and bottom - top == pytest.approx(29)
    left, top, right, bottom = window_around(points, (100, 22))  # less room, and in the middle
    assert (left, right) == pytest.approx((-0.7, 21.7))


def test_overlay_shows_what_is_supported():
    image = np.full((60, 80), 0.5, np.float32)
    circle = np.column_stack([np.cos(t := np.linspace(0, 2 * np.pi, 80)), np.sin(t)]) * 20 + [40, 30]
    flags = circle[:, 0] > 40
    picture = draw_overlay(image, [Drawing((circle,), (circle,), (flags,), circle[:9], circle[9:18])])
    assert picture.shape == (720, 960, 3) and picture.dtype == np.uint8

    def reddish(points):
        column, row = np.rint((points + 0.5) * 12 - 0.5).astype(int).T
        return picture[row, column, 0].astype(int) > picture[row, column, 1].astype(int) + 40

    assert not reddish(circle[30:50]).all() and reddish(circle[30:50]).any()  # dashed
    assert not reddish(circle[60:70]).any()
    photo = Photo(image, (960, 720))
    small, large = (Drawing(((circle - [40, 30]) * scale + [40, 30],)) for scale in (0.2, 0.9))
    assert line_width(photo, [small]) < 0.9 and line_width(photo, [large]) == pytest.approx(1.5)
    assert draw_overlay(np.zeros((40, 3000, 3), np.uint8), []).shape == (21, 1600, 3)


# ---- figures and film


def test_potentials_span_white_to_black():
    ramp = np.tile(np.linspace(2.0, 5.0, 40), (30, 1))
    sheet = potentials_sheet([(8.0, ramp), (4.0, np.zeros((30, 40)))], foreground=ramp * 0, tile=60)
    height, width, gap = 62, 82, 14
    tiles = [sheet[gap + 1 : gap + 61, gap + k * (width + gap) + 1 :][:, :80] for k in range(3)]
    assert tiles[1].min() == 0 and tiles[1].max() == 255 and (np.diff(tiles[1][30, :, 0].astype(int)) <= 0).all()
    assert (tiles[0] == 255).all() and (tiles[2] == 255).all()
    assert (sheet[gap + height :] < 200).any()  # labels


def test_views_sheet_has_six_views():
    sheet = views_sheet([(*sphere(subdivisions=2), ORANGE)], [np.array([[1.0, 0, 0], [0, 1.0, 0]])], tile=60)
    assert sheet.shape == (2 * 62 + 2, 3 * 62 + 2, 3)
    lit = sheet.astype(int)[..., 0] - sheet[..., 2] > 40
    assert all(lit[32 + 62 * row, 32 + 62 * column] for row in range(2) for column in range(3))


def film():
    image = np.random.default_rng(0).random((50, 70, 3))
    snapshots = []
    for radius in np.linspace(4, 12, 5):
        vertices, faces = sphere((35, 25, 0), radius, subdivisions=2)
        circle = np.column_stack([np.cos(t := np.linspace(0, 6.3, 40)), np.sin(t)]) * radius + [35, 25]
        snapshots.append(Snapshot([Drawing((), (circle,))], [(vertices, faces)], f"sigma {radius:.0f} px"))
    return evolution_frames(image, snapshots, fps=10, seconds=(1.0, 0.3, 0.7), panel=96)


def test_film_grows_rests_and_turns():
    frames = list(film())
    assert len(frames) == 20 and all(frame.shape == (96, 192, 3) for frame in frames)
    orange = [(frame[:, 98:, 0].astype(int) - frame[:, 98:, 2] > 40).sum() for frame in frames]
    assert orange[0] < 0.2 * orange[9]  # (4 / 12)^2 = 0.11 of the area: one framing for all
    np.testing.assert_array_equal(frames[9][:, :90], frames[-1][:, :90])
    assert (frames[0][:, :90] != frames[9][:, :90]).any()


def test_film_is_drawn_as_it_is_asked_for_and_lets_go():
    frames = film()
    next(frames)
    with pytest.raises(RenderError):
        Renderer(16, 16)
    frames.close()
    Renderer(16, 16).close()
    with pytest.raises(ValueError, match="snapshot"):
        next(evolution_frames(np.zeros((8, 8)), []))


# ---- video


def clip(count, shape=(48, 64, 3)):
    for index in range(count):
        frame = np.full(shape, (200, 60, 30), np.uint8)
        frame[:, : 4 + index] = (20, 90, 220)
        yield frame


@pytest.mark.parametrize("shape", [(48, 64, 3), (47, 65, 3)])
def test_video_plays_everywhere(tmp_path, shape):
    path = tmp_path / "clip.mp4"
    assert write_mp4(path, clip(30, shape), fps=25) == 30
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec.name, stream.pix_fmt, stream.average_rate) == ("h264", "yuv420p", 25)
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert len(frames) == 30 and frames[0].shape == (48, 64 if shape[1] == 64 else 66, 3)
    np.testing.assert_allclose(frames[9][24, 50], (200, 60, 30), atol=6)
    np.testing.assert_allclose(frames[9][24, 5], (20, 90, 220), atol=6)
    content = path.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")
    assert [file.name for file in tmp_path.iterdir()] == ["clip.mp4"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
@pytest.mark.parametrize("after", [0, 1, 40])
def test_broken_off_video_leaves_nothing(tmp_path, error, after):
    closed = []

    def broken():
        try:
            yield from clip(after)
            raise error
        finally:
            closed.append(True)

    (tmp_path / "old.mp4").write_bytes(b"old")
    with pytest.raises(error):
        write_mp4(tmp_path / "old.mp4", broken())
    assert [file.name for file in tmp_path.iterdir()] == ["old.mp4"] and closed
    assert (tmp_path / "old.mp4").read_bytes() == b"old"


def test_video_refuses_bad_frames(tmp_path):
    for frames, words in (
        ([], "at least one"),
        ([np.zeros((8, 8, 3))], "uint8"),
        ([np.zeros((16, 16, 3), np.uint8), np.zeros((16, 18, 3), np.uint8)], "frame 2"),
    ):
        with pytest.raises(ValueError, match=words):
            write_mp4(tmp_path / "x.mp4", frames)
    assert not list(tmp_path.iterdir())


# ---- meshes


def pear():
    """A closed shape without symmetry: X from -1 to 2, Y from -3 to 4, Z from -0.5 to 0.7."""
    vertices, faces = sphere(subdivisions=4)
    scale = np.where(vertices > 0, [2.0, 4.0, 0.7], [1.0, 3.0, 0.5])
    return vertices * scale, faces


PEAR_VOLUME = 4 / 3 * np.pi * np.prod([1.5, 3.5, 0.6])  # each octant is an eighth of an ellipsoid


def test_ply_reopens_whole(tmp_path):
    vertices, faces = pear()
    write_ply(tmp_path / "pear.ply", vertices, faces, units="mm")
    mesh = trimesh.load_mesh(tmp_path / "pear.ply", process=False)
    assert mesh.is_watertight and len(mesh.vertices) == len(vertices)
    assert mesh.volume == pytest.approx(PEAR_VOLUME, rel=0.005)
    np.testing.assert_allclose(mesh.bounds, [[-1, -3, -0.5], [2, 4, 0.7]], atol=0.01)
    head, body = (tmp_path / "pear.ply").read_bytes().split(b"end_header\n", 1)
    rows = np.frombuffer(body, "<f4", len(vertices) * 6).reshape(-1, 6)
    np.testing.assert_allclose(rows[:, 3:], vertex_normals(vertices, faces), atol=1e-6)
    assert b"comment units: mm" in head and b"comment frame: X right, Y down, Z away" in head


def test_vertex_normals_of_a_sphere_are_its_radii():
    vertices, faces = sphere(subdivisions=4)
    assert (vertex_normals(vertices, faces) * vertices).sum(axis=1).min() > 0.9995


def test_glb_is_in_metres_with_y_up(tmp_path):
    vertices, faces = pear()
    write_glb(tmp_path / "pear.glb", vertices, faces, metres_per_unit=0.01, name="pear")
    mesh = trimesh.load_mesh(tmp_path / "pear.glb", process=False)
    assert mesh.is_watertight and mesh.volume == pytest.approx(PEAR_VOLUME * 1e-6, rel=0.005)
    # Y down becomes Y up, Z away becomes +Z toward the viewer
    np.testing.assert_allclose(mesh.bounds, [[-0.01, -0.04, -0.007], [0.02, 0.03, 0.005]], atol=1e-4)


def test_bad_meshes_are_refused(tmp_path):
    vertices, faces = pear()
    with pytest.raises(ValueError, match="faces name vertices"):
        write_ply(tmp_path / "x.ply", vertices[:10], faces)
    with pytest.raises(ValueError, match="positive"):
        write_glb(tmp_path / "x.glb", vertices, faces, metres_per_unit=0.0)
    assert not list(tmp_path.iterdir())
