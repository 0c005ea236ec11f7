"""The right-hand side of (10): launches in order, each stage over all tubes at once."""

from __future__ import annotations

import warp as wp

from ..kernels import contour, coupling, depth, elastic, pole, rim, shape, switch
from .model import Model, State


def add_forces(model: Model, state: State, contour_kind: str, literal: bool, tau: float) -> None:
    """Sets `state.force` and `state.spine_force` to minus the elastic forces (4), (5) plus coupling and image force.

    Args:
        model: weights, cameras, potentials.
        state: positions in, forces out.
        contour_kind: "subnode" or "switch", the paper's (12).
        literal: the gradient of (11) by the chain rule instead of the normalised force.
        tau: threshold of (12).
    """
    m, s = model, state
    ring = [m.ring_tube, m.ring_node, m.ring_s, m.tube_nx, m.tube_ns]
    look = [m.look_first, m.look_last, m.ring_far]
    wp.launch(
        coupling.ring_means,
        m.rings,
        inputs=[*ring, *look, m.coupling, m.node_wave, s.tube, s.spine],
        outputs=[s.centroid, s.radius, s.gap, s.edge, s.tangent, s.known, s.tilt, s.harmonic],
        device=m.device,
    )
    wp.launch(
        coupling.ring_tension,
        m.rings,
        inputs=[m.ring_s, m.ring_first, m.ring_last, m.ring_slack, s.gap],
        outputs=[s.held],
        device=m.device,
    )
    wp.launch(
        coupling.tube_force,
        m.rings,
        inputs=[
            *ring, m.ring_closed, m.w20, m.w02, m.coupling, m.depth_rest, m.edge_hold, m.node_wave, m.eyes,
            s.tube, s.spine, s.centroid, s.radius, s.gap, s.edge, s.tangent, s.known, s.held, s.harmonic,
        ],
        outputs=[s.force],
        device=m.device,
    )  # fmt: skip
    if m.uneven:
        wp.launch(
            shape.even_out,
            m.rings,
            inputs=[*ring, m.ring_closed, m.w20, m.coupling, m.node_wave, s.tube, s.harmonic],
            outputs=[s.force],
            device=m.device,
        )
    if m.tense or m.twisted:
        wp.launch(
            shape.tense_sheet,
            m.nodes,
            inputs=[m.node_ring, *ring, m.ring_closed, m.w10, m.w11, m.w01, s.tube],
            outputs=[s.force],
            device=m.device,
        )
    if m.shaped:
        wp.launch(
            shape.shape_sheet,
            m.nodes,
            inputs=[
                m.node_ring, *ring, m.ring_closed, m.ring_first, m.ring_last,
                m.w20, m.w11, m.w02, m.stretch10, m.stretch01, m.curvature, s.tube,
            ],
            outputs=[s.force],
            device=m.device,
        )  # fmt: skip
    wp.launch(
        elastic.relax_spine,
        m.tubes,
        inputs=[
            m.tube_ring, m.tube_ns, m.ring_node, m.spine_first, m.spine_last, m.bend_basis, m.k1, m.w2,
            m.spine_stretch, m.spine_curvature, s.tube, s.spine, s.tangent,
        ],
        outputs=[s.natural_bend, s.tension],
        device=m.device,
    )  # fmt: skip
    wp.launch(
        coupling.upright_spine,
        m.rings,
        inputs=[m.ring_tube, m.ring_s, m.tube_ns, *look, s.tilt],
        outputs=[s.moment],
        device=m.device,
    )
    wp.launch(
        coupling.spine_force,
        m.rings,
        inputs=[
            m.ring_tube, m.ring_s, m.tube_ns, m.w1, m.w2, m.coupling, m.depth_rest, m.eyes,
            s.spine, s.natural_bend, s.tension, s.centroid, s.moment,
        ],
        outputs=[s.spine_force],
        device=m.device,
    )  # fmt: skip
    sums = [m.ring_tube, m.ring_node, m.tube_nx]
    if m.views > 1:
        wp.launch(
            depth.guide,
            m.tubes,
            inputs=[
                m.tube_ring, m.tube_ns, m.tube_nx, m.ring_node, m.guide, m.weak, m.course_modes, m.course_say,
                s.spine, s.centroid, s.tangent,
            ],
            outputs=[s.course, s.force, s.spine_force],
            device=m.device,
        )  # fmt: skip
        wp.launch(depth.ring_sums, m.rings, inputs=[*sums, s.force], outputs=[s.pull], device=m.device)
    for view in range(m.views):
        wp.launch(
            contour.normals,
            m.rings,
            inputs=[*ring[:-1], m.ring_first, m.ring_last, m.ring_closed, m.eyes, s.tube, s.centroid, view],
            outputs=[s.normal, s.facing],
            device=m.device,
        )
        potentials = [m.eyes, m.fields[:, view], m.samples, m.spread]
        pictures = [*potentials, s.tube, s.normal, s.facing, view, int(literal)]
        wp.launch(
            pole.pole_force,
            2 * m.tubes,
            inputs=[
                m.tube_node, m.tube_ring, m.tube_nx, m.tube_ns, m.ring_closed, *potentials,
                s.tube, s.spine, s.facing, view, m.views,
            ],
            outputs=[s.force],
            device=m.device,
        )  # fmt: skip
        if m.torn:
            wp.launch(
                rim.rim_force,
                m.rings,
                inputs=[
                    *ring, m.ring_first, m.ring_last, *potentials, s.tube, s.centroid, s.radius, view, int(literal),
                ],
                outputs=[s.force],
                device=m.device,
            )  # fmt: skip
        if contour_kind == "switch":
            wp.launch(
                switch.switch_force,
                m.nodes,
                inputs=[m.node_ring, m.ring_tube, *pictures, tau],
                outputs=[s.force],
                device=m.device,
            )
        else:
            wp.launch(
                contour.contour_force,
                m.rings,
                inputs=[*ring, m.ring_first, m.ring_last, *pictures],
                outputs=[s.force],
                device=m.device,
            )
    if m.views > 1:
        wp.launch(depth.deepen, m.rings, inputs=[*sums, m.boost, s.pull, s.tangent], outputs=[s.force], device=m.device)
