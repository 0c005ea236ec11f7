"""Elastic forces (4), (5) on lines of nodes, open or periodic, with the natural boundary rows of the energies (2), (3)."""

import warp as wp

CLOSEST = wp.constant(0.1)
"""Least length of an edge of the spine, over the mean one."""


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
    f = wp.vec3(0.0)
    p = v[at]
    t1 = 1.0 / (h * h)
    t2 = t1 * t1
    if i > 0:
        f += tension[at - stride] * t1 * (v[at - stride] - p)
    if i < n - 1:
        f += tension[at] * t1 * (v[at + stride] - p)
    if i > 1:
        f -= rigidity[at - stride] * t2 * bend(v[at - 2 * stride], v[at - stride], p)
    if i > 0 and i < n - 1:
        f += 2.0 * rigidity[at] * t2 * bend(v[at - stride], p, v[at + stride])
    if i < n - 2:
        f -= rigidity[at + stride] * t2 * bend(p, v[at + stride], v[at + 2 * stride])
    return f


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
    return weight[start + x] * (v[start + n + y] - v[start + n + x] - v[start + y] + v[start + x])


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


@wp.kernel(enable_backward=False)
def relax_spine(
    # model
    tube_ring: wp.array[int],
    tube_ns: wp.array[int],
    basis: wp.array2d[float],
    k1: wp.array[float],
    # state in
    spine_in: wp.array[wp.vec3],
    tangent_in: wp.array[wp.vec3],
    # out
    natural_out: wp.array[wp.vec3],
    tension_out: wp.array[wp.vec3],
):
    """Sets the spine's natural second difference and the push of its least lengths L1 (section 3) in each edge.

    The natural bend is the part of its own that a low polynomial in s describes: a spine then resists wriggles, not an
    even bend, so rigidity does not pull a banana straight. `basis` holds orthonormal polynomials on the interior nodes,
    0 at the ends. Edges may shorten freely, as they do under a flat end, but a node never passes the next one.
    """
    k = wp.tid()
    start = tube_ring[k]
    n = tube_ns[k]
    for i in range(n):
        natural_out[start + i] = wp.vec3(0.0)
    for j in range(basis.shape[1]):
        p = wp.vec3(0.0)
        for i in range(1, n - 1):
            p += basis[start + i, j] * bend(spine_in[start + i - 1], spine_in[start + i], spine_in[start + i + 1])
        for i in range(1, n - 1):
            natural_out[start + i] = natural_out[start + i] + basis[start + i, j] * p
    whole = float(0.0)
    for i in range(n - 1):
        whole += wp.length(spine_in[start + i + 1] - spine_in[start + i])
    least = CLOSEST * whole / float(n - 1)
    scale = k1[k] * float((n - 1) * (n - 1))
    for i in range(n - 1):
        along = wp.normalize(tangent_in[start + i] + tangent_in[start + i + 1])
        short = wp.dot(spine_in[start + i + 1] - spine_in[start + i], along) - least
        tension_out[start + i] = scale * wp.min(short, 0.0) * along
    tension_out[start + n - 1] = wp.vec3(0.0)
