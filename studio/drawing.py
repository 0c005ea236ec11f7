"""What is seen: a photograph as a plane with the models drawn on it, and the models in space before it.

The viewer's space is that of the photograph in hand: x and y are column and row, z leads away. What is drawn on it is
projected by its view's own camera, so it lies where it belongs whatever the viewer's eye does; models in space are turned,
scaled and moved as a whole to where that camera sees their middle, and the other views' photographs with them.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import viser
from viser.transforms import SO3

from symseek.sim.initial import lift
from symseek.sim.problem import View
from symseek.sim.surface import refine

from .handle import rate
from .lines import COARSE, FINE, lines_of
from .part import Snapshot
from .ribbons import Ribbons
from .state import Point

SIDE_MOST = 2048
"""Pixels of the longer side of the photograph as it is sent."""
MANY = 8
"""Models from which on fewer lines and triangles are drawn."""
LAYER = 1e-3
"""Between what lies on the photograph, one above the other [its shorter side]."""
WINDOW = 800
"""Most pixels of a window's height that are counted: a fine screen has more, which are smaller."""
LINES = {"wire": 1.0, "contour": 3.0, "spine": 2.0, "axis": 2.0, "springs": 3.0, "marks": 2.0}
"""What is drawn on it, from below, and how thick [screen px]."""
BESIDE = (0.25, 0.9)
"""Cosine between two views' lines of sight, from and to, where the one's photograph stands beside the other."""
CROSS, POINT = 5.0, 5.0
"""Half a cross for a mark, and the radius of a point of an axis [screen px]."""
DRAWN = itertools.count()
"""Scenes: a page keeps the pose of what it showed by the same name before."""
LIGHTS, AMBIENT = (("key", (-0.6, -1.0, -0.7), 2.6), ("fill", (1.0, 0.3, -0.4), 0.5)), 0.6
"""Lights in space: from where, how bright."""
PLAIN = float(np.pi)
"""How bright light from everywhere is that shows colours as they are."""
SPRING, AXIS, SPINE, FIRST, HANDLE = (255, 148, 40), (255, 255, 255), (255, 222, 60), (255, 255, 255), (255, 0, 200)


class Frame:
    """Between the world and the viewer's space; see the module.

    Args:
        view: image and camera.
        depth: of what lies about the photograph's middle [world units].
    """

    def __init__(self, view: View, depth: float):
        self.camera = view.camera
        height, width = view.image.shape[:2]
        middle = np.array([(width - 1) / 2, (height - 1) / 2])
        self.origin = lift(middle[None], view.camera, depth)[0]
        along = rate(view.camera, self.origin)
        away = view.camera.sight(self.origin)
        right = along[0] - away * (along[0] @ away)
        right /= np.linalg.norm(right)
        self.turn = np.stack([right, np.cross(away, right), away])
        self.scale = float(np.linalg.norm(along[1]))
        self.at = np.array([*middle, -0.45 * min(height, width)])

    def shown(self, points: np.ndarray) -> np.ndarray:
        """World points (..., 3) in the viewer's space."""
        return self.scale * (points - self.origin) @ self.turn.T + self.at

    def world(self, points: np.ndarray) -> np.ndarray:
        """The other way."""
        return (points - self.at) @ self.turn / self.scale + self.origin


def material_point(snapshot: Snapshot, gaps: np.ndarray) -> tuple[float, float]:
    """Coordinates (x, s) of the node where `gaps`, shape (N_x, N_s), is least."""
    i, j = np.unravel_index(int(gaps.argmin()), gaps.shape)
    nx, ns = snapshot.tube.shape[:2]
    return float(i / nx), float(j / (ns - 1))


def away_from(snapshot: Snapshot, view: View, place: Point) -> np.ndarray:
    """How far each node is from an image point [px], shape (N_x, N_s); those on the far side a little more."""
    gaps = np.linalg.norm(view.camera.project(snapshot.tube) - np.asarray(place), axis=2)
    depth = view.camera.distance(snapshot.tube)
    return gaps + np.where(depth > depth.mean(axis=0) + 1e-6, 0.05 * np.ptp(gaps), 0.0)


def rgb(colour: str) -> tuple[int, int, int]:
    """Numbers of a colour "#rrggbb"."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


class Drawing:
    """The nodes of the viewer's scene.

    Args:
        scene: of the viser server.
        views: images and cameras.
        frames: see `Frame`, one a view.
    """

    def __init__(self, scene: viser.SceneApi, views: Sequence[View], frames: Sequence[Frame]):
        self.scene, self.views, self.frames = scene, views, frames
        self._models: dict[int, viser.MeshHandle] = {}
        self._faces: dict[int, tuple] = {}
        scene.reset()
        scene.configure_default_lights(False)  # dear without a graphics card, as surroundings to be mirrored are
        scene.configure_environment_map(None)
        self._lamps = [
            scene.add_light_directional(f"/lights/{name}", intensity=intensity, position=place)
            for name, place, intensity in LIGHTS
        ]
        self._ambient = scene.add_light_ambient("/lights/all", intensity=AMBIENT)
        self.pictures, self._middles, drawn = [], [], next(DRAWN)
        for v, view in enumerate(views):
            pixels, size = _pixels(view.image)
            self.pictures.append(
                scene.add_image(
                    f"/photograph {drawn}.{v}", pixels, *size, jpeg_quality=92, cast_shadow=False, receive_shadow=False
                )
            )
            self._middles.append(np.array([*(size - 1) / 2, 0.0]))
        self._lines = {name: Ribbons(scene, name, thickness) for name, thickness in LINES.items()}
        self._points = scene.add_point_cloud(
            "/drawn/points", np.zeros((1, 3)), np.zeros((1, 3), np.uint8), point_size=1.0, point_shape="circle",
            precision="float32", point_shading="flat", visible=False,
        )  # fmt: skip
        self.look(0, False)

    def look(self, v: int, in_space: bool) -> None:
        """Makes view v the one in hand; beside models in space stand the photographs of those that look the same way."""
        self.view, self.frame = self.views[v], self.frames[v]
        height, width = self.view.image.shape[:2]
        self.size, self.unit = np.array([width, height], float), float(min(width, height))
        for w, (picture, frame, middle) in enumerate(zip(self.pictures, self.frames, self._middles, strict=True)):
            turn = self.frame.turn @ frame.turn.T
            picture.visible = w == v or (in_space and BESIDE[0] < turn[2, 2] < BESIDE[1])
            own = w == v
            picture.position = middle if own else self.frame.shown(frame.world(middle))
            picture.wxyz = SO3.from_matrix(np.eye(3) if own else turn).wxyz
            picture.scale = 1.0 if own else self.frame.scale / frame.scale
        self.pixel = self.unit / WINDOW
        self._points.position = (0, 0, -LAYER * self.unit * (len(LINES) + 1))
        for lamp in self._lamps:
            lamp.visible = in_space
        self._ambient.intensity = AMBIENT if in_space else PLAIN

    def seen_from(self, eye: np.ndarray, fov: float, height: int) -> bool:
        """Keeps lines as thick as they are for an eye at a place, with a field of view [rad] and a window's height [px].

        Returns:
            Whether they are to be drawn anew.
        """
        away = float(np.linalg.norm(eye - [*(self.size - 1) / 2, 0.0]))
        pixel = 2 * away * np.tan(fov / 2) / min(height, WINDOW)
        changed = abs(pixel / self.pixel - 1) > 0.05
        self.pixel = pixel if changed else self.pixel
        return changed

    def picture(self, v: int, image: np.ndarray) -> None:
        """Shows another frame of view v."""
        self.pictures[v].image = _pixels(image)[0]

    def _set(self, name: str, segments: np.ndarray, colours: Sequence[float] | np.ndarray) -> None:
        """Segments (n, 2, 2) in the photograph, each of its colour, or all of one."""
        layer = 1 + list(LINES).index(name)
        self._lines[name].show(segments, np.asarray(colours), -LAYER * self.unit * layer, self.pixel)

    def models(self, snapshots: Mapping[int, Snapshot], colours: Mapping[int, str], in_space: bool) -> None:
        """Draws models on the photograph, the further ones first, or in space."""
        camera, uids = self.view.camera, list(snapshots)
        middles = np.array([s.spine.mean(axis=0) for s in snapshots.values()]).reshape(-1, 3)
        order = [uids[k] for k in np.argsort(-camera.distance(middles), kind="stable")]
        shown = [snapshots[uid] for uid in order]
        own = np.array([rgb(colours.get(uid, "#ffffff")) for uid in order], float).reshape(-1, 3)
        many = len(order) >= MANY
        nothing = np.zeros((0, 2, 2)), np.zeros(0, int)
        wire, contour, spine = lines_of(shown, self.view, COARSE if many else FINE) if shown else (nothing,) * 3
        self._set("wire", wire[0], (0.55 * own + 0.45 * 255)[wire[1]])
        self._set("contour", contour[0], own[contour[1]])
        self._set("spine", spine[0], SPINE)
        pulls = [camera.project(pull) for s in shown for pull in s.pulls]
        self._set("springs", np.array(pulls).reshape(-1, 2, 2), SPRING)
        for uid in [uid for uid in self._models if uid not in snapshots]:
            self._models.pop(uid).remove()
        if in_space:
            for uid in order:
                self._model(uid, snapshots[uid], rgb(colours.get(uid, "#ffffff")), many)
        for model in self._models.values():
            model.visible = in_space

    def _model(self, uid: int, s: Snapshot, colour: tuple[int, int, int], many: bool) -> None:
        nx, ns = s.tube.shape[:2]
        vertices, faces = refine(s.tube, 2 * (nx // (4 if many else 1)), ns if many else 2 * ns - 1, s.cuts)
        vertices = self.frame.shown(vertices).astype(np.float32)
        kind = (len(vertices), tuple(s.cuts))
        if uid in self._models and self._faces[uid] == kind:
            self._models[uid].vertices = vertices
            self._models[uid].color = colour
        else:
            self._models[uid] = self.scene.add_mesh_simple(f"/models/{uid}", vertices, faces.astype(np.uint32), color=colour)
            self._faces[uid] = kind

    def in_space(self) -> Mapping[int, viser.MeshHandle]:
        """Models in space, by uid."""
        return dict(self._models)

    def marks(self, marks: Sequence[tuple[np.ndarray, tuple[int, int, int]]]) -> None:
        """Draws a cross at each of some image points (n, 2), each lot of its colour."""
        arms = CROSS * self.pixel * np.array([[[-1.0, -1], [1, 1]], [[-1, 1], [1, -1]]])
        crosses = [(points[:, None, None] + arms).reshape(-1, 2, 2) for points, _ in marks]
        colours = [colour for cross, (_, colour) in zip(crosses, marks, strict=True) for _ in cross]
        self._set("marks", np.concatenate([np.zeros((0, 2, 2)), *crosses]), np.reshape(colours, (-1, 3)))

    def axes(self, axes: Sequence[tuple[np.ndarray, str, bool]], handle: np.ndarray | None) -> None:
        """Draws the rough axes, (n, 2) each with its colour, the chosen one with its points, and its radius' handle."""
        lines = [(np.stack([a[:-1], a[1:]], axis=1), AXIS if chosen else rgb(c)) for a, c, chosen in axes if len(a) > 1]
        lines += [] if handle is None else [(handle[None], HANDLE)]
        segments = np.concatenate([np.zeros((0, 2, 2)), *(line for line, _ in lines)])
        own = np.array([c for line, c in lines for _ in line], float).reshape(-1, 3)
        self._set("axis", segments, own)
        dots = [(a, rgb(c)) for a, c, chosen in axes if chosen and len(a)]
        self._points.visible = bool(dots)
        if dots:
            self._points.point_size = POINT * self.pixel
            points, colour = dots[0]
            colours = [FIRST] + [colour] * (len(points) - 1)
            if handle is not None:
                points, colours = np.concatenate([points, handle[1:]]), [*colours, HANDLE]
            self._points.points = np.column_stack([points, np.zeros(len(points))]).astype(np.float32)
            self._points.colors = np.array(colours, np.uint8)


def _pixels(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An image as it is sent, uint8 (h, w, 3), and the size that it covers [px]."""
    height, width = image.shape[:2]
    thin = -(-max(height, width) // SIDE_MOST)
    pixels = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    pixels = np.rint(pixels[: height - height % thin, : width - width % thin] * 255).astype(np.uint8)
    if thin > 1:
        h, w = pixels.shape[0] // thin, pixels.shape[1] // thin
        pixels = pixels.reshape(h, thin, w, thin, 3).mean(axis=(1, 3)).astype(np.uint8)
    return pixels, np.array(pixels.shape[1::-1]) * thin
