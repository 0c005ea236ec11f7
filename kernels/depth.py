"""Depth from views that look almost the same way: their weak pull along it made up for, and a guide where it fails."""

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


@wp.kernel(enable_backward=False)
def guide(
    # model
    tube_ring: wp.array[int],
    tube_ns: wp.array[int],
    tube_nx: wp.array[int],
    ring_node: wp.array[int],
    strength: wp.array[float],
    weak: wp.array[wp.vec3],
    modes: wp.array2d[float],
    say: wp.array[float],
    # state in
    spine_in: wp.array[wp.vec3],
    centroid_in: wp.array[wp.vec3],
    tangent_in: wp.array[wp.vec3],
    # out
    course_out: wp.array2d[wp.vec3],
    force_out: wp.array[wp.vec3],
    spine_force_out: wp.array[wp.vec3],
):
    """Sets the modes of each spine's course, and adds a pull of spine and rings to it (`sim.guide`).

    It acts along the direction that views tell least, across the axis: along it a ring may slide.
    """
    k = wp.tid()
    start = tube_ring[k]
    n = tube_ns[k]
    needed = float(0.0)
    for r in range(start, start + n):
        needed += strength[r] * wp.length_sq(weak[r])
    if needed == 0.0:
        return
    for j in range(modes.shape[1]):
        total = wp.vec3(0.0)
        for r in range(start, start + n):
            total += modes[r, j] * say[r] * spine_in[r]
        course_out[k, j] = total
    for i in range(n):
        r = start + i
        d = weak[r] - wp.dot(weak[r], tangent_in[r]) * tangent_in[r]
        there = wp.vec3(0.0)
        for j in range(modes.shape[1]):
            there += modes[r, j] * course_out[k, j]
        load = strength[r]
        if i == 0 or i == n - 1:
            load *= 0.5
        spine_force_out[r] = spine_force_out[r] + load * wp.dot(d, there - spine_in[r]) * d
        f = load * wp.dot(d, there - centroid_in[r]) * d
        for x in range(tube_nx[k]):
            force_out[ring_node[r] + x] = force_out[ring_node[r] + x] + f
