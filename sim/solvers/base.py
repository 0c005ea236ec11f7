"""What every scheme shares: steps of each tube, slow modes apart, motion with mass, the step that it can bear."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels import integrate
from ..model import DEPTH, REACTION, SPINE_TO_RING, SYMMETRY, UPRIGHT, Model, State
from .bounds import STRETCH, around, compliance, longest, place

COUPLINGS = {"reaction": REACTION, "a": SPINE_TO_RING, "b": SYMMETRY, "depth": DEPTH}
SAFE = 0.9
"""Share of the longest step that is taken where the scheme's own is longer."""

AROUND = frozenset({"w10", "w20", "bound10"})
ALONG = frozenset({"w01", "w02", "bound01"})
SPINE = frozenset({"w1", "w2", "k1", "bound1"})
"""Arrays of the model that make the stiffness of rings, of meridians and of the spine."""
INERTIA = frozenset({"mu", "gamma", "spine_mu", "spine_gamma"})
"""Those that make P's inertia."""
MATRIX = AROUND | ALONG | SPINE | INERTIA | {"w11", "a", "reaction", "b", "d", "depth", "guide"}
"""All that P and the longest step depend on."""


@dataclass(frozen=True)
class Facts:
    """What a tube's longest step depends on: least stiffness of what is in P, most of what is not."""

    inertia: float
    """mu, or without mass gamma, at least."""
    ring: np.ndarray
    """elastic stiffness of modes around, shape (nx // 2 + 1,)."""
    lap: np.ndarray
    """eigenvalues of their Laplacian."""
    a: float
    b: float
    reaction: float
    depth: float
    upright: float
    tie: tuple[float, float]
    """of a ring's mean, least and most."""
    first_mode: float
    closed: bool
    place: np.ndarray
    """see `bounds.place`."""


def touches(changed: Collection[str] | None, names: frozenset[str]) -> bool:
    """Whether any of `names` is among what changed; None: everything did."""
    return changed is None or not names.isdisjoint(changed)


class Solver:
    """Integration of (10), in which elastic forces K are implicit as far as the scheme's P goes, and all others explicit.

    Without mass (mu = 0): P D = dt R with P near gamma M + dt K, and v += D. Equilibrium is R = 0 whatever P. The modes
    k = 0, +-1 of each ring (place, radius, tilt), which the image reaches through two nodes only, take a step `slow`
    times as long, and each step repeats a share of the one before: both change how soon a tube rests, and not where.

    With mass (mu > 0): Newmark's rule with beta = 1/4, gamma = 1/2 for the forces in P, leapfrog for the others. With
    D = h u the way since the step before, R the force where the tube is now and A = mu M / h^2 + gamma M / (2 h) + K / 4,

        A (D' - D) = R - gamma M u,    v += D',

    so that a step without damping keeps H = 1/2 mu u'M u + 1/2 w'K w, w the middle of the step, to rounding where P is
    the whole of 4 h^2 A / (4 mu + 2 gamma h) and the forces are linear; damping takes h gamma w'M w from it. Neither
    `slow` nor momentum apply: mass is the momentum.
    """

    default_dt = 0.4
    default_slow = 12.0
    spine = 5.0
    """Step of the spine over that of the slow modes."""
    name = title = ""
    """What the scene file, and what a message calls the scheme."""
    remedy = ""
    """What else a message about too long a step advises."""
    bears_mass = False
    """Whether it integrates mu > 0."""
    captured = True
    """Whether a step is launches only, so that a graph can hold it."""

    def __init__(self, model: Model, dt: float | None, slow: float | None, momentum: float):
        self.model, self.momentum, self.asked = model, momentum, dt
        self.step_size = wp.zeros((model.tubes, 3), dtype=float, device=model.device)
        self.first_mode = wp.zeros(model.rings, dtype=float, device=model.device)
        self.slow = slow or self.default_slow
        self.dt = dt or self.default_dt
        self.material_changed()

    share = 1.0
    """Of the tension that natural shapes can come to, how much P holds (`Model.stiffness`)."""

    @property
    def form(self) -> tuple:
        """What a graph of `step` has frozen: where it changes with the material, one is to be captured anew."""
        return self.mass, self.dt if self.mass else 0.0

    def material_changed(self, changed: Collection[str] | None = None) -> None:
        """Makes the factors again; to be called after weights of the model changed.

        Args:
            changed: names as `Weights.write` returns them; None: all. What does not depend on them is kept.

        Raises:
            ValueError: the scheme cannot bear the step that was asked for, mass, or the material.
        """
        raise NotImplementedError

    def _prepare(self, changed: Collection[str] | None) -> Collection[str] | None:
        """Finds the step and whatever it depends on; returns `changed`, or None if all factors depend on what did.

        Raises as `material_changed`.
        """
        m = self.model
        if not touches(changed, MATRIX):
            return changed
        least = {name: float(getattr(m, name).numpy().min()) for name in ("mu", "spine_mu", "gamma", "spine_gamma")}
        self.mass = bool(m.mu.numpy().max() > 0)
        if self.mass and not self.bears_mass:
            raise ValueError(
                f'solver.scheme = "{self.name}" does not integrate material.mu > 0: use "adi", "direct" or "euler"'
            )
        if min(least["mu"], least["spine_mu"]) <= 0 and (self.mass or min(least["gamma"], least["spine_gamma"]) <= 0):
            raise ValueError("material.mu must be above 0 everywhere or nowhere, and material.gamma above 0 where mu is not")
        self.coupling = m.coupling.numpy().astype(float)
        self.first_mode.assign(self._first_mode(m.stiffness(self.share)).astype(np.float32))
        # 2 P / dt, or with mass 4 A, has twice or once the share; the forces meet at most the whole
        self.spare = m.stiffness(0.0 if self.mass else 2 * self.share - 1)
        first_mode = self._first_mode(self.spare)
        self.facts = [self._facts(k, first_mode) for k in range(m.tubes)]
        step, self.dt = self.dt, self.asked or self.default_dt
        if not self.bears(self.dt):
            longest = self.longest_step()
            if self.asked is not None:
                raise ValueError(
                    f"solver.step = {self.asked:g} is too long for {self.title} with this material and grid: at most"
                    f" {longest:.3g}; lower it, leave it out{self.remedy}"
                )
            self.dt = SAFE * longest
        if self.dt == step and not touches(changed, INERTIA):
            return changed
        self.set_step()
        return None

    def longest_step(self) -> float:
        """The longest dt up to which the scheme bears all, with the model's material as it is; inf where there is none."""
        return longest(self.bears)

    def bears(self, dt: float) -> bool:
        """Whether the scheme bears a step with the model's material as it is (`bounds`)."""
        for k, (nx, _) in enumerate(self.model.grids):
            margin = self.margins(k, dt)
            if margin.min() <= 0 or STRETCH * self.model.image_load[k] * compliance(margin, nx) >= 1:
                return False
            if not self.bears_coupling(k, dt):
                return False
        return True

    def _facts(self, k: int, first_mode: np.ndarray) -> Facts:
        m, (nodes, rings) = self.model, (self.model.nodes_of(k), self.model.rings_of(k))
        nx, columns = m.grids[k][0], self.coupling[rings]
        w10, w20 = (float(self.spare[name][nodes].min()) for name in ("w10", "w20"))
        ring, lap = around(w10, w20, nx)
        couplings = {name: float(columns[:, c].max()) for name, c in COUPLINGS.items()}
        tie = self.tie()[rings]
        return Facts(
            inertia=float((m.mu if self.mass else m.gamma).numpy()[nodes].min()),
            ring=ring,
            lap=lap,
            upright=float(columns[:, UPRIGHT].max()),
            tie=(float(tie.min()), float(tie.max())),
            first_mode=float(first_mode[rings].min()),
            closed=bool(m.host_ring_closed[rings].any()),
            place=place(**couplings, ring=float(ring[2]), image=STRETCH * float(m.image_load[k])),
            **couplings,
        )

    def set_step(self) -> None:
        """Steps of nodes, of slow modes and of the spine (which has next to no inertia: it follows its rings), for P.

        Sets `steps` (K, 3): dt / gamma, or h^2 / (4 mu + 2 gamma h) with mass, of the tube's mean; and how far the
        inertia of each node and of each entry of the four slow lines is from that, `weight` (N,), `low_weight` (4, R).
        """
        m = self.model
        slow, spine = (1.0, 1.0) if self.mass else (self.slow, self.spine)
        self.slow_dt, self.spine_dt = self.dt * slow, spine * self.dt * slow
        self.steps = np.tile(np.array([self.dt, self.slow_dt, self.spine_dt]), (m.tubes, 1))
        inertia, spine_inertia = (gamma.numpy().astype(float) for gamma in (m.gamma, m.spine_gamma))
        if self.mass:
            inertia = m.mu.numpy() + 0.5 * self.dt * inertia
            spine_inertia = m.spine_mu.numpy() + 0.5 * self.dt * spine_inertia
        self.weight, self.low_weight = np.ones(m.nodes), np.ones((4, m.rings))
        for k, (nx, ns) in enumerate(m.grids):
            nodes, rings = m.nodes_of(k), m.rings_of(k)
            # the mean of equal numbers need not be that number
            means = [x.min() if np.ptp(x) == 0 else x.mean() for x in (inertia[nodes], spine_inertia[rings])]
            for column, mean in ((slice(0, 2), means[0]), (2, means[1])):
                self.steps[k, column] *= self.dt / (4 * mean) if self.mass else 1 / mean
            self.weight[nodes] = inertia[nodes] / means[0]
            self.low_weight[:3, rings] = self.weight[nodes].reshape(ns, nx).mean(axis=1)
            self.low_weight[3, rings] = spine_inertia[rings] / means[1]
        self.step_size.assign(self.steps.astype(np.float32))

    def _first_mode(self, host: dict[str, np.ndarray]) -> np.ndarray:
        """Stiffness of a ring's modes +-1 of weights as `Model.stiffness` gives them, shape (R,)."""
        stiffness = np.zeros(self.model.rings)
        for k, (nx, ns) in enumerate(self.model.grids):
            lap = (2 * np.sin(np.pi / nx) * nx) ** 2
            for w, factor in ((host["w10"], lap), (host["w20"], lap**2)):
                stiffness[self.model.rings_of(k)] += factor * slow_mean(w[self.model.nodes_of(k)].reshape(ns, nx))
        coupling = self.model.coupling.numpy()
        return stiffness + (0.5 * coupling[:, SYMMETRY] + coupling[:, UPRIGHT])

    def tie(self) -> np.ndarray:
        """Stiffness of the ties of a ring's mean to the spine and to its depth, (7) and (8), shape (R,)."""
        coupling = self.model.coupling.numpy().astype(float)
        return coupling[:, REACTION] + 0.5 * coupling[:, SYMMETRY] + coupling[:, DEPTH] + self.model.guide.numpy()

    def margins(self, k: int, dt: float) -> np.ndarray:
        """Stiffness of the image's force that a step leaves room for in tube k's modes around, 0 to N_x // 2 (`bounds`).

        Here for a P of which only inertia is known, and the ties of slow modes.
        """
        facts = self.facts[k]
        q = np.full(len(facts.lap), self.inert(k, dt) - facts.upright)
        if self.whole:
            q[0] -= facts.tie[1]
        else:
            q[0] = self.inert(k, dt * self.slow) + facts.tie[0]
            q[1] = self.inert(k, dt * self.slow) + facts.first_mode
        return q

    def bears_coupling(self, k: int, dt: float) -> bool:
        """Whether a step bears that forces on a ring's place depend on the spine's, which goes by a step of its own."""
        return True

    def bears_place(self, k: int, dt: float, tied: bool = True, share: float = 1.0, over: float = 1.0) -> bool:
        """`bears_coupling` of a scheme whose P knows the spine's a and the ties of a ring's mean, or b of all modes.

        Args:
            k: which tube.
            dt: step.
            tied: whether the ring's mean has its ties in P, not b.
            share: of the stiffness of other modes in P.
            over: what P of other modes is divided by.
        """
        f = self.facts[k]
        implicit = np.array([f.reaction + f.b / 2 + f.depth if tied else f.b, share * (f.b + f.ring[2]), f.a])
        if self.mass:  # the rule is stable up to K = 4 A
            return bool((np.linalg.eigvals(f.place / (self.inert(k, dt) + implicit)[:, None]).real < 1).all())
        steps = dt * np.array([self.slow, 1.0, self.slow * self.spine])
        p = (np.array([0.5 * self.inert(k, float(step)) for step in steps]) + implicit) / [1.0, over, 1.0]
        return bool((np.abs(1 - np.linalg.eigvals(f.place / p[:, None])) < 1 + 1e-9).all())

    def inert(self, k: int, dt: float) -> float:
        """What inertia, or without it the medium, leaves room for: 2 gamma / dt, or 4 mu / h^2 with mass."""
        return 4 * self.facts[k].inertia / dt**2 if self.mass else 2 * self.facts[k].inertia / dt

    def solve_lines(self, state: State) -> None:
        """Turns dt R in `state.delta` and `state.low` into the step, in place."""
        raise NotImplementedError

    @property
    def whole(self) -> bool:
        """Whether all modes take one step, so that they need not be parted."""
        return self.mass

    def step(self, state: State) -> None:
        """One step from the forces in `state`: launches only, so it can be captured, unless `captured` is False."""
        m, s = self.model, state
        wp.launch(
            integrate.split_modes,
            m.rings,
            inputs=[
                m.ring_tube, m.ring_node, m.tube_nx, m.ring_closed, m.node_wave, self.first_mode, self.step_size,
                s.tube, s.centroid, s.radius, s.force, s.spine_force, s.velocity, m.rings,
            ],
            outputs=[s.delta, s.low, s.residual, s.power],
            device=m.device,
        )  # fmt: skip
        if self.whole:
            self._join(state)
        self.solve_lines(state)
        if self.mass:
            self._advance_mass(state)
            return
        wp.launch(
            integrate.gather_momentum,
            m.tubes,
            inputs=[m.tube_ring, m.tube_ns, s.power, self.momentum],
            outputs=[s.age, s.momentum],
            device=m.device,
        )
        wp.launch(
            integrate.advance,
            m.rings,
            inputs=[m.ring_tube, m.ring_node, m.tube_nx, m.node_wave, s.delta, s.low, s.momentum, m.rings],
            outputs=[s.tube, s.spine, s.velocity, s.spine_velocity],
            device=m.device,
        )

    means_apart = False
    """Whether whole steps keep the means of a closed tube's rings in `state.low`, where lines along s solve for them."""

    def _join(self, state: State) -> None:
        m, s = self.model, state
        wp.launch(
            integrate.join_modes,
            m.rings,
            inputs=[
                m.ring_tube, m.ring_node, m.ring_s, m.tube_nx, m.tube_ns, m.tube_ring, m.ring_closed,
                m.mu, m.gamma, m.spine_mu, m.spine_gamma, self.step_size,
                s.force, s.spine_force, s.velocity, s.spine_velocity,
                m.rings, int(self.means_apart), self.dt if self.mass else 0.0,
            ],
            outputs=[s.delta, s.low, s.residual],
            device=m.device,
        )  # fmt: skip

    def _advance_mass(self, state: State) -> None:
        m, s = self.model, state
        wp.launch(
            integrate.advance_mass,
            m.nodes,
            inputs=[m.node_ring, m.ring_node, s.delta, s.low, m.rings, self.dt],
            outputs=[s.tube, s.spine, s.velocity, s.spine_velocity],
            device=m.device,
        )


def end_mass(ns: int) -> np.ndarray:
    """Share of a cell that belongs to each ring, shape (ns,): half at the ends."""
    m = np.ones(ns)
    m[0] = m[-1] = 0.5
    return m


def slow_mean(weight: np.ndarray) -> np.ndarray:
    """What a ring's modes k = 0, +-1 meet of an uneven weight, shape (ns, nx): its mean, and at most twice that."""
    mean = weight[:, 0] + (weight - weight[:, :1]).mean(axis=1)
    return np.minimum(weight.max(axis=1), 2 * mean)
