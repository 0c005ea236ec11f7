"""The elastic model alone, without an image: for scripts that want its physics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .fabric import Fabric
from .fields import marks
from .foreground import axis_curve, length_of
from .initial import initial_tube
from .loop import Loop
from .material import Weight
from .model import Model
from .problem import Settings, Tube
from .relax import CHECK


class Body:
    """Tubes under their own forces: (10) without potentials.

        body = Body([Tube(spine=[[0, 0, 0], [0, 1, 0]], radius=0.1, material=Material(closed=False))])
        body.material(w2=1e-3, C2=1.2)
        body.rest()

    With nothing to hold it, a body keeps its place only at `reaction` = 1: with less, spine and tube do not pull alike.

    Args:
        tubes: axes in world points, shape (n, 3), with radius, grid, material and breaks; circles at first.
        settings: scheme, step, slow and momentum; the rest is of images.
        device: Warp device.

    Raises:
        ValueError: an axis that is no list of world points, no radius, springs, a weight that does not fit, too long a step,
            or mass that the scheme does not integrate.
    """

    def __init__(self, tubes: Sequence[Tube], settings: Settings | None = None, device: str = "cpu"):
        axes = [np.asarray(t.spine, float) for t in tubes]
        for tube, axis in zip(tubes, axes, strict=True):
            if axis.ndim != 2 or axis.shape[1] != 3 or tube.radius is None:
                raise ValueError(f"{tube.name}: without an image a tube needs a spine of points [x, y, z] and a radius")
            if tube.springs:
                raise ValueError(f"{tube.name}: springs belong to a scene with an image")
        model = Model([t.grid for t in tubes], [t.material.closed for t in tubes], 0, 1, device)
        unit = length_of(axis_curve(axes[0]))
        self._fabric = Fabric(model, list(tubes), settings or Settings(), device, unit)
        for k, (tube, axis) in enumerate(zip(tubes, axes, strict=True)):
            where = marks(tube.breaks, tube.grid[1])
            self.place(*initial_tube(axis, float(tube.radius or 0), tube.grid, tube.material.closed, where), k)
        self._fabric.set_material()
        self._loop = Loop(self._fabric, careful=False)
        self.iteration = 0

    @property
    def time(self) -> float:
        """Solver time t: the sum of the time steps dt so far."""
        return self._fabric.time

    def material(self, k: int = 0, **weights: Weight | None) -> None:
        """Changes weights of tube k from the next step on.

        Raises:
            ValueError: no such weight, or a value that does not fit.
        """
        self._fabric.weights.change(k, weights)

    def shape(self, k: int = 0) -> dict[str, np.ndarray]:
        """Natural lengths and curvatures that tube k has now: `material(k01=0.1, **shape())` makes it stay as it is.

        Returns:
            L1 (N_s - 1,), C2 (N_s,), L10, C20, C02 (N_x, N_s), L01, C11 (N_x, N_s - 1), in initial spine lengths.
        """
        return self._fabric.shape(k)

    def place(self, tube: np.ndarray, spine: np.ndarray, k: int = 0) -> None:
        """Puts tube k, shape (N_x, N_s, 3), and its spine (N_s, 3), somewhere else, at rest."""
        self._fabric.place(k, tube, spine)
        self._fabric.stand_still()
        self._fabric.weights.stale = True  # how far edges are stretched now bounds their tension

    def step(self, count: int = 1) -> None:
        """Takes time steps; weights that are functions of time are looked at again every `CHECK` of them."""
        for _ in range(count):
            weights = self._fabric.weights
            if weights.stale or (weights.timed and self.iteration % CHECK == 0):
                self._loop.set_material()
            self._loop.run()
            self.iteration += 1

    def rest(self, tolerance: float = 3e-6, most: int = 20000) -> bool:
        """Steps until the residual force is below `tolerance` [initial spine lengths] and no weight is to change any more.

        Returns:
            Whether that was reached within `most` steps.
        """
        for _ in range(-(-most // CHECK)):
            self.step(CHECK)
            if self._loop.residual() < tolerance and self._fabric.weights.settled(self.time):
                return True
        return False

    def tube(self, k: int = 0) -> np.ndarray:
        """Nodes of tube k now, shape (N_x, N_s, 3), world units."""
        return self._fabric.world(k)[0]

    def spine(self, k: int = 0) -> np.ndarray:
        """Spine of tube k now, shape (N_s, 3), world units."""
        return self._fabric.world(k)[1]

    def velocity(self, k: int = 0) -> np.ndarray:
        """Velocity of tube k over the last step with mass, shape (N_x, N_s, 3), world units per unit of time; 0 without."""
        return self._fabric.velocity(k)
