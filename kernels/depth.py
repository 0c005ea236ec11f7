"""Depth from views that look almost the same way: their weak pull along it, made up for ring by ring."""

import warp as wp


@wp.kernel(enable_backward=False)
def ring_sums(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    tube_nx: wp.array[int],
    # state in
    force_in: wp.array[wp.vec3],
    # out
    pull_out: wp.array[wp.vec3],
):
    """Sets the sum of the force on each ring's nodes."""
    r = wp.tid()
    total = wp.vec3(0.0)
    for x in range(tube_nx[ring_tube[r]]):
        total += force_in[ring_node[r] + x]
    pull_out[r] = total


@wp.kernel(enable_backward=False)
def deepen(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    tube_nx: wp.array[int],
    boost: wp.array[wp.mat33],
    # state in
    pull_in: wp.array[wp.vec3],
    tangent_in: wp.array[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds to a ring, evenly and across the spine, what its pull by all views lacks in depth; `pull_in` is the force before.

    Not to the nodes on the contour alone: what one eye's contour gets, that of the other, next to it, loses, and the
    difference would tear at the ring.
    """
    r = wp.tid()
    n = tube_nx[ring_tube[r]]
    start = ring_node[r]
    total = -pull_in[r]
    for x in range(n):
        total += force_out[start + x]
    t = tangent_in[r]
    f = boost[r] * total / float(n)
    f -= wp.dot(f, t) * t
    for x in range(n):
        force_out[start + x] = force_out[start + x] + f
