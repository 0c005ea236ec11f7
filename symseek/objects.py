"""The objects of a scene file, tubes, snakes and sheets with their springs: read and checked."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from .checks import Bounds, Table, is_number, shown
from .sim.beyond import NAMES
from .sim.curve import shoelace
from .sim.initial import lift
from .sim.problem import Settings, Sheet, SheetMaterial, Snake, SnakeMaterial, Tube, View
from .sim.sights import spread, triangulated
from .sim.spring import Spring
from .weights import breaks_of, material_of

GRID_MIN, GRID_MAX = (8, 6), 512  # around, along
NODES = (12, 2000)  # of a snake
SPINE_MIN = 10.0  # px, the whole
STEP_MIN = 0.1  # px, between any two points
LATER = 1_000_000  # most iterations of a frame after the first
SEEN = 0.5  # share of the axis that each view's image must hold

LINE_BOUNDS: Bounds = {f.name: (0.0, 1e6) for m in (SnakeMaterial, SheetMaterial) for f in fields(m)}

SHARED_KEYS = ["name", "kind", "material", "not_here", "spring"]
KINDS = {
    "tube": ["spine", "spines", "radius", "depth", "grid", "break", "figure", "goes_on"],
    "snake": ["points", "closed", "nodes"],
    "sheet": ["corners", "depth", "grid", "load", "image"],
}
OBJECT_KEYS = [*SHARED_KEYS, *dict.fromkeys(key for keys in KINDS.values() for key in keys)]
SPRING_KEYS = ["anchor", "view", "point", "near", "stiffness", "reach", "frame", "start", "stop"]


def build_object(
    table: Table, views: list[View], scale: float, default_name: str | None, settings: Settings
) -> Tube | Snake | Sheet:
    """One object from its table.

    Args:
        table: with the keys OBJECT_KEYS.
        views: of the scene; what is given in image points is in those of the first.
        scale: world units per pixel.
        default_name: where the table has none; None: it must have one.
        settings: of the solver.

    Raises:
        SceneError: a value is missing, wrong or out of place.
    """
    kind, view = table.text("kind", "tube", choices=KINDS), views[0]
    for key in table.data:
        if key not in (*SHARED_KEYS, *KINDS[kind]):
            owners = " or a ".join(owner for owner, keys in KINDS.items() if key in keys)
            table.fail(key, f"does not belong to a {kind}", f'it is a {owners}\'s: write kind = "...", or remove it')
    why = "several objects need a name each"
    name = table.name("name", default_name, why) if default_name else table.name("name", why=why)
    shared = {"name": name, "not_here": _marks(table, view), "springs": _springs(table, views, kind, settings)}
    if kind == "snake":
        return _snake(table, view, shared)
    return _sheet(table, view, shared) if kind == "sheet" else _tube(table, views, scale, shared)


def _marks(table: Table, view: View) -> np.ndarray:
    if not len(table.take("not_here", [])):
        return np.zeros((0, 2))
    marks = table.array("not_here", (None, 2), "a list of image points")
    return _in_image(table, "not_here", marks, view)


def _snake(table: Table, view: View, shared: dict[str, Any]) -> Snake:
    why = "give the rough curve: points = [[x, y], [x, y], ...], in pixels"
    closed = table.flag("closed", True)
    points = _curve(table, "points", view, closed, "a list of [x, y] points", why)
    nodes = table.take("nodes", Snake.nodes)
    if not isinstance(nodes, int) or isinstance(nodes, bool) or not NODES[0] <= nodes <= NODES[1]:
        table.fail("nodes", f"{shown(nodes)} is out of bounds", f"give a whole number from {NODES[0]} to {NODES[1]}")
    material = table.fields("material", SnakeMaterial(), LINE_BOUNDS)
    return Snake(points, closed=closed, nodes=nodes, material=material, **shared)


def _curve(table: Table, key: str, view: View, closed: bool, meaning: str, why: str) -> np.ndarray:
    """Image points, shape (n, 2), of a curve without knots that the view sees."""
    points = table.array(key, (None, 2), meaning, why=why)
    least = 3 if closed else 2
    if len(points) < least:
        table.fail(key, f"has {len(points)} point{'s' * (len(points) != 1)}", f"give at least {least}, in order")
    points = _in_image(table, key, points, view)
    ring = points
    if closed:  # all but shut: ends that meet are no crossing
        ring = np.concatenate([points, points[:1] + 1e-6 * (points[-1:] - points[:1])])
    _unknotted(table, key, points, ring)
    if closed and abs(shoelace(points)) < SPINE_MIN**2:
        table.fail(key, f"encloses {abs(shoelace(points)):.0f} pixels", f"it must enclose at least {SPINE_MIN**2:g}")
    return points


def _sheet(table: Table, view: View, shared: dict[str, Any]) -> Sheet:
    why = "give four points: corners = [[x, y], [x, y], [x, y], [x, y]], in order around it"
    value = table.take("corners", why=why)
    wide = 3 if isinstance(value, list | tuple | np.ndarray) and len(value) and np.size(value[0]) == 3 else 2
    corners = table.array("corners", (4, wide), "four [x, y] or [x, y, z] points", why=why)
    image = table.flag("image", True)
    if wide == 2:
        corners = _in_image(table, "corners", corners, view)
    seen = corners if wide == 2 else _seen(table, "corners", corners, view)
    if image and wide == 3:
        _inside(table, "corners", seen, view.image)
    ring = np.concatenate([seen, seen[:1] + 1e-6 * (seen[-1:] - seen[:1])])
    if image or wide == 2:
        _unknotted(table, "corners", seen, ring)
    material = table.fields("material", SheetMaterial(), LINE_BOUNDS)
    if material.w11 > (most := float(np.sqrt(material.w20 * material.w02))) * (1 + 1e-6):
        table.fail("material.w11", f"{material.w11:g} is out of bounds", f"it must be at most the root of w20 w02, {most:g}")
    x, y, z = (float(v) for v in table.array("load", (3,), "a vector", default=[0.0, 0.0, 0.0]))
    return Sheet(
        corners,
        depth=_depth(table, view, wide == 2),
        grid=_grid(table),
        material=material,
        load=(x, y, z),
        image=image,
        **shared,
    )


def _springs(table: Table, views: list[View], kind: str, settings: Settings) -> tuple[Spring, ...]:
    value = table.take("spring", [])
    if not isinstance(value, list | tuple):
        table.fail("spring", f"{shown(value)} is not a list of tables", "write [[object.spring]] below the object")
    return tuple(
        _spring(Table(v, table.source, table.path(f"spring[{i}]"), SPRING_KEYS), views, kind, settings)
        for i, v in enumerate(value)
    )


def _spring(table: Table, views: list[View], kind: str, settings: Settings) -> Spring:
    names = [view.name for view in views]
    number = names.index(table.text("view", names[0], choices=names))
    view = views[number]
    if number and kind != "tube":
        table.fail("view", f"is {view.name!r}", f"a {kind} lies in the first view, {names[0]!r}: remove it")

    def place(key: str, why: str) -> tuple[float, ...]:
        value = table.take(key, why=why)
        wide = 3 if np.size(value) == 3 and kind != "snake" else 2
        meaning = "an image point [column, row]" + ("" if kind == "snake" else " or a world point [x, y, z]")
        point = table.array(key, (wide,), meaning)
        if wide == 2:
            point = (_in_image if key == "near" else _straight)(table, key, point[None], view)[0]
        return tuple(float(v) for v in point)

    anchor = place("anchor", "give the image point it pulls to: anchor = [x, y]")
    reach = table.number("reach", above=0.0) if "reach" in table else None
    point = near = None
    if reach is not None:
        for key in ("point", "near"):
            if key in table:
                table.fail(key, "has no meaning beside reach", "a volcano pushes the whole object; remove it")
    elif ("point" in table) == ("near" in table):
        table.fail(
            "near",
            "stands beside point" if "near" in table else "is missing",
            "say where the spring is tied: near = [x, y] in the image, or point = material coordinates from 0 to 1",
        )
    elif "near" in table:
        near = place("near", "")
    else:
        count = 1 if kind == "snake" else 2
        value = np.atleast_1d(np.asarray(table.take("point"), dtype=object))
        fits = value.shape == (count,) and all(is_number(v) and 0 <= v <= 1 for v in value)
        if not fits:
            wanted = "s along it" if count == 1 else "[x, s], around and along it"
            table.fail("point", f"{shown(table.take('point'))} does not fit", f"give {wanted}, from 0 to 1")
        point = tuple(float(v) for v in value)
    frame = table.take("frame", 0)
    if not isinstance(frame, int) or isinstance(frame, bool) or frame < 0:
        table.fail("frame", f"{shown(frame)} is no frame", "give its number, a whole one; the first is 0")
    most = LATER if frame else settings.iterations
    start, stop = table.take("start", 0), table.take("stop", None)
    for key, value, least in (("start", start, 0), ("stop", stop, start + 1 if isinstance(start, int) else 1)):
        if value is None:
            continue
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
            bound = f"from {least} to " + (f"{most}" if frame else f"solver.iterations = {most}")
            table.fail(key, f"{shown(value)} is out of bounds", f"give an iteration, a whole number {bound}")
    stiffness = table.number("stiffness", 1.0, above=0.0, most=1e6)
    return Spring(anchor, point, near, stiffness, reach, start, stop, number, frame)


def _grid(table: Table) -> tuple[int, int]:
    grid = table.take("grid", [25, 25])
    whole = (
        isinstance(grid, list | tuple)
        and len(grid) == 2
        and all(isinstance(n, int) and not isinstance(n, bool) for n in grid)
    )
    if not whole or not all(least <= n <= GRID_MAX for n, least in zip(grid, GRID_MIN, strict=True)):
        table.fail(
            "grid",
            f"{shown(grid)} is out of bounds",
            f"give [around, along], at least {list(GRID_MIN)} and at most {GRID_MAX} each",
        )
    return grid[0], grid[1]


def _find_depth(table: Table, views: list[View], in_image: bool) -> bool:
    """Whether depth = "auto"."""
    if table.take("depth", 0.0) != "auto":
        return False
    if not in_image:
        table.fail("depth", 'is "auto" beside a spine in world points', "remove it: they have their depth")
    if len(views) > 1:
        table.fail("depth", 'is "auto" beside several views', "give a rough depth: they tell the true one")
    if not views[0].camera.affine:
        table.fail("depth", 'is "auto" in a perspective view', "give the object's distance along the view's axis")
    return True


def _depth(table: Table, view: View, needed: bool) -> float:
    depth = table.number("depth", 0.0)
    if not view.camera.affine and needed and depth <= 0:
        table.fail(
            "depth",
            f"{depth:g} is not in front of the perspective camera",
            "give the object's distance along the view's axis",
        )
    return depth


def _tube(table: Table, views: list[View], scale: float, shared: dict[str, Any]) -> Tube:
    radius, view = None, views[0]
    if table.take("radius", None) is not None:
        widest = 0.5 * float(np.hypot(*view.image.shape[:2])) * scale if view.camera.affine else np.inf
        radius = table.number("radius", above=0.0, most=widest)
    spine, grid = _spines(table, views) if "spines" in table else _spine(table, view), _grid(table)
    figure = table.name("figure") if "figure" in table else None
    find_depth = _find_depth(table, views, spine.shape[1] == 2)
    depth = 0.0 if find_depth else _depth(table, view, spine.shape[1] == 2)
    _all_see(table, views, spine, depth)
    return Tube(
        spine=spine, radius=radius, depth=depth, find_depth=find_depth, grid=grid,
        material=material_of(table, grid), breaks=breaks_of(table, grid[1], view), figure=figure,
        goes_on=NAMES[table.text("goes_on", "no", choices=NAMES)], **shared,
    )  # fmt: skip


def _in_image(table: Table, key: str, points: np.ndarray, view: View) -> np.ndarray:
    """Image points of a view as given, shape (n, 2), which must lie in it, as the view without its lens has them."""
    _inside(table, key, points, view.image)
    points = _straight(table, key, points, view)
    if view.lens is not None:
        _inside(table, key, points, view.image, " without distortion")
    return points


def _straight(table: Table, key: str, points: np.ndarray, view: View) -> np.ndarray:
    points = points if view.lens is None else view.lens.straight(points)
    if not np.isfinite(points).all():
        table.fail(key, "lies where the view's lens shows nothing", "check the distortion of its camera")
    return points


def _inside(table: Table, key: str, points: np.ndarray, image: np.ndarray, how: str = "") -> None:
    height, width = image.shape[:2]
    size = np.array([width, height])
    for i, point in enumerate(points):
        if not np.all((point >= -0.5) & (point <= size - 0.5)):
            at = f"[{point[0]:g}, {point[1]:g}]"
            table.fail(
                f"{key}[{i}]",
                f"{at} lies outside the image of {width} x {height} pixels{how}",
                "points are [column, row]",
            )


def _spine(table: Table, view: View) -> np.ndarray:
    """Shape (n, 2) image points, or (n, 3) world points; seen by the view and free of knots."""
    value = table.take("spine", why="give the rough axis: spine = [[x, y], [x, y], ...], in pixels")
    wide = 3 if isinstance(value, list | tuple | np.ndarray) and len(value) and np.size(value[0]) == 3 else 2
    spine = table.array("spine", (None, wide), "a list of [x, y] or [x, y, z] points")
    if len(spine) < 2:
        table.fail(
            "spine",
            f"has {len(spine)} point{'s' * (len(spine) != 1)}",
            "give at least two, from one end of the object to the other",
        )
    if wide == 2:
        spine = seen = _in_image(table, "spine", spine, view)
    else:
        seen = _seen(table, "spine", spine, view)
        _inside(table, "spine", seen, view.image)
    _unknotted(table, "spine", spine, seen, crossing=wide == 2)
    return spine


def _spines(table: Table, views: list[View]) -> np.ndarray:
    """World points, shape (n, 3), of an axis that is given in two or more views."""
    if "spine" in table:
        table.fail("spines", "stands beside spine", "give one of the two")
    given = table.table("spines", [view.name for view in views])
    seen = [view for view in views if view.name in given]
    if len(seen) < 2:
        names = " and ".join(repr(view.name) for view in views[:2]) if len(views) > 1 else "two views"
        table.fail("spines", f"holds {len(seen)} axes", f"give the rough axis in two views or more, as {names}")
    why = "give the rough axis in this view"
    return triangulated(
        [_curve(given, view.name, view, False, "a list of [x, y] points", why) for view in seen],
        [view.camera for view in seen],
    )


def _all_see(table: Table, views: list[View], spine: np.ndarray, depth: float) -> None:
    """Refuses an axis that a view does not see, and views that together do not tell its depth."""
    if len(views) == 1:
        return
    world, key = spine, "spines" if "spines" in table else "spine"
    if spine.shape[1] == 2:
        world = lift(spine, views[0].camera, depth)
    for view in views:
        points = _seen(table, key, world, view)
        height, width = view.image.shape[:2]
        within = np.all((points >= -0.5) & (points <= np.array([width, height]) - 0.5), axis=1).mean()
        if within < SEEN:
            table.fail(
                key,
                f"only {within:.0%} of it lies in the image of view {view.name!r}",
                "check that view's camera, and the axis' depth; give the axis in world points, or in two views as spines",
            )
    sights = np.array([[view.camera.sight(world.mean(axis=0)) for view in views]])
    if not spread(sights, np.ones((1, len(views))))[2][0]:
        table.fail(key, "is seen from one side only by all views", "give views that look another way, as stereo with alpha")


def _seen(table: Table, key: str, points: np.ndarray, view: View) -> np.ndarray:
    """Image points of world points, shape (n, 3), which must lie before the camera."""
    m = view.camera.matrix
    if not view.camera.affine and np.any((points @ m[2, :3] + m[2, 3]) * np.linalg.det(m[:, :3]) <= 0):
        table.fail(
            key,
            f"{shown(points)} lies behind the camera",
            "world points in front of it have a positive depth",
        )
    return view.camera.project(points)


def _unknotted(table: Table, key: str, given: np.ndarray, seen: np.ndarray, crossing: bool = True) -> None:
    """Refuses a curve, seen at image points (n, 2), that repeats a point, is too short or crosses itself."""
    gaps = np.linalg.norm(seen[: len(given), None] - seen[None, : len(given)], axis=2)
    near = np.argwhere(np.triu(gaps < STEP_MIN, 1))
    if len(near):
        i, j = near[0]
        table.fail(key, f"points {i} and {j} are both {shown(given[i])}", "remove the repeated one")
    length = float(np.trace(gaps, 1))
    if length < SPINE_MIN:
        table.fail(
            key,
            f"is {length:.1f} pixels long",
            f"it must be at least {SPINE_MIN:g}, or the image is too coarse",
        )
    found = _crossing(seen) if crossing else None
    if found:
        i, j = found
        table.fail(
            key,
            f"crosses itself: {i} to {i + 1} meets {j} to {j + 1}",
            "order the points from one end to the other",
        )


def _crossing(points: np.ndarray) -> tuple[int, int] | None:
    """The first two segments of a polyline, shape (n, 2), that cross or turn back on each other; by index."""

    def side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
        return float(np.sign((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])))

    step = np.diff(points, axis=0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    for j in range(1, len(points) - 1):
        if step[j - 1] @ step[j] < -0.996:  # within 5 degrees
            return j - 1, j
        c, d = points[j], points[j + 1]
        for i in range(j - 1):
            a, b = points[i], points[i + 1]
            if side(a, b, c) != side(a, b, d) and side(c, d, a) != side(c, d, b):
                return i, j
    return None
