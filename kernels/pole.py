"""The image force on closed ends: it carries them into tips."""

import warp as wp

from . import image, projection


@wp.kernel(enable_backward=False)
def pole_force(
    # model
    tube_node: wp.array[int],
    tube_ring: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    ring_closed: wp.array[int],
    eyes: wp.array[projection.Eye],
    fields: wp.array[image.Field],
    samples: wp.array[wp.vec4],
    spread: wp.array[wp.mat33],
    # state in
    tube_in: wp.array[wp.vec3],
    spine_in: wp.array[wp.vec3],
    facing_in: wp.array[float],
    # scalars
    view: int,
    views: int,
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds the region's pressure on closed ends that lie on the contour, along the spine: it carries poles into tips.

    At a tip the contour's own normals point sideways, so that the line integral has no force along it. An end beyond the
    only image stays where it is: all forces on it so far are taken away.
    """
    i = wp.tid()
    k = i // 2
    n = tube_nx[k]
    ns = tube_ns[k]
    ring = tube_ring[k]
    node = tube_node[k]
    inner = ring + 2
    if i % 2 == 1:
        ring += ns - 1
        node += n * (ns - 1)
        inner = ring - 2
    if ring_closed[ring] == 0:
        return
    eye = eyes[view]
    field = fields[k]
    v = tube_in[node]
    p = projection.project(eye, v)
    if image.outside(field, p) != 0:
        if views == 1:
            for x in range(n):
                force_out[node + x] = wp.vec3(0.0)
        return
    q = projection.project(eye, spine_in[inner])
    on_contour = 1.0 - wp.abs(facing_in[node]) / 0.25
    e = p - q
    if on_contour <= 0.0 or wp.length(e) < 1.0e-6:
        return
    d = projection.depth(eye, v)
    j0 = projection.jacobian_row(eye.row0, eye.row2, p[0], d)
    j1 = projection.jacobian_row(eye.row1, eye.row2, p[1], d)
    push = image.sample(samples, field, p)[3] * on_contour
    f = field.gain * float(n) * (spread[ring] * image.lift(j0, j1, push * wp.normalize(e)))
    for x in range(n):
        wp.atomic_add(force_out, node + x, f / float(n))
