"""Weights and discontinuities of an object in a scene file, checked against its grid."""

from __future__ import annotations

from dataclasses import asdict, fields

import numpy as np

from .checks import Table, shown
from .sim.fields import as_field, break_ring, pieces
from .sim.material import Break, Material
from .sim.problem import View


def material_of(table: Table, grid: tuple[int, int]) -> Material:
    """The table's `material`, each weight fit for the grid; a Material as it is, once it is checked.

    Raises:
        SceneError: an unknown weight, a value that does not fit, or a natural length without its tension factor.
    """
    given = table.take("material", {})
    values = {f.name: getattr(given, f.name) for f in fields(Material)} if isinstance(given, Material) else given
    inner = Table(values, table.source, table.path("material"), [f.name for f in fields(Material)])
    for name, value in inner.data.items():
        if name == "closed":
            inner.flag(name, True)
        elif value is not None or not isinstance(given, Material):
            try:
                as_field(name, value, grid)
            except ValueError as wanted:
                inner.fail(name, f"{shown(value)} does not fit", f"it must be {wanted}")
    material = given if isinstance(given, Material) else Material(**inner.data)
    for factor, length in (("k10", "L10"), ("k01", "L01")):
        none = isinstance(getattr(material, factor), int | float) and getattr(material, factor) == 0
        if none and getattr(material, length) is not None:
            inner.fail(length, "has no effect while the tension factor is 0", f"give {factor} too")
    return material


def breaks_of(table: Table, ns: int, view: View) -> tuple[Break, ...]:
    """The table's list `break`, for a grid of `ns` rings; image points are in that view.

    Raises:
        SceneError: an unknown key, a value out of bounds, or breaks too close for the grid.
    """
    value, size = table.take("break", []), view.image.shape[:2]
    if isinstance(value, list | tuple) and all(isinstance(b, Break) for b in value):
        value = [asdict(b) for b in value]
    found: list[Break] = []
    for i, each in enumerate(value if isinstance(value, list) else [value]):
        inner = Table(each, table.source, f"{table.path('break')}[{i}]", [f.name for f in fields(Break)])
        why = "give the share of the object's length, between 0 and 1, or an image point [column, row]"
        if isinstance(inner.take("at", why=why), list | tuple | np.ndarray):
            point = inner.array("at", (2,), "an image point [column, row]")
            if not np.all((point >= -0.5) & (point <= np.array(size[::-1]) - 0.5)):
                inner.fail("at", f"{shown(point)} lies outside the image", f"it has {size[1]} x {size[0]} pixels")
            point = point if view.lens is None else view.lens.straight(point[None])[0]
            at = (float(point[0]), float(point[1]))
        else:
            at = inner.number("at", above=0.0, most=1.0)
        order = inner.text("order", "position", choices=("position", "tangent"))
        of = inner.text("of", "both", choices=("both", "tube", "spine"))
        found.append(Break(at, order, of, inner.number("time", 0.0)))  # pyright: ignore
    sure = [b for b in found if isinstance(b.at, float)]
    places = sorted((break_ring(b, ns), b.order == "position") for b in sure)
    if any(last - first < 2 for first, last in pieces(ns, places)):
        table.fail("break", "the object breaks too often", f"leave three rings of the grid's {ns} between two breaks")
    return tuple(found)
