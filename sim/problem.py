"""What is to be solved: views, tubes and the solver's settings; plain data that `reconstruct` takes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .camera import Camera
from .lens import Lens
from .material import Break, Material
from .spring import Spring


@dataclass(frozen=True)
class View:
    """One image and its camera."""

    image: np.ndarray
    """shape (H, W) or (H, W, 3), float32 in [0, 1]."""
    camera: Camera = field(default_factory=Camera.orthographic)
    name: str = "front"
    ignore: np.ndarray | None = None
    """shape (H, W), bool: True where the image must not be looked at (`view.ignore`)."""
    lens: Lens | None = None
    """what bent the image that `image` was made straight from."""


@dataclass(frozen=True)
class Tube:
    """One object: a rough axis and what its tube is made of."""

    spine: np.ndarray
    """rough axis, shape (n, 2) image points (column, row) of the first view, or (n, 3) world points."""
    name: str = "object"
    radius: float | None = None
    """of the initial tube [world units]; None: from the image."""
    depth: float = 0.0
    """of a spine given in the image, along the first view's axis [world units]; larger is further away."""
    find_depth: bool = False
    """find the depth order from the image instead (`sim.order`); only where the first view is affine."""
    grid: tuple[int, int] = (25, 25)
    """nodes around, nodes along."""
    material: Material = field(default_factory=Material)
    breaks: tuple[Break, ...] = ()
    """discontinuities across the object."""
    not_here: np.ndarray | None = None
    """marks by the user that the object is not here, shape (k, 2), image points (column, row)."""
    goes_on: tuple[bool, bool] = (False, False)
    """whether the object goes on beyond the first and the last end of the axis: what lies past it is not looked at."""
    springs: tuple[Spring, ...] = ()
    figure: str | None = None
    """what it is a part of: tubes of one figure are united into one solid."""


@dataclass(frozen=True)
class SnakeMaterial:
    """Weights of a snake, an image curve with the energy (2): per unit of s, lengths in its own first length."""

    w1: float = 0.0
    """tension (2): draws the curve together."""
    w2: float | None = None
    """rigidity (2); None: at each scale it bends over about as far as the image is smoothed (`sim.sheet.BEND`)."""
    k1: float = 1e-2
    """K1 of its natural lengths L1, the mean of its edges, if open the first ones: no part of it is drawn out."""


@dataclass(frozen=True)
class Snake:
    """An open or closed curve in the image plane (figure 6)."""

    points: np.ndarray
    """rough curve, shape (n, 2), image points (column, row) of the first view, in order."""
    name: str = "snake"
    closed: bool = True
    nodes: int = 200
    """along it; the result does not depend on how many."""
    material: SnakeMaterial = field(default_factory=SnakeMaterial)
    not_here: np.ndarray | None = None
    """marks by the user that what it encloses is not here, shape (k, 2), image points."""
    springs: tuple[Spring, ...] = ()


@dataclass(frozen=True)
class SheetMaterial:
    """Weights of an open sheet with the energy (3): per unit of (x, s), lengths in its own first size."""

    w10: float = 0.0
    """tension across, along x."""
    w01: float = 0.0
    """tension along s."""
    w20: float = 1e-4
    """rigidity along x."""
    w11: float = 1e-4
    """twist rigidity, at most the root of w20 w02; all three the same: an isotropic plate."""
    w02: float = 1e-4
    """rigidity along s."""


@dataclass(frozen=True)
class Sheet:
    """An open sheet in space, with natural conditions on all four sides."""

    corners: np.ndarray
    """of the first, flat one, in order around it, shape (4, 2) image points of the first view, or (4, 3) world points."""
    name: str = "sheet"
    depth: float = 0.0
    """of corners given in the image, along the first view's axis [world units]."""
    grid: tuple[int, int] = (25, 25)
    """nodes from the first corner to the second, and from there to the third."""
    material: SheetMaterial = field(default_factory=SheetMaterial)
    load: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """even force, world directions, per unit of (x, s)."""
    image: bool = True
    """the image draws its border to the outline of what it covers."""
    not_here: np.ndarray | None = None
    """marks by the user that what it covers is not here, shape (k, 2), image points."""
    springs: tuple[Spring, ...] = ()


@dataclass(frozen=True)
class Settings:
    """How to solve; defaults serve every scene."""

    scheme: str = "auto"
    """"auto", or one of "adi", "jacobi", "euler", "sor", "direct" (section 5)."""
    potential: str = "map"
    """"map": foreground map and the image's own edges; "brightness": the paper's (11)."""
    contour: str = "subnode"
    """"subnode" or the paper's "switch" (12)."""
    visibility: str = "depth"
    """how to find what hides an object in the image: "depth" pass, "rays", or "off": everything counts as seen."""
    force: str = "normalised"
    """"normalised" or "paper": the plain gradient of (11) times `gain`."""
    sigmas: tuple[float, ...] | None = None
    """falling smoothing scales [px of the first view]; None: from the object's half width."""
    iterations: int = 6000
    """most iterations in all."""
    tolerance: float = 3e-6
    """residual force at which a stage is at rest [initial spine lengths]."""
    tau: float = 0.05
    """threshold of (12), used by "switch"."""
    gain: float = 1.0
    """of the image force."""
    step: float | None = None
    """time step dt; None: the scheme's own."""
    slow: float | None = None
    """factor of the step for a ring's slow modes (acceleration); 1 is the plain scheme, None the scheme's own."""
    momentum: float = 0.9
    """most share of a step that the next one repeats (acceleration of soft modes); 0 is the plain scheme.

    Like `slow`, it has no part in motion with mass."""
