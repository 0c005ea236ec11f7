"""Sheets: grids of nodes that are open along s and around x either closed or cut; a snake is one line of such a grid.

A cut is the paper's own discontinuity (section 3): weights of 0 at the seam, w10 on its edge, w20 at its two nodes, w11 in
its cells. What is left are the natural ends of an open line, so open and closed lines share every kernel.
"""

import warp as wp

from . import elastic, image, projection


@wp.func
def even(k1: float, before: wp.vec3, here: wp.vec3, after: wp.vec3, h: float):
    """Along the curve alone, K1 v_ss: nodes slide to even distances and the curve itself feels nothing."""
    t = wp.normalize(after - before)
    return k1 / (h * h) * wp.dot(elastic.bend(before, here, after), t) * t


@wp.kernel(enable_backward=False)
def sheet_force(
    # model
    node_ring: wp.array[int],
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    step: wp.array[wp.vec2],
    mass: wp.array[wp.vec2],
    w10: wp.array[float],
    w20: wp.array[float],
    w11: wp.array[float],
    w01: wp.array[float],
    w02: wp.array[float],
    k1: wp.array[float],
    load: wp.array[wp.vec3],
    # state in
    node_in: wp.array[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Sets minus (4), (5) plus an even load on each node, per hx hs; border nodes own half a cell, or a quarter."""
    i = wp.tid()
    r = node_ring[i]
    k = ring_tube[r]
    n = tube_nx[k]
    ns = tube_ns[k]
    start = ring_node[r]
    x = i - start
    hx = step[k][0]
    hs = step[k][1]
    m = mass[i]
    f = m[1] * elastic.ring_force(node_in, w10, w20, start, x, n, hx)
    if ns > 1:
        f += m[0] * elastic.line_force(node_in, w01, w02, i, n, ring_s[r], ns, hs)
        f += elastic.twist_force(node_in, w11, start, x, n, ring_s[r], ns, hx, hs)
    elif m[0] == 1.0:
        f += even(k1[k], node_in[start + (x + n - 1) % n], node_in[i], node_in[start + (x + 1) % n], hx)
    force_out[i] = f + m[0] * m[1] * load[k]


@wp.kernel(enable_backward=False)
def outline_force(
    # model
    outline: wp.array2d[int],
    outline_tube: wp.array[int],
    eyes: wp.array[projection.Eye],
    fields: wp.array[image.Field],
    samples: wp.array[wp.vec4],
    step: wp.array[wp.vec2],
    # state in
    node_in: wp.array[wp.vec3],
    # scalars
    literal: int,
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds the image force (11) to the nodes of an outline, a snake or a sheet's border, by the length each stands for.

    `outline` holds a node, the ones before and after it on its line (itself at an open end); outward is to the left of
    the way along it, as the image is seen.
    """
    j = wp.tid()
    i = outline[j, 0]
    k = outline_tube[j]
    eye = eyes[k]
    v = node_in[i]
    before = node_in[outline[j, 1]]
    after = node_in[outline[j, 2]]
    p = projection.project(eye, v)
    e = projection.project(eye, after) - projection.project(eye, before)
    length = 0.5 * (wp.length(v - before) + wp.length(after - v))
    if wp.length(e) < 1.0e-6:
        return
    d = projection.depth(eye, v)
    j0 = projection.jacobian_row(eye.row0, eye.row2, p[0], d)
    j1 = projection.jacobian_row(eye.row1, eye.row2, p[1], d)
    value = image.sample(samples, fields[k], p)
    density = fields[k].gain * length / (step[k][0] * step[k][1])
    if literal != 0:
        f = image.chain(j0, j1, wp.vec2(value[0], value[1]))
    else:
        f = image.lift(j0, j1, image.normal_pull(value, wp.normalize(wp.vec2(e[1], -e[0]))))
    force_out[i] = force_out[i] + density * f


@wp.kernel(enable_backward=False)
def scale_force(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    tube_nx: wp.array[int],
    dt: wp.array[float],
    # state in
    force_in: wp.array[wp.vec3],
    velocity_in: wp.array[wp.vec3],
    # out
    delta_out: wp.array[wp.vec3],
    power_out: wp.array[float],
):
    """Sets dt R, and for each ring the power of R along the step before, by which momentum is judged."""
    r = wp.tid()
    k = ring_tube[r]
    power = float(0.0)
    for x in range(tube_nx[k]):
        i = ring_node[r] + x
        power += wp.dot(force_in[i], velocity_in[i])
        delta_out[i] = dt[k] * force_in[i]
    power_out[r] = power


@wp.kernel(enable_backward=False)
def advance(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    tube_nx: wp.array[int],
    dt: wp.array[float],
    # state in
    delta_in: wp.array[wp.vec3],
    momentum_in: wp.array[float],
    # out
    node_out: wp.array[wp.vec3],
    velocity_out: wp.array[wp.vec3],
    residual_out: wp.array[float],
):
    """Adds the step and momentum times the one before; sets each ring's mean square of the step over dt."""
    r = wp.tid()
    k = ring_tube[r]
    n = tube_nx[k]
    total = float(0.0)
    for x in range(n):
        i = ring_node[r] + x
        total += wp.length_sq(delta_in[i])
        d = delta_in[i] + momentum_in[k] * velocity_out[i]
        velocity_out[i] = d
        node_out[i] = node_out[i] + d
    residual_out[r] = total / (float(n) * dt[k] * dt[k])
