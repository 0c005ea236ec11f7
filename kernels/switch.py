"""The paper's own image force on the occluding contour: nodes are switched on and off by beta (12)."""

import warp as wp

from . import image, projection

AT_NODES = wp.constant(25.0)
"""Gain of a force density at nodes over that of a line load: makes (12) as strong as `sim.assembly.LINE_LOAD` at 25 x 25."""


@wp.kernel(enable_backward=False)
def switch_force(
    # model
    node_ring: wp.array[int],
    ring_tube: wp.array[int],
    eyes: wp.array[projection.Eye],
    fields: wp.array[image.Field],
    samples: wp.array[wp.vec4],
    spread: wp.array[wp.mat33],
    # state in
    tube_in: wp.array[wp.vec3],
    normal_in: wp.array[wp.vec3],
    facing_in: wp.array[float],
    # scalars
    view: int,
    literal: int,
    tau: float,
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds the image force (11) by the paper's switch (12): beta is 1 at nodes where |i.n| < tau, else 0."""
    i = wp.tid()
    if wp.abs(facing_in[i]) >= tau:
        return
    eye = eyes[view]
    field = fields[ring_tube[node_ring[i]]]
    v = tube_in[i]
    p = projection.project(eye, v)
    d = projection.depth(eye, v)
    j0 = projection.jacobian_row(eye.row0, eye.row2, p[0], d)
    j1 = projection.jacobian_row(eye.row1, eye.row2, p[1], d)
    value = image.sample(samples, field, p)
    if literal != 0:
        f = image.chain(j0, j1, wp.vec2(value[0], value[1]))
    else:
        m = wp.vec2(wp.dot(j0, normal_in[i]), wp.dot(j1, normal_in[i]))
        f = image.lift(j0, j1, image.normal_pull(value, wp.normalize(m)))
    wp.atomic_add(force_out, i, AT_NODES * field.gain * (spread[node_ring[i]] * f))
