"""One iteration of a model, captured as a graph."""

from __future__ import annotations

import threading

import numpy as np
import warp as wp

from ..kernels import rim, shape, switch
from .fabric import Fabric
from .force import add_forces
from .model import State
from .solvers import Solver, make_solver

HOST = threading.RLock()
"""Held by a thread for all it does with Warp but replaying graphs: a capture would record what others launch or copy."""


class Loop:
    """The iteration, captured as a graph and launched again and again; the step apart where it needs the host.

    Args:
        scene: model, state, weights and settings, their weights written.
        careful: by the plain scheme, without acceleration.
    """

    def __init__(self, scene: Fabric, careful: bool):
        s = scene.settings
        slow, momentum = (1.0, 0.0) if careful else (s.slow, s.momentum)
        self.scene, self._momentum = scene, momentum
        self.solver: Solver = make_solver(s.scheme, scene.model, s.step, slow, momentum)
        self._capture()

    def _capture(self) -> None:
        scene, s = self.scene, self.scene.settings
        self.forms = self._forms()
        m = scene.model
        rare = {rim: m.torn, shape: m.shaped or m.tense or m.twisted, switch: s.contour == "switch"}
        for module in (module for module, used in rare.items() if used):
            wp.load_module(module, device=scene.device)
        with wp.ScopedCapture(device=scene.device, force_module_load=False) as capture:
            add_forces(scene.model, scene.state, s.contour, s.force == "paper", s.tau)
            scene.springs.add_forces(scene.model.eyes, scene.state.tube, scene.state.force)
            if self.solver.captured:
                self._step()
        assert capture.graph is not None
        self.graph = capture.graph

    def set_material(self) -> None:
        """Writes the weights anew and makes the factors again that depend on what changed; see `Assembly.set_material`."""
        changed, mass = self.scene.set_material(), self.solver.mass
        if changed:
            self.solver.material_changed(changed)
            self.scene.springs.take_implicitly(self._step_under)
        if self.solver.mass != mass:  # what was repeated of the last step is no velocity
            self.scene.stand_still()
        if self._forms() != self.forms:
            self._capture()

    def calm(self) -> None:
        """Lets a step repeat less of the one before: the share that it does not repeat is doubled."""
        self._repeat(max(2 * self.solver.momentum - 1, 0.0))

    def rouse(self) -> None:
        """Lets a step repeat as much of the one before as at first."""
        self._repeat(self._momentum)

    def _repeat(self, momentum: float) -> None:
        if momentum != self.solver.momentum:
            self.solver.momentum = momentum
            with HOST:
                self._capture()

    def _forms(self) -> tuple:
        """What a graph has frozen of model and solver."""
        m = self.scene.model
        return m.shaped, m.torn, m.tense, m.twisted, len(m.samples), self.scene.springs.form, *self.solver.form

    def hold_springs(self, iteration: int) -> None:
        """Lets springs take hold and let go, and the scheme take them implicitly."""
        self.scene.springs.set(iteration, self.scene.state.tube.numpy())
        self.scene.springs.take_implicitly(self._step_under)
        if self._forms() != self.forms:
            self._capture()

    def _step_under(self, load: np.ndarray) -> np.ndarray:
        """Step of nodes at rest under a load, both (N,) and in one direction; none with mass, where springs are explicit."""
        if self.solver.mass:
            return np.zeros(len(load))
        trial = State(self.scene.model)
        trial.force.assign((load[:, None] * [1.0, 0.0, 0.0]).astype(np.float32))
        self.solver.step(trial)
        return trial.tube.numpy()[:, 0].astype(float)

    def _step(self) -> None:
        """The scheme's step, with the springs in it."""
        self.solver.step(self.scene.state)
        self.scene.springs.give_back(self.scene.state.tube, self.scene.state.velocity)

    def run(self, count: int = 1) -> None:
        """Iterations; one thread's beside another's, as long as their scenes are not the same."""
        for _ in range(count):
            wp.capture_launch(self.graph)
            if not self.solver.captured:
                with HOST:
                    self._step()
            if self.scene.resting:
                with HOST:
                    self._start()
            self.scene.time += self.solver.dt

    def _start(self) -> None:
        self.scene.resting = False
        if self.solver.mass:
            self.scene.halve_first_step(self.solver.dt)

    def residual(self) -> float:
        """Residual force of place and radius, root mean square over all rings [initial spine lengths]."""
        return float(np.sqrt(self.scene.state.residual.numpy().mean()))
