"""Coupling of tube and spine, (7)-(9), and the two forces of ours that keep rings upright and evenly spaced."""

import warp as wp

from . import elastic

SMALL = wp.constant(1.0e-9)


@wp.func
def unit(v: wp.vec3):
    """v / |v|, zero where v is."""
    return v / wp.max(wp.length(v), SMALL)


@wp.func
def end_mass(s: int, ns: int):
    """Share of a cell that belongs to ring s: half at the ends."""
    if s == 0 or s == ns - 1:
        return 0.5
    return 1.0


@wp.func
def attract(strength: float, target: wp.vec3, position: wp.vec3):
    """f_a of (7), a (target - position)."""
    return strength * (target - position)


@wp.func
def symmetry(b: float, mean_radius: float, r: wp.vec3):
    """f_b of (8), b (rbar - |r|) r/|r|."""
    return b * (mean_radius - wp.length(r)) * unit(r)


@wp.func
def expansion(c: float, r: wp.vec3, floor: float):
    """f_c of (9), c r/|r|, linear within `floor` of the spine so that a cinched end stays regular."""
    return c * r / wp.max(wp.length(r), wp.max(floor, SMALL))


@wp.func
def upright(d: float, offset: wp.vec3, tangent: wp.vec3):
    """-d (offset . t) t: pulls a ring's nodes into the plane across the spine."""
    return -d * wp.dot(offset, tangent) * tangent


@wp.kernel(enable_backward=False)
def ring_means(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    # state in
    tube_in: wp.array[wp.vec3],
    spine_in: wp.array[wp.vec3],
    # out
    centroid_out: wp.array[wp.vec3],
    radius_out: wp.array[float],
    gap_out: wp.array[float],
    tangent_out: wp.array[wp.vec3],
):
    """Sets centroid and mean radius of each ring (below fig. 7), mean distance to the next ring, spine tangent."""
    r = wp.tid()
    k = ring_tube[r]
    n = tube_nx[k]
    s = ring_s[r]
    last = tube_ns[k] - 1
    start = ring_node[r]
    centre = spine_in[r]
    around = float(0.0)
    moment = wp.vec3(0.0)
    reach = float(0.0)
    gap = float(0.0)
    plain = wp.vec3(0.0)
    before = tube_in[start + n - 1]
    here = tube_in[start]
    for x in range(n):
        after = tube_in[start + (x + 1) % n]
        w = 0.5 * (wp.length(here - before) + wp.length(after - here)) + SMALL
        around += w
        moment += w * (here - centre)
        reach += w * wp.length(here - centre)
        plain += here
        if s < last:
            gap += wp.length(tube_in[start + n + x] - here)
        before = here
        here = after
    centroid_out[r] = centre + moment / around
    radius_out[r] = reach / around
    gap_out[r] = gap / float(n)
    lo = r - wp.min(s, 1)
    hi = r + wp.min(last - s, 1)
    tangent_out[r] = unit(spine_in[hi] - spine_in[lo])


@wp.kernel(enable_backward=False)
def tube_force(
    # model
    node_ring: wp.array[int],
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    ring_closed: wp.array[int],
    w10: wp.array[float],
    w20: wp.array[float],
    w11: wp.array[float],
    w01: wp.array[float],
    w02: wp.array[float],
    coupling: wp.array2d[float],
    # state in
    tube_in: wp.array[wp.vec3],
    spine_in: wp.array[wp.vec3],
    centroid_in: wp.array[wp.vec3],
    radius_in: wp.array[float],
    gap_in: wp.array[float],
    tangent_in: wp.array[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Sets the intrinsic force on each tube node: (5), f_a, f_b, f_c of (10), upright rings, even spacing.

    Forces are loads per hx hs, so end nodes, which own half a cell, carry half.
    """
    i = wp.tid()
    r = node_ring[i]
    k = ring_tube[r]
    n = tube_nx[k]
    ns = tube_ns[k]
    s = ring_s[r]
    start = ring_node[r]
    x = i - start
    hx = 1.0 / float(n)
    hs = 1.0 / float(ns - 1)
    v = tube_in[i]
    f = elastic.line_force(tube_in, w01, w02, i, n, s, ns, hs)
    f += elastic.twist_force(tube_in, w11, start, x, n, s, ns, hx, hs)
    mass = end_mass(s, ns)
    f += mass * attract(coupling[r, 1], spine_in[r], centroid_in[r])
    if ring_closed[r] == 0:
        f += mass * elastic.ring_force(tube_in, w10, w20, start, x, n, hx)
        offset = v - spine_in[r]
        f += mass * symmetry(coupling[r, 2], radius_in[r], offset)
        c = coupling[r, 3] + coupling[r, 4] * radius_in[r]
        f += mass * expansion(c, offset, 0.1 * radius_in[r])
        f += mass * upright(coupling[r, 5], v - centroid_in[r], tangent_in[r])
        if s > 0 and s < ns - 1:
            along = unit(tube_in[i + n] - tube_in[i - n])
            f += coupling[r, 6] * (gap_in[r] - gap_in[r - 1]) / (hs * hs) * along
    force_out[i] = f


@wp.kernel(enable_backward=False)
def spine_force(
    # model
    ring_tube: wp.array[int],
    ring_s: wp.array[int],
    tube_ns: wp.array[int],
    w1: wp.array[float],
    w2: wp.array[float],
    coupling: wp.array2d[float],
    # state in
    spine_in: wp.array[wp.vec3],
    centroid_in: wp.array[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Sets the force on each spine node: (4) and f_a of (7)."""
    r = wp.tid()
    ns = tube_ns[ring_tube[r]]
    f = elastic.line_force(spine_in, w1, w2, r, 1, ring_s[r], ns, 1.0 / float(ns - 1))
    force_out[r] = f + end_mass(ring_s[r], ns) * attract(coupling[r, 0], centroid_in[r], spine_in[r])
