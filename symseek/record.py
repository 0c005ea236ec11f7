"""result.json: what a run found, with what settings and units."""

from __future__ import annotations

import dataclasses
import math
import os
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from . import __version__
from .doctor import versions
from .sim.figure import Figure

if TYPE_CHECKING:
    from .pipeline import Result

FORMS = {
    "adi": "alternating directions, section 5",
    "jacobi": "implicit Jacobi, section 5",
    "euler": "explicit Euler, section 5",
    "map": "foreground map (ours)",
    "brightness": "brightness of the image, the paper's (11)",
    "subnode": "contour between nodes (ours)",
    "switch": "hard switch on nodes, the paper's (12)",
    "normalised": "pull normalised by scale and contrast (ours)",
    "depth": "hidden parts by a depth pass",
    "rays": "hidden parts by rays",
    "off": "hidden parts count as seen",
    "paper": "plain gradient of the potential, the paper's (11)",
}
"""What the words of the solver's settings stand for."""


def record_of(result: Result, names: list[str]) -> dict[str, Any]:
    scene, settings = result.scene, dataclasses.asdict(result.settings)
    unit = scene.units
    objects = {}
    for tube, o in zip(scene.tubes, result.objects, strict=True):
        objects[o.name] = {
            "kind": "tube",
            "converged": o.converged,
            "trusted": o.trusted,
            "warnings": o.warnings,
            "iterations": o.iterations,
            **o.measures,
            "grid": tube.grid,
            "material": {f.name: getattr(tube.material, f.name) for f in dataclasses.fields(tube.material)},
            "break": [dataclasses.asdict(b) for b in tube.breaks],
        }
    for given, o in zip(scene.lines, result.lines, strict=True):
        objects[o.name] = {
            "kind": o.kind,
            "converged": o.converged,
            "trusted": o.trusted,
            "warnings": o.warnings,
            "iterations": o.iterations,
            **o.measures,
            "grid": o.nodes.shape[1:-1],
            "material": dataclasses.asdict(given.material),
        }
    return plain(
        {
            "run": {
                "scene": scene.name,
                "source": scene.source,
                "written": datetime.now(UTC).isoformat(timespec="seconds"),
                "device": result.device,
                "image": {"width": scene.views[0].image.shape[1], "height": scene.views[0].image.shape[0]},
                "camera": scene.views[0].camera.matrix,
                "views": [
                    {
                        "name": view.name,
                        "image": {"width": view.image.shape[1], "height": view.image.shape[0]},
                        "camera": view.camera.matrix,
                    }
                    for view in scene.views
                ],
            },
            "versions": {
                "symseek": __version__,
                "python": platform.python_version(),
                **versions(),
                "opengl": os.environ.get("PYOPENGL_PLATFORM", ""),
            },
            "settings": settings,
            "forms": {key: FORMS[value] for key, value in settings.items() if isinstance(value, str) and value in FORMS},
            "units": {
                "world": unit,
                "scale": f"{scene.scale:g} {unit} per pixel" if scene.views[0].camera.affine else "by the camera",
                "length": unit,
                "station": unit,
                "radius": unit,
                "area": f"{unit}^2",
                "volume": f"{unit}^3",
                "contour_residual_px": "pixels of the image",
                "asymmetry": "share of the radius",
                "supported_share": "share of the contour's length that is not hidden, in all views",
                "hidden_share": "share of the contour's length",
                "map_agreement": "share of silhouette or map",
                "map_certainty": "share of the map",
                "partial": "whether an end lies beyond the image",
                "depth": unit,
                "depth_certainty": "0 to 1",
            },
            "seconds": {name: round(s, 4) for name, s in result.seconds.items()},
            "objects": objects,
            **({"figures": {f.name: _figure(f) for f in result.figures}} if result.figures else {}),
            "skipped": result.skipped,
            "files": names,
        }
    )


def _figure(figure: Figure) -> dict[str, Any]:
    return {
        "tubes": figure.tubes,
        "volume": figure.volume,
        "area": figure.area,
        "pieces": [[figure.tubes[k] for k in piece] for piece in figure.pieces],
        "warnings": figure.warnings,
    }


def plain(value: Any) -> Any:
    """A value as JSON knows it: arrays as lists, what is not finite as null, a function as that word."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if callable(value):
        return "function"
    return value
