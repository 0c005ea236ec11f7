"""symseek: 3D shape of roundish, elongated things from photographs by symmetry-seeking deformable models.

>>> result = symseek.reconstruct("photo.jpg", spine=[[x, y], ...])
>>> result.save("out")
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .checks import SceneError
    from .many import batch
    from .pipeline import Result, reconstruct, run
    from .scene import Scene, load
    from .sim.body import Body
    from .sim.camera import Camera
    from .sim.material import Break, Material
    from .sim.problem import Settings, Sheet, SheetMaterial, Snake, SnakeMaterial, Tube, View
    from .sim.spring import Spring

__version__ = "0.1.0"

__all__ = [
    "Body",
    "Break",
    "Camera",
    "Material",
    "Result",
    "Scene",
    "SceneError",
    "Settings",
    "Sheet",
    "SheetMaterial",
    "Snake",
    "SnakeMaterial",
    "Spring",
    "Tube",
    "View",
    "__version__",
    "batch",
    "load",
    "reconstruct",
    "run",
]

_HOMES = {
    "batch": "many",
    "SceneError": "checks",
    "Result": "pipeline",
    "reconstruct": "pipeline",
    "run": "pipeline",
    "Scene": "scene",
    "load": "scene",
    "Camera": "sim.camera",
    "Body": "sim.body",
    "Break": "sim.material",
    "Material": "sim.material",
    "Settings": "sim.problem",
    "Sheet": "sim.problem",
    "SheetMaterial": "sim.problem",
    "Snake": "sim.problem",
    "SnakeMaterial": "sim.problem",
    "Spring": "sim.spring",
    "Tube": "sim.problem",
    "View": "sim.problem",
}


def __getattr__(name: str) -> Any:
    # numpy, Warp and OpenGL take a second to import: only when a name is used
    if name not in _HOMES:
        raise AttributeError(f"module 'symseek' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    return value


def __dir__() -> list[str]:
    return __all__
