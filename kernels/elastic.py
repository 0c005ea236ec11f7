"""Elastic forces (4), (5) on lines of nodes, open or periodic, with the natural boundary rows of the energies (2), (3)."""

import warp as wp

CLOSEST = wp.constant(0.1)
"""Least length of an edge of the spine, over the mean one."""
NUDGE = wp.constant(0.01)
"""Mean bend, in natural ones, below which a spine bends to the meridian x = 0 and not the way it does already."""
TINY = wp.constant(1.0e-12)


@wp.func
def bend(p: wp.vec3, q: wp.vec3, r: wp.vec3):
    """Second difference p - 2 q + r."""
    return p - 2.0 * q + r


@wp.func
def wrap(x: int, n: int):
    """x modulo n for x from -n to 2 n - 1, without a division."""
    if x < 0:
        return x + n
    if x >= n:
        return x - n
    return x


@wp.func
def line_reach(stride: int, i: int, n: int):
    """From node `i` of an open line back to the first and second node before it, ahead to those after; 0 beyond an end."""
    return wp.vec4i(
        stride * wp.min(i, 1), stride * wp.min(i, 2), stride * wp.min(n - 1 - i, 1), stride * wp.min(n - 1 - i, 2)
    )


@wp.func
def line_rows(i: int, n: int, h: float):
    """h^-4 for each of the three second differences that node `i` of an open line takes part in, 0 where there is none."""
    t = 1.0 / (h * h * h * h)
    return wp.vec3(wp.where(i > 1, t, 0.0), wp.where(i > 0 and i < n - 1, t, 0.0), wp.where(i < n - 2, t, 0.0))


@wp.func
def line_rigidity(
    v: wp.array[wp.vec3],
    rigidity: wp.array[float],
    at: int,
    before: wp.vec3,
    here: wp.vec3,
    after: wp.vec3,
    reach: wp.vec4i,
    rows: wp.vec3,
):
    """Rigidity's part of `line_force`, by `line_reach` and `line_rows` of the node."""
    f = 2.0 * rows[1] * rigidity[at] * bend(before, here, after)
    f -= rows[0] * rigidity[at - reach[0]] * bend(v[at - reach[1]], before, here)
    f -= rows[2] * rigidity[at + reach[2]] * bend(here, after, v[at + reach[3]])
    return f


@wp.func
def line_force(
    v: wp.array[wp.vec3],
    tension: wp.array[float],
    rigidity: wp.array[float],
    at: int,
    stride: int,
    i: int,
    n: int,
    h: float,
):
    """Minus (4) at node `i` of an open line of `n` nodes, per h; `at` is its index in `v`.

    `tension[k]` belongs to the edge from k to its successor, `rigidity[k]` to node k.
    """
    reach = line_reach(stride, i, n)
    before = v[at - reach[0]]
    after = v[at + reach[2]]
    f = (tension[at - reach[0]] * (before - v[at]) + tension[at] * (after - v[at])) / (h * h)
    return f + line_rigidity(v, rigidity, at, before, v[at], after, reach, line_rows(i, n, h))


@wp.func
def ring_force(
    v: wp.array[wp.vec3],
    tension: wp.array[float],
    rigidity: wp.array[float],
    start: int,
    x: int,
    n: int,
    h: float,
):
    """Minus the x part of (5) at node `x` of a periodic line (6) of `n` nodes that begins at `start`."""
    x1 = start + wrap(x - 1, n)
    x2 = start + wrap(x - 2, n)
    y1 = start + wrap(x + 1, n)
    y2 = start + wrap(x + 2, n)
    at = start + x
    t1 = 1.0 / (h * h)
    t2 = t1 * t1
    f = t1 * (tension[x1] * (v[x1] - v[at]) + tension[at] * (v[y1] - v[at]))
    f -= t2 * rigidity[x1] * bend(v[x2], v[x1], v[at])
    f += t2 * 2.0 * rigidity[at] * bend(v[x1], v[at], v[y1])
    f -= t2 * rigidity[y1] * bend(v[at], v[y1], v[y2])
    return f


@wp.func
def cell_twist(v: wp.array[wp.vec3], weight: wp.array[float], start: int, x: int, n: int):
    """Mixed difference w11 (v11 - v10 - v01 + v00) of the cell whose first corner is node x of the ring at start."""
    if weight[start + x] == 0.0:
        return wp.vec3(0.0)
    y = wrap(x + 1, n)
    return weight[start + x] * ((v[start + n + y] - v[start + n + x]) - (v[start + y] - v[start + x]))


@wp.func
def twist_force(
    v: wp.array[wp.vec3],
    weight: wp.array[float],
    start: int,
    x: int,
    n: int,
    s: int,
    ns: int,
    hx: float,
    hs: float,
):
    """Minus the mixed part of (5), from the four cells round a node."""
    w = wrap(x - 1, n)
    f = wp.vec3(0.0)
    if s < ns - 1:
        f += cell_twist(v, weight, start, w, n) - cell_twist(v, weight, start, x, n)
    if s > 0:
        f += cell_twist(v, weight, start - n, x, n) - cell_twist(v, weight, start - n, w, n)
    return 2.0 / (hx * hx * hs * hs) * f


@wp.func
def bent_force(
    v: wp.array[wp.vec3],
    natural: wp.array[wp.vec3],
    rigidity: wp.array[float],
    at: int,
    i: int,
    n: int,
    h: float,
):
    """What a natural second difference `natural` adds to `line_force`: plus D2' w2 natural, h^-4."""
    f = wp.vec3(0.0)
    if i > 1:
        f += rigidity[at - 1] * natural[at - 1]
    if i > 0 and i < n - 1:
        f -= 2.0 * rigidity[at] * natural[at]
    if i < n - 2:
        f += rigidity[at + 1] * natural[at + 1]
    return f / (h * h * h * h)


@wp.func
def stretch(e: wp.vec3, h: float, shape: wp.vec3):
    """Pull of an edge `e` with natural length, w e / h^2 of (4), (5) with the paper's w = K (|e| / h - L), L = shape[1].

    Half the gradient of K (g - L)^2 (2 g + L) / 3 for g = |e| / h, an energy that is never negative. Beyond
    g - L = shape[2] w stays as it is there, so that its steepest slope is K (L + 2 shape[2]), which the matrices know.
    """
    return shape[0] * wp.min(wp.length(e) / h - shape[1], shape[2]) / (h * h) * e


@wp.kernel(enable_backward=False)
def relax_spine(
    # model
    tube_ring: wp.array[int],
    tube_ns: wp.array[int],
    ring_node: wp.array[int],
    spine_first: wp.array[int],
    spine_last: wp.array[int],
    basis: wp.array2d[float],
    k1: wp.array[float],
    w2: wp.array[float],
    spine_stretch: wp.array[wp.vec2],
    spine_curvature: wp.array[wp.vec2],
    # state in
    tube_in: wp.array[wp.vec3],
    spine_in: wp.array[wp.vec3],
    tangent_in: wp.array[wp.vec3],
    # out
    natural_out: wp.array[wp.vec3],
    tension_out: wp.array[wp.vec3],
):
    """Sets the spine's natural second difference, and the pull in each edge of its natural lengths L1 and its least ones.

    The natural bend is the part of its own that a low polynomial in s describes, in each piece between discontinuities: a
    spine then resists wriggles, not an even bend, so rigidity does not pull a banana straight. `basis` holds orthonormal
    polynomials on the interior nodes, 0 at the ends. Edges may shorten freely, as they do under a flat end, but a node
    never passes the next one.

    Where a curvature C2 is given the energy is the sum of w2 (|q|^2 - 2 C2 p.(t x q) + C2^2) over a piece, which is
    w2 |q - C2 p x t|^2 in a plane: q the second derivative, t the unit tangent along both edges, p the normal of the plane
    that suits the piece best, p ~ sum of w2 C2 (t x q). So plane and side of the bend are free, but all of a piece shares
    them; a straight one turns to the meridian x = 0. The force is half that energy's gradient (p, being the best, adds
    nothing to it) but for the nudge aside.
    """
    k = wp.tid()
    start = tube_ring[k]
    n = tube_ns[k]
    for i in range(n):
        natural_out[start + i] = wp.vec3(0.0)
    first = int(0)
    whole = float(0.0)
    edges = float(0.0)
    while first < n - 1:
        last = spine_last[start + first]
        for j in range(basis.shape[1]):
            p = wp.vec3(0.0)
            for i in range(first + 1, last):
                p += basis[start + i, j] * bend(spine_in[start + i - 1], spine_in[start + i], spine_in[start + i + 1])
            for i in range(first + 1, last):
                natural_out[start + i] = natural_out[start + i] + basis[start + i, j] * p
        for i in range(first, last):
            whole += wp.length(spine_in[start + i + 1] - spine_in[start + i])
            edges += 1.0
        first = last
        if last < n - 1:
            # the next piece begins at a crease's own ring, or beyond a gap
            first = spine_first[start + last + 1]
    least = CLOSEST * whole / edges
    for i in range(n - 1):
        scale = k1[start + i] * float((n - 1) * (n - 1))
        e = spine_in[start + i + 1] - spine_in[start + i]
        along = wp.normalize(tangent_in[start + i] + tangent_in[start + i + 1])
        short = wp.dot(e, along) - least
        tension_out[start + i] = scale * wp.min(short, 0.0) * along
    tension_out[start + n - 1] = wp.vec3(0.0)
    h = 1.0 / float(n - 1)
    for i in range(n - 1):
        length = spine_stretch[start + i]
        if length[0] >= 0.0:
            e = spine_in[start + i + 1] - spine_in[start + i]
            tension_out[start + i] = tension_out[start + i] + stretch(e, h, wp.vec3(k1[start + i], length[0], length[1]))
    begin = int(0)
    while begin < n - 1:
        last = spine_last[start + begin]
        plane = wp.vec3(0.0)
        for i in range(begin + 1, last):
            at = start + i
            weight = w2[at] * spine_curvature[at][1]
            t = wp.normalize(spine_in[at + 1] - spine_in[at - 1])
            side = tube_in[ring_node[at]] - spine_in[at]
            nudge = NUDGE * h * h * spine_curvature[at][1] * wp.normalize(side - wp.dot(side, t) * t)
            plane += weight * wp.cross(t, bend(spine_in[at - 1], spine_in[at], spine_in[at + 1]) + nudge)
        plane = wp.normalize(plane)
        for i in range(begin + 1, last):
            at = start + i
            if spine_curvature[at][0] > 0.0:
                c = spine_in[at + 1] - spine_in[at - 1]
                t = wp.normalize(c)
                size = spine_curvature[at][1] * h * h
                natural_out[at] = size * wp.cross(plane, t)
                # t turns with its edges
                m = wp.cross(bend(spine_in[at - 1], spine_in[at], spine_in[at + 1]), plane)
                m *= w2[at] * size / (h * h * h * h * wp.max(wp.length(c), TINY))
                turn = m - wp.dot(m, t) * t
                tension_out[at - 1] = tension_out[at - 1] - turn
                tension_out[at] = tension_out[at] - turn
        begin = last
        if last < n - 1:
            begin = spine_first[start + last + 1]
