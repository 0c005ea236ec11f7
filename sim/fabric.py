"""Tubes that can be stepped: model, state, weights and time, with or without images."""

from __future__ import annotations

import numpy as np

from .model import Model, State
from .natural import shape_now
from .problem import Settings, Tube
from .spring import Springs
from .weights import Weights


class Fabric:
    """What a `Loop` steps: tubes in flat arrays, in units of the first one's initial length, and the weights of each.

    Attributes:
        time: of the solver, the sum of the time steps of its nodes.
        springs: none, but where a scene has them.
        resting: it stands still, and the next step with mass is its first.
        unit, origin: of the model's lengths and coordinates, in the world's.
    """

    def __init__(
        self, model: Model, tubes: list[Tube], settings: Settings, device: str, unit: float, origin: np.ndarray | float = 0.0
    ):
        self.model, self.tubes, self.settings, self.device = model, tubes, settings, device
        self.state = State(model)
        self.weights = Weights(model, [t.material for t in tubes], [t.breaks for t in tubes])
        self.springs = Springs([], np.zeros(0), device)
        self.resting = True
        self.unit, self.origin, self.time = unit, np.zeros(3) + origin, 0.0

    def world(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Tube (N_x, N_s, 3) and spine (N_s, 3) of object k in world units."""
        nx, ns = self.tubes[k].grid
        tube = self.state.tube.numpy()[self.model.nodes_of(k)].reshape(ns, nx, 3).transpose(1, 0, 2)
        spine = self.state.spine.numpy()[self.model.rings_of(k)]
        return tube * float(self.unit) + self.origin, spine * float(self.unit) + self.origin

    def velocity(self, k: int) -> np.ndarray:
        """Velocity of tube k with mass, shape (N_x, N_s, 3), world units per unit of time; 0 without mass."""
        (nx, ns), nodes = self.tubes[k].grid, self.model.nodes_of(k)
        if not self.model.mu.numpy().any():
            return np.zeros((nx, ns, 3))
        return self.state.velocity.numpy()[nodes].reshape(ns, nx, 3).transpose(1, 0, 2) * float(self.unit)

    def place(self, k: int, tube: np.ndarray, spine: np.ndarray) -> None:
        """Sets nodes of object k, shape (N_x, N_s, 3), and its spine (N_s, 3), in world units."""
        tubes, spines = self.positions()
        tubes[self.model.nodes_of(k)] = ((tube - self.origin) / self.unit).transpose(1, 0, 2).reshape(-1, 3)
        spines[self.model.rings_of(k)] = (spine - self.origin) / self.unit
        self.state.tube.assign(tubes)
        self.state.spine.assign(spines)

    def shape(self, k: int) -> dict[str, np.ndarray]:
        """Natural lengths and curvatures that object k has now, see `natural.shape_now`."""
        tube, spine = ((v - self.origin) / self.unit for v in self.world(k))
        return shape_now(tube, spine, self.weights.cuts[k], self.weights.spine_cuts[k])

    def set_material(self, share: float | None = None) -> set[str]:
        """Writes the weights as they are at `time`; `share` of the rigidities that falls with sigma (continuation).

        Returns:
            what changed, as `Solver.material_changed` takes it.
        """
        self.weights.share = self.weights.share if share is None else share
        return self.weights.write(self.time, *self.positions())

    def positions(self) -> tuple[np.ndarray, np.ndarray]:
        """Tube and spine nodes as they are now, to go back to with `rewind`."""
        return self.state.tube.numpy().copy(), self.state.spine.numpy().copy()

    def rewind(self, positions: tuple[np.ndarray, np.ndarray]) -> None:
        """Goes back to `positions`, at rest."""
        self.state.tube.assign(positions[0])
        self.state.spine.assign(positions[1])
        self.stand_still()

    def stand_still(self) -> None:
        """Forgets the steps before, so that momentum does not carry over to another potential."""
        self.state.age.zero_()
        self.state.velocity.zero_()
        self.state.spine_velocity.zero_()
        self.resting = True

    def halve_first_step(self, h: float) -> None:
        """Takes half of a step h with mass back: it began at rest, not from half a step ago.

        Whole, it would leave a stiff part of the shape three times as far on the other side.
        """
        s = self.state
        for place, velocity in ((s.tube, s.velocity), (s.spine, s.spine_velocity)):
            half = 0.5 * velocity.numpy()
            velocity.assign(half)
            place.assign(place.numpy() - np.float32(h) * half)
