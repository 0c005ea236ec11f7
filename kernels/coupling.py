"""Coupling of tube and spine, (7)-(9), and forces of ours: upright rings, centred poles, hold of depth."""

import warp as wp

from . import elastic, projection

Coupling = wp.types.vector(length=9, dtype=float)
"""a, reaction, b, c, balance, d, centre, depth, free of a ring, as `sim.model` numbers them."""
SMALL = wp.constant(1.0e-9)
WINDOW = wp.constant(20)
"""Segments of the spine either side that a ring's tangent looks at."""
SHORTEST = wp.constant(0.5)
"""Length of a segment of the spine, in mean initial ones, below which a ring's tangent counts for less."""
THINNEST = wp.constant(0.004)
"""Radius below which a ring pushes itself open, in units of the initial length of the spine."""


@wp.func
def unit(v: wp.vec3):
    """v / |v|, zero where v is."""
    return 1.0 / wp.max(wp.length(v), SMALL) * v


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
def symmetry(b: float, mean_radius: float, length: float):
    """f_b of (8), b (rbar - |r|) r/|r|, over r."""
    return b * (mean_radius - length) / wp.max(length, SMALL)


@wp.func
def expansion(c: float, length: float, floor: float):
    """f_c of (9), c r/|r|, over r; linear within `floor` of the spine so that a cinched end stays regular."""
    return c / wp.max(length, wp.max(floor, SMALL))


@wp.func
def upright(d: float, offset: wp.vec3, tangent: wp.vec3):
    """-d (offset . t) t: pulls a ring's nodes into the plane across the spine."""
    return -d * wp.dot(offset, tangent) * tangent


@wp.func
def centre_pole(pole: wp.vec3, neighbour: wp.vec3, gap: float):
    """Spring of natural length `gap`, the mean over the meridians: their sum holds a pole in the middle of its cap."""
    e = neighbour - pole
    return e - gap * unit(e)


@wp.func
def hold_depth(strength: float, rest: float, eye: projection.Eye, v: wp.vec3):
    """Pull along the line of sight to the depth `rest`, which a lone view cannot see."""
    i = projection.sight(eye, v)
    if eye.affine != 0:
        return strength * (rest - wp.dot(i, v)) * i
    return strength * (rest - wp.length(v - eye.centre)) * i


@wp.kernel(enable_backward=False)
def ring_means(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    look_first: wp.array[int],
    look_last: wp.array[int],
    ring_far: wp.array2d[float],
    coupling: wp.array[Coupling],
    node_wave: wp.array[wp.vec2],
    # state in
    tube_in: wp.array[wp.vec3],
    spine_in: wp.array[wp.vec3],
    # out
    centroid_out: wp.array[wp.vec3],
    radius_out: wp.array[float],
    gap_out: wp.array[float],
    edge_out: wp.array[float],
    tangent_out: wp.array[wp.vec3],
    known_out: wp.array[float],
    tilt_out: wp.array[wp.vec3],
    harmonic_out: wp.array2d[wp.vec3],
):
    """Sets centroid and mean radius of each ring (below fig. 7), mean distance to the next ring, spine tangent, tilt.

    And one over the length of each node's edge to the next ring; and what of cosine and sine of 2 pi x is in the ring.

    The tangent looks `WINDOW` segments either way as far as the spine is in one piece, the j-th with importance
    `ring_far[., j]`: far ones count where near ones vanish, as they do under a flat end. Where all do, it counts for less,
    `known_out` times: a spine of no length has no direction.
    """
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
    cosine = wp.vec3(0.0)
    sine = wp.vec3(0.0)
    here = tube_in[start]
    behind = wp.length(here - tube_in[start + n - 1])
    for x in range(n):
        after = tube_in[start + elastic.wrap(x + 1, n)]
        ahead = wp.length(after - here)
        w = 0.5 * (behind + ahead) + SMALL
        around += w
        arm = here - centre
        moment += w * arm
        reach += w * wp.length(arm)
        wave = node_wave[start + x]
        cosine += wave[0] * arm
        sine += wave[1] * arm
        if s < last:
            edge = wp.length(tube_in[start + n + x] - here)
            gap += edge
            edge_out[start + x] = 1.0 / wp.max(edge, SMALL)
        behind = ahead
        here = after
    centroid = centre + moment / around
    centroid_out[r] = centroid
    radius_out[r] = reach / around
    gap_out[r] = gap / float(n)
    harmonic_out[r, 0] = 2.0 / float(n) * cosine
    harmonic_out[r, 1] = 2.0 / float(n) * sine
    along = wp.vec3(0.0)
    for j in range(WINDOW):
        if s + j < look_last[r]:
            along += ring_far[r, j] * (spine_in[r + j + 1] - spine_in[r + j])
        if s - j > look_first[r]:
            along += ring_far[r, j] * (spine_in[r - j] - spine_in[r - j - 1])
    least = SHORTEST / float(last)
    if look_first[r] < s and s < look_last[r]:
        least *= 2.0
    size = wp.length(along)
    known = wp.min(size / least, 1.0)
    t = unit(along)
    tilt = wp.vec3(0.0)
    for x in range(n):
        e = tube_in[start + x] - centroid
        tilt += wp.dot(e, t) * e
    if known == 1.0:
        tilt -= wp.dot(tilt, t) * t
    tangent_out[r] = t
    known_out[r] = known
    tilt_out[r] = coupling[r][5] * end_mass(s, last + 1) * known / (float(n) * wp.max(size, least)) * tilt


@wp.kernel(enable_backward=False)
def upright_spine(
    # model
    ring_tube: wp.array[int],
    ring_s: wp.array[int],
    tube_ns: wp.array[int],
    look_first: wp.array[int],
    look_last: wp.array[int],
    ring_far: wp.array2d[float],
    # state in
    tilt_in: wp.array[wp.vec3],
    # out
    moment_out: wp.array[wp.vec3],
):
    """Sets what `upright` does to each segment of the spine: minus the gradient of d/2 mean ((T - c).t)^2 by it.

    t is times `known`. Ring q looks from `look_first[q]` to `look_last[q]`, as far as the spine is in one piece.
    """
    r = wp.tid()
    s = ring_s[r]
    left = tube_ns[ring_tube[r]] - s
    f = wp.vec3(0.0)
    for j in range(WINDOW):
        if j <= s:
            if s < look_last[r - j]:
                f -= ring_far[r - j, j] * tilt_in[r - j]
        if j + 1 < left:
            if s >= look_first[r + j + 1]:
                f -= ring_far[r + j + 1, j] * tilt_in[r + j + 1]
    moment_out[r] = f


@wp.kernel(enable_backward=False)
def ring_tension(
    # model
    ring_s: wp.array[int],
    ring_first: wp.array[int],
    ring_last: wp.array[int],
    ring_slack: wp.array[float],
    # state in
    gap_in: wp.array[float],
    # out
    tension_out: wp.array[float],
):
    """Sets what the springs `edge_hold` along the meridians of a piece between discontinuities have in common.

    Without it each of stiffness h and length e pulls with h e. Less the mean meridian over its slack, the sum of 1/h,
    forces are minus the gradient of the mean over meridians of sum h/2 (e - (1/h) / slack * mean meridian)^2: nodes keep
    the shares they were dealt and do not slide along the surface for ever; ends are neither drawn nor pushed.
    """
    r = wp.tid()
    s = ring_s[r]
    tension_out[r] = 0.0
    if ring_slack[r] == 0.0 or s >= ring_last[r]:
        return
    length = float(0.0)
    slack = float(0.0)
    for q in range(r - s + ring_first[r + 1], r - s + ring_last[r]):
        length += gap_in[q]
        slack += ring_slack[q]
    tension_out[r] = length / slack


@wp.kernel(enable_backward=False)
def tube_force(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    ring_closed: wp.array[int],
    w20: wp.array[float],
    w02: wp.array[float],
    coupling: wp.array[Coupling],
    depth_rest: wp.array[float],
    edge_hold: wp.array[float],
    node_wave: wp.array[wp.vec2],
    eyes: wp.array[projection.Eye],
    # state in
    tube_in: wp.array[wp.vec3],
    spine_in: wp.array[wp.vec3],
    centroid_in: wp.array[wp.vec3],
    radius_in: wp.array[float],
    gap_in: wp.array[float],
    edge_in: wp.array[float],
    tangent_in: wp.array[wp.vec3],
    known_in: wp.array[float],
    tension_in: wp.array[float],
    harmonic_in: wp.array2d[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Sets the intrinsic force on each ring's nodes: (5) but for `shape.tense_sheet`, f_a, f_b, f_c of (10) and ours.

    Ours are upright rings, centred poles, the hold of depth, rings held along the surface, and balanced expansion: a push
    `balance` on each ring's first harmonic, an ellipse of any size, as strong as (5) draws it together. Then that ellipse
    is as good as the ring's natural shape (where w20 varies round a ring see `shape.even_out`).
    Forces are loads per hx hs, so end nodes, which own half a cell, carry half.
    """
    r = wp.tid()
    k = ring_tube[r]
    n = tube_nx[k]
    ns = tube_ns[k]
    s = ring_s[r]
    start = ring_node[r]
    per_hx = float(n)
    per_hs = float(ns - 1)
    mass = end_mass(s, ns)
    spine = spine_in[r]
    centroid = centroid_in[r]
    radius = radius_in[r]
    tangent = known_in[r] * tangent_in[r]
    weight = coupling[r]
    even = mass * (attract(weight[1], spine, centroid) + hold_depth(weight[7], depth_rest[r], eyes[0], centroid))
    # a ring must not shrink through a point
    swell = wp.max(THINNEST - radius, 0.0)
    cosine = weight[4] * harmonic_in[r, 0]
    sine = weight[4] * harmonic_in[r, 1]
    own = mass
    before = float(0.0)
    after = float(0.0)
    if ring_closed[r] != 0:
        own = 0.0
        if s == 0:
            after = mass * weight[6]
        else:
            before = mass * weight[6]
    elif s > 0 and s < ns - 1:
        if ring_closed[r - 1] != 0:
            before = 0.5 * weight[6]
        if ring_closed[r + 1] != 0:
            after = 0.5 * weight[6]
    held_ahead = tension_in[r]
    held_behind = float(0.0)
    if s > 0:
        held_behind = tension_in[r - 1]
    reach = elastic.line_reach(n, s, ns)
    rows = elastic.line_rows(s, ns, 1.0 / per_hs)
    # as `elastic.ring_force`, but each node's moment is carried on to the nodes that share it
    t2 = own * per_hx * per_hx * per_hx * per_hx
    behind = tube_in[start + n - 1]
    v = tube_in[start]
    ahead = tube_in[start + 1]
    moment0 = t2 * w20[start + n - 1] * elastic.bend(tube_in[start + n - 2], behind, v)
    moment1 = t2 * w20[start] * elastic.bend(behind, v, ahead)
    for x in range(n):
        i = start + x
        beyond = tube_in[start + elastic.wrap(x + 2, n)]
        moment2 = t2 * w20[start + elastic.wrap(x + 1, n)] * elastic.bend(v, ahead, beyond)
        south = tube_in[i - reach[0]]
        north = tube_in[i + reach[2]]
        f = even - elastic.bend(moment0, moment1, moment2)
        arm = v - spine
        long = wp.length(arm)
        out = symmetry(weight[2], radius, long)
        if weight[3] != 0.0:
            out += expansion(weight[3], long, 0.1 * radius)
        wave = node_wave[i]
        f += own * (out * arm + wave[0] * cosine + wave[1] * sine + upright(weight[5], v - centroid, tangent))
        if swell > 0.0:
            f += own * swell * unit(v - centroid)
        f += elastic.line_rigidity(tube_in, w02, i, south, v, north, reach, rows)
        if held_behind > 0.0:
            f += per_hs * (edge_hold[i - n] - held_behind * edge_in[i - n]) * (south - v)
        if held_ahead > 0.0:
            f += per_hs * (edge_hold[i] - held_ahead * edge_in[i]) * (north - v)
        if before != 0.0:
            f += before * centre_pole(v, south, gap_in[r - 1])
        if after != 0.0:
            f += after * centre_pole(v, north, gap_in[r])
        force_out[i] = f
        v = ahead
        ahead = beyond
        moment0 = moment1
        moment1 = moment2


@wp.kernel(enable_backward=False)
def spine_force(
    # model
    ring_tube: wp.array[int],
    ring_s: wp.array[int],
    tube_ns: wp.array[int],
    w1: wp.array[float],
    w2: wp.array[float],
    coupling: wp.array[Coupling],
    depth_rest: wp.array[float],
    eyes: wp.array[projection.Eye],
    # state in
    spine_in: wp.array[wp.vec3],
    natural_in: wp.array[wp.vec3],
    tension_in: wp.array[wp.vec3],
    centroid_in: wp.array[wp.vec3],
    moment_in: wp.array[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Sets the force on each spine node: (4) with natural curvature and lengths, f_a of (7), upright rings."""
    r = wp.tid()
    weight = coupling[r]
    ns = tube_ns[ring_tube[r]]
    h = 1.0 / float(ns - 1)
    f = elastic.line_force(spine_in, w1, w2, r, 1, ring_s[r], ns, h)
    f += elastic.bent_force(spine_in, natural_in, w2, r, ring_s[r], ns, h)
    f += tension_in[r] - moment_in[r]
    if ring_s[r] > 0:
        f += moment_in[r - 1] - tension_in[r - 1]
    mass = end_mass(ring_s[r], ns)
    f += mass * hold_depth(weight[7], depth_rest[r], eyes[0], spine_in[r])
    force_out[r] = f + mass * attract(weight[0], centroid_in[r], spine_in[r])
