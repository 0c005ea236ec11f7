"""Sheets: grids of nodes that are open along s and around x either closed or cut; a snake is one line of such a grid.

A cut is the paper's own discontinuity (section 3): weights of 0 at the seam, w10 on its edge, w20 at its two nodes, w11 in
its cells. What is left are the natural ends of an open line, so open and closed lines share every kernel.
"""

import warp as wp

from . import elastic, image, projection


@wp.func
def even(before: wp.vec3, here: wp.vec3, after: wp.vec3):
    """Along the curve alone, the second difference: nodes slide to even distances and the curve itself feels nothing."""
    t = wp.normalize(after - before)
    return wp.dot(elastic.bend(before, here, after), t) * t


@wp.func
def stretch(e: wp.vec3, natural: float, last: int):
    """Pull of an edge longer than its natural length, (|e| - L1) e/|e|; shorter ones, which would buckle, push if last."""
    long = wp.length(e)
    if last == 0 and long < natural:
        return wp.vec3(0.0)
    return (long - natural) / wp.max(long, 1.0e-12) * e


@wp.kernel(enable_backward=False)
def mean_edges(
    # model
    tube_node: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    seam: wp.array[int],
    # state in
    node_in: wp.array[wp.vec3],
    # out
    natural_out: wp.array[float],
):
    """Sets the natural length L1 of a snake's edges: of a closed one their mean, so it may grow, but not in places alone.

    An open one keeps its first length, the unit: nothing else would hold its ends where they are.
    """
    k = wp.tid()
    n = tube_nx[k]
    start = tube_node[k]
    if seam[k] == 0 or tube_ns[k] > 1:
        natural_out[k] = 1.0 / float(n - 1)
        return
    whole = float(0.0)
    for x in range(n):
        whole += wp.length(node_in[start + elastic.wrap(x + 1, n)] - node_in[start + x])
    natural_out[k] = whole / float(n)


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
    seam: wp.array[int],
    # state in
    node_in: wp.array[wp.vec3],
    natural_in: wp.array[float],
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
    else:
        v = node_in[i]
        before = node_in[start + elastic.wrap(x - 1, n)]
        after = node_in[start + elastic.wrap(x + 1, n)]
        e = wp.vec3(0.0)
        if seam[k] != 0 or (x > 0 and x < n - 1):
            e = even(before, v, after)
        if seam[k] != 0 or x > 0:
            e -= stretch(v - before, natural_in[k], int(seam[k] == 0 and (x == 1 or x == n - 1)))
        if seam[k] != 0 or x < n - 1:
            e += stretch(after - v, natural_in[k], int(seam[k] == 0 and (x == 0 or x == n - 2)))
        f += k1[k] / (hx * hx) * e
    force_out[i] = f + m[0] * m[1] * load[k]


@wp.kernel(enable_backward=False)
def outline_force(
    # model
    outline: wp.array2d[int],
    place: wp.array[wp.vec4],
    along: wp.array[wp.vec4],
    share: wp.array[float],
    outline_tube: wp.array[int],
    eyes: wp.array[projection.Eye],
    fields: wp.array[image.Field],
    samples: wp.array[wp.vec4],
    # state in
    node_in: wp.array[wp.vec3],
    # scalars
    literal: int,
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds the integral of the image force (11) over an outline, a snake or a sheet's border, even in its own coordinate.

    Each point hangs on four nodes of `outline` by the weights of its `place`; `along` are those of the curve's direction,
    whose left is outward as the image is seen. `share` is what the point's part of a line load comes to per hx hs.
    """
    j = wp.tid()
    k = outline_tube[j]
    eye = eyes[k]
    v = wp.vec3(0.0)
    t = wp.vec3(0.0)
    for a in range(4):
        u = node_in[outline[j, a]]
        v += place[j][a] * u
        t += along[j][a] * u
    p = projection.project(eye, v)
    d = projection.depth(eye, v)
    j0 = projection.jacobian_row(eye.row0, eye.row2, p[0], d)
    j1 = projection.jacobian_row(eye.row1, eye.row2, p[1], d)
    e = wp.vec2(wp.dot(j0, t), wp.dot(j1, t))
    value = image.sample(samples, fields[k], p)
    if literal != 0:
        f = image.chain(j0, j1, wp.vec2(value[0], value[1]))
    else:
        f = image.lift(j0, j1, image.normal_pull(value, wp.normalize(wp.vec2(e[1], -e[0]))))
    f = fields[k].gain * share[j] * f
    for a in range(4):
        wp.atomic_add(force_out, outline[j, a], place[j][a] * f)


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
