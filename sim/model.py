"""Flat arrays of all tubes: what stays (`Model`) and what moves (`State`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from ..kernels import coupling, image, projection
from .camera import Camera
from .guide import MODES

SPINE_TO_RING, REACTION, SYMMETRY, EXPAND, BALANCE, UPRIGHT, CENTRE, DEPTH, FREE = range(9)
"""Columns of `Model.coupling`."""

BEND_DEGREE = 3
"""Degree in s of the bend that a spine takes on as its natural one (natural curvature, section 3)."""


def bend_basis(ns: int, found: Sequence[tuple[int, bool]] = ()) -> np.ndarray:
    """Orthonormal polynomials in s on the interior nodes of each piece of a spine, 0 elsewhere, shape (ns, BEND_DEGREE + 1).

    `found` as `fields.cuts` returns it. The degree falls with the share of the nodes that a piece has.
    """
    basis = np.zeros((ns, BEND_DEGREE + 1))
    ends = [0, *(k for k, _ in found), *(k + 1 for k, gap in found if gap), ns - 1]
    inner = np.setdiff1d(np.arange(ns), ends)
    for run in np.split(inner, np.flatnonzero(np.diff(inner) > 1) + 1):
        if len(run):
            degree = min(round(BEND_DEGREE * len(run) / (ns - 2)), len(run) - 1)
            powers = np.polynomial.legendre.legvander(np.linspace(-1, 1, len(run)), degree)
            basis[run, : degree + 1] = np.linalg.qr(powers)[0]
    return basis


class Model:
    """Grids, weights and cameras of a scene: all tubes in flat arrays, rings contiguous, ring after ring.

    Positions are in units of the initial spine length of each tube, so that weights are free of units.

    Attributes (N nodes, R rings, K tubes, V views):
        node_ring: ring of each node, shape (N,).
        ring_tube, ring_node, ring_s, ring_closed: tube, first node, index along, closed end or not, shape (R,).
        node_wave: cosine and sine of each node's angle 2 pi x / N_x, shape (N,).
        tube_nx, tube_ns, tube_node, tube_ring: grid and first node and ring of each tube, shape (K,).
        w10, w20, w11, w01, w02: weights of (3), shape (N,); w01 belongs to the edge to the next ring, w10 to the next node.
        w1, w2: weights of (2), shape (R,).
        coupling: columns a, reaction, b, c, balance, d, centre, depth, free, shape (R, 9);
            free only where w20 varies round a ring
        depth_rest: depth along the line of sight that `depth` holds, shape (R,).
        bend_basis: orthonormal polynomials in s on the interior of each piece of a spine, shape (R, BEND_DEGREE + 1).
        stretch10, stretch01: natural lengths of edges around and along: K, L, most of |dv| - L, shape (N, 3).
        bound10, bound01, bound1: tension that natural shapes of tube and spine can come to, for matrices alone,
            shape (N,), (N,), (R,).
        curvature: natural C20, C11, C02 on the outward normal, shape (N, 3); C11 belongs to a cell as w11 does.
        spine_stretch: natural length L1 of the spine's edges, below 0 for none, and most of |dv| - L1, shape (R, 2).
        spine_curvature: 1 where a natural curvature of the spine is given, 0 for its own even bend; and C2, shape (R, 2).
        ring_first, ring_last, spine_first, spine_last: how far each ring of tube or spine may look back and ahead along s
            before a discontinuity, shape (R,).
        look_first, look_last: how far a ring's tangent looks: across creases of the spine, so that rings go over from one
            side to the other little by little, but not across gaps, shape (R,).
        shaped, torn, tense, twisted: whether any tube has natural lengths or curvatures, a gap, a weight w10 or w01, or w11.
        uneven: whether a balanced w20 varies round any ring.
        ring_far: importance for a ring's tangent of the j-th segment of the spine either way, shape (R, WINDOW).
        k1: tension factor K1 of the spine's edges, shape (R,).
        edge_hold, ring_slack: stiffness of the springs that keep nodes' shares of the way to the next ring, 0 for none,
            shape (N,); and the mean over each ring of one over it, shape (R,).
        mu, gamma: mass density and viscosity of the medium (1) of tube nodes, shape (N,).
        spine_mu, spine_gamma: the same of spine nodes, shape (R,).
        image_load: stiffness of the image's force, by unit of the contour's length and of s, shape (K,), on the host.
        eyes: cameras in each tube's units, shape (V,) (see `set_cameras`).
        fields: potential of each tube in each view, shape (K, V).
        samples: all potentials' samples, (pull column, pull row, pressure, pressure at a pole) [px].
        guide, weak: strength of the pull to a spine's course, shape (R,), and the direction that it acts in, as long as the
            root of how much it is needed, shape (R,) (`guide.weakest`).
        course_modes, course_say: of each spine's course, shape (R, MODES), and weights, shape (R,) (`guide.course`).
        spread, boost: of what views pull a ring by over directions, by node and by ring (`sights.spread`), shape (R,).
    """

    def __init__(self, grids: list[tuple[int, int]], closed: list[bool], views: int, samples: int, device: str):
        self.device = device
        self.grids = grids
        nodes = [nx * ns for nx, ns in grids]
        self.node_start = np.concatenate([[0], np.cumsum(nodes)])
        self.ring_start = np.concatenate([[0], np.cumsum([ns for _, ns in grids])])
        self.nodes, self.rings, self.tubes, self.views = (
            int(sum(nodes)),
            int(self.ring_start[-1]),
            len(grids),
            views,
        )
        ring_tube = np.repeat(np.arange(self.tubes), [ns for _, ns in grids])
        ring_s = np.concatenate([np.arange(ns) for _, ns in grids])
        ring_node = np.concatenate([b + nx * np.arange(ns) for b, (nx, ns) in zip(self.node_start, grids, strict=False)])
        ns_of = np.array([ns for _, ns in grids])[ring_tube]
        ring_closed = np.array(closed)[ring_tube] & ((ring_s == 0) | (ring_s == ns_of - 1))
        self.host_ring_tube, self.host_ring_closed = ring_tube, ring_closed
        line_tube = np.concatenate([np.full(nx + 4, k) for k, (nx, _) in enumerate(grids)])
        line_x = np.concatenate([np.concatenate([np.arange(nx), [-1, -2, -3, -4]]) for nx, _ in grids])

        def ints(a: np.ndarray) -> wp.array:
            return wp.array(np.ascontiguousarray(a, np.int32), dtype=int, device=device)

        self.node_ring = ints(np.repeat(np.arange(self.rings), np.array([nx for nx, _ in grids])[ring_tube]))
        angle = np.concatenate([np.tile(2 * np.pi * np.arange(nx) / nx, ns) for nx, ns in grids])
        wave = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
        self.node_wave = wp.array(wave, dtype=wp.vec2, device=device)
        self.ring_tube, self.ring_node, self.ring_s = ints(ring_tube), ints(ring_node), ints(ring_s)
        self.ring_closed = ints(ring_closed)
        self.tube_nx, self.tube_ns = (
            ints(np.array([g[0] for g in grids])),
            ints(np.array([g[1] for g in grids])),
        )
        self.tube_node, self.tube_ring = ints(self.node_start[:-1]), ints(self.ring_start[:-1])
        self.line_tube, self.line_x, self.lines = ints(line_tube), ints(line_x), len(line_x)
        self.w10, self.w20, self.w11, self.w01, self.w02 = (
            wp.zeros(self.nodes, dtype=float, device=device) for _ in range(5)
        )
        self.w1, self.w2 = (wp.zeros(self.rings, dtype=float, device=device) for _ in range(2))
        self.coupling = wp.zeros(self.rings, dtype=coupling.Coupling, device=device)
        basis = np.concatenate([bend_basis(ns) for _, ns in grids]).astype(np.float32)
        self.bend_basis = wp.array(basis, dtype=float, device=device)
        nearest = np.tile(np.eye(1, int(coupling.WINDOW), dtype=np.float32), (self.rings, 1))
        self.ring_far = wp.array(nearest, dtype=float, device=device)
        self.stretch10, self.stretch01, self.curvature = (
            wp.zeros(self.nodes, dtype=wp.vec3, device=device) for _ in range(3)
        )
        self.bound10, self.bound01 = (wp.zeros(self.nodes, dtype=float, device=device) for _ in range(2))
        self.bound1 = wp.zeros(self.rings, dtype=float, device=device)
        self.spine_stretch = wp.full(self.rings, wp.vec2(-1.0, 0.0), dtype=wp.vec2, device=device)
        self.spine_curvature = wp.zeros(self.rings, dtype=wp.vec2, device=device)
        self.ring_first, self.spine_first, self.look_first = (ints(np.zeros(self.rings)) for _ in range(3))
        self.ring_last, self.spine_last, self.look_last = (ints(ns_of - 1) for _ in range(3))
        self.shaped, self.torn, self.tense, self.twisted, self.uneven = False, False, True, True, True
        self.edge_hold = wp.zeros(self.nodes, dtype=float, device=device)
        self.k1, self.ring_slack = (wp.zeros(self.rings, dtype=float, device=device) for _ in range(2))
        self.mu, self.spine_mu = (wp.zeros(n, dtype=float, device=device) for n in (self.nodes, self.rings))
        self.gamma, self.spine_gamma = (wp.ones(n, dtype=float, device=device) for n in (self.nodes, self.rings))
        self.image_load = np.zeros(self.tubes)
        self.depth_rest = wp.zeros(self.rings, dtype=float, device=device)
        self.eyes = wp.zeros(max(views, 1), dtype=projection.Eye, device=device)  # pyright: ignore
        self.fields = wp.zeros((self.tubes, views), dtype=image.Field, device=device)  # pyright: ignore
        self.samples = wp.zeros(samples, dtype=wp.vec4, device=device)
        self.spread = wp.full(self.rings, wp.mat33(*np.eye(3).ravel()), dtype=wp.mat33, device=device)
        self.guide, self.course_say = (wp.zeros(self.rings, dtype=float, device=device) for _ in range(2))
        self.weak = wp.zeros(self.rings, dtype=wp.vec3, device=device)
        self.course_modes = wp.zeros((self.rings, MODES), dtype=float, device=device)
        self.boost = wp.zeros(self.rings, dtype=wp.mat33, device=device)

    def nodes_of(self, k: int) -> slice:
        """Nodes of tube k in the flat arrays."""
        return slice(int(self.node_start[k]), int(self.node_start[k + 1]))

    def rings_of(self, k: int) -> slice:
        """Rings (spine nodes) of tube k in the flat arrays."""
        return slice(int(self.ring_start[k]), int(self.ring_start[k + 1]))

    def stiffness(self, share: float) -> dict[str, np.ndarray]:
        """Weights as matrices take them, none below 0: w10, w20, w11, w01, w02, shape (N,), w1 and w2, shape (R,), float64.

        The spine's tension holds that of its least lengths, and all tensions `share` of what natural shapes can make of
        them: half of that bears any step, the whole bounds what an explicit step meets. What compression makes negative
        stays outside.
        """
        names = ("w10", "w20", "w11", "w01", "w02", "w1", "w2")
        host = {name: getattr(self, name).numpy().astype(float) for name in names}
        host["w1"] += self.k1.numpy()
        for edge in ("10", "01", "1"):
            host["w" + edge] += share * getattr(self, "bound" + edge).numpy()
        return host

    def set_cameras(self, cameras: list[Camera]) -> None:
        """Sets `eyes`; the matrices take points in the model's own units."""
        eyes = [eye_of(camera) for camera in cameras]
        self.eyes.assign(wp.array(eyes, dtype=projection.Eye, device="cpu").numpy())


def eye_of(camera: Camera) -> Any:
    """A camera as the kernels know it, a `projection.Eye`."""
    m = camera.matrix
    eye = projection.Eye()
    eye.row0, eye.row1, eye.row2 = (wp.vec4(*map(float, row)) for row in m)
    eye.affine = int(camera.affine)
    if camera.affine:
        eye.axis = wp.vec3(*map(float, camera.sight(np.zeros(3))))
    else:
        eye.centre = wp.vec3(*map(float, -np.linalg.solve(m[:, :3], m[:, 3])))
    return eye


class State:
    """What moves: tube nodes (N,), spine nodes (R,) [initial spine lengths], and the arrays a step writes on the way."""

    def __init__(self, model: Model):
        def vectors(n: int) -> wp.array:
            return wp.zeros(n, dtype=wp.vec3, device=model.device)

        def scalars(n: int) -> wp.array:
            return wp.zeros(n, dtype=float, device=model.device)

        self.tube, self.spine = vectors(model.nodes), vectors(model.rings)
        self.velocity, self.spine_velocity = vectors(model.nodes), vectors(model.rings)
        self.force, self.spine_force = vectors(model.nodes), vectors(model.rings)
        self.normal, self.facing, self.edge = vectors(model.nodes), scalars(model.nodes), scalars(model.nodes)
        self.natural_bend, self.tension = vectors(model.rings), vectors(model.rings)
        self.centroid, self.tangent, self.tilt, self.moment, self.pull = (vectors(model.rings) for _ in range(5))
        self.course = wp.zeros((model.tubes, MODES), dtype=wp.vec3, device=model.device)  # pyright: ignore
        self.radius, self.gap, self.known, self.held = (scalars(model.rings) for _ in range(4))
        self.harmonic = wp.zeros((model.rings, 2), dtype=wp.vec3, device=model.device)  # pyright: ignore
        self.delta, self.low = vectors(model.nodes), vectors(4 * model.rings)
        self.residual, self.power = scalars(model.rings), scalars(model.rings)
        self.age, self.momentum = scalars(model.tubes), scalars(model.tubes)
