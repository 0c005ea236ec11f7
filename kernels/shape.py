"""What of the sheet's elastic force (5) most tubes do without: tensions and twist, natural lengths and curvatures."""

import warp as wp

from . import coupling as together
from . import elastic


@wp.func
def harmonic_moment(rigidity: wp.array[float], node_wave: wp.array[wp.vec2], at: int, cosine: wp.vec3, sine: wp.vec3):
    """w20 times a ring's first harmonic at a node."""
    return rigidity[at] * (node_wave[at][0] * cosine + node_wave[at][1] * sine)


@wp.kernel(enable_backward=False)
def even_out(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    ring_closed: wp.array[int],
    w20: wp.array[float],
    coupling: wp.array[together.Coupling],
    node_wave: wp.array[wp.vec2],
    # state in
    tube_in: wp.array[wp.vec3],
    harmonic_in: wp.array2d[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds balanced expansion of rings round which w20 varies, so that their first harmonic is their natural shape.

    (3) with w20 then is (1 - free) E(v) + free E(v - Pv) for P the first harmonic around, and minus half its gradient lacks
    here free (K P + P K (1 - P)) v for K of (5). With an even w20 that is the push `balance` of `coupling.tube_force`.
    """
    r = wp.tid()
    n = tube_nx[ring_tube[r]]
    start = ring_node[r]
    free = coupling[r][8]
    if ring_closed[r] != 0 or free == 0.0:
        return
    per_hx = float(n)
    lap = 2.0 * wp.sin(wp.pi / per_hx)
    lap *= lap  # a second difference of the first harmonic is -lap times it
    load = free * together.end_mass(ring_s[r], tube_ns[ring_tube[r]]) * per_hx * per_hx * per_hx * per_hx
    cosine = wp.vec3(0.0)
    sine = wp.vec3(0.0)
    for x in range(n):
        wave = node_wave[start + x]
        before = tube_in[start + elastic.wrap(x - 1, n)]
        after = tube_in[start + elastic.wrap(x + 1, n)]
        q = elastic.bend(before, tube_in[start + x], after) + lap * (
            wave[0] * harmonic_in[r, 0] + wave[1] * harmonic_in[r, 1]
        )
        cosine += w20[start + x] * wave[0] * q
        sine += w20[start + x] * wave[1] * q
    moment0 = harmonic_moment(w20, node_wave, start + n - 1, harmonic_in[r, 0], harmonic_in[r, 1])
    moment1 = harmonic_moment(w20, node_wave, start, harmonic_in[r, 0], harmonic_in[r, 1])
    for x in range(n):
        i = start + x
        moment2 = harmonic_moment(w20, node_wave, start + elastic.wrap(x + 1, n), harmonic_in[r, 0], harmonic_in[r, 1])
        f = -elastic.bend(moment0, moment1, moment2)
        f -= 2.0 / per_hx * (node_wave[i][0] * cosine + node_wave[i][1] * sine)
        force_out[i] = force_out[i] + load * lap * f
        moment0 = moment1
        moment1 = moment2


@wp.kernel(enable_backward=False)
def tense_sheet(
    # model
    node_ring: wp.array[int],
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    ring_closed: wp.array[int],
    w10: wp.array[float],
    w11: wp.array[float],
    w01: wp.array[float],
    # state in
    tube_in: wp.array[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds to minus (5) what tensions and twist, w10, w01 and w11, have in it; a closed end feels none around."""
    i = wp.tid()
    r = node_ring[i]
    n = tube_nx[ring_tube[r]]
    ns = tube_ns[ring_tube[r]]
    s = ring_s[r]
    start = ring_node[r]
    hx = 1.0 / float(n)
    hs = 1.0 / float(ns - 1)
    v = tube_in[i]
    f = elastic.twist_force(tube_in, w11, start, i - start, n, s, ns, hx, hs)
    if ring_closed[r] == 0:
        west = start + elastic.wrap(i - start - 1, n)
        pull = w10[west] * (tube_in[west] - v) + w10[i] * (tube_in[start + elastic.wrap(i - start + 1, n)] - v)
        f += wp.where(s > 0 and s < ns - 1, 1.0, 0.5) / (hx * hx) * pull
    if s > 0:
        f += w01[i - n] / (hs * hs) * (tube_in[i - n] - v)
    if s < ns - 1:
        f += w01[i] / (hs * hs) * (tube_in[i + n] - v)
    force_out[i] = force_out[i] + f


@wp.func
def add_turn(force: wp.array[wp.vec3], x0: int, x1: int, s0: int, s1: int, dx: wp.vec3, ds: wp.vec3, m: wp.vec3):
    """Adds minus the gradient of m.(dx x ds), m held, to the nodes of dx = v[x1] - v[x0] and ds = v[s1] - v[s0]."""
    fx = wp.cross(ds, m)
    fs = wp.cross(m, dx)
    wp.atomic_sub(force, x1, fx)
    wp.atomic_add(force, x0, fx)
    wp.atomic_sub(force, s1, fs)
    wp.atomic_add(force, s0, fs)


@wp.kernel(enable_backward=False)
def shape_sheet(
    # model
    node_ring: wp.array[int],
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    ring_closed: wp.array[int],
    ring_first: wp.array[int],
    ring_last: wp.array[int],
    w20: wp.array[float],
    w11: wp.array[float],
    w02: wp.array[float],
    stretch10: wp.array[wp.vec3],
    stretch01: wp.array[wp.vec3],
    curvature: wp.array[wp.vec3],
    # state in
    tube_in: wp.array[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds what natural lengths and curvatures add to minus (5) (section 3): half the gradient of their energies.

    Lengths as in `elastic.stretch`. Curvatures on the outward normal n of (12), which turns with the sheet:
    w20 |v_xx + C20 n|^2 + 2 w11 |v_xs + C11 n|^2 + w02 |v_ss + C02 n|^2, less its part without C, which is (3) itself.
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
    mass = float(1.0)
    if s == 0 or s == ns - 1:
        mass = 0.5
    west = start + (x + n - 1) % n
    east = start + (x + 1) % n
    v = tube_in[i]
    if ring_closed[r] == 0:
        f = mass * elastic.stretch(tube_in[east] - v, hx, stretch10[i])
        wp.atomic_add(force_out, i, f)
        wp.atomic_sub(force_out, east, f)
    if s < ns - 1:
        f = elastic.stretch(tube_in[i + n] - v, hs, stretch01[i])
        wp.atomic_add(force_out, i, f)
        wp.atomic_sub(force_out, i + n, f)
    natural = curvature[i]
    if ring_closed[r] == 0 and (natural[0] != 0.0 or natural[2] != 0.0):
        south = i
        north = i
        if s > ring_first[r]:
            south -= n
        if s < ring_last[r]:
            north += n
        dx = tube_in[east] - tube_in[west]
        ds = tube_in[north] - tube_in[south]
        cross = wp.cross(dx, ds)
        size = wp.max(wp.length(cross), elastic.TINY)
        normal = cross / size
        load = mass * w20[i] * natural[0] / (hx * hx)
        q = load * elastic.bend(tube_in[west], v, tube_in[east])
        wp.atomic_sub(force_out, west, load * normal)
        wp.atomic_add(force_out, i, 2.0 * load * normal)
        wp.atomic_sub(force_out, east, load * normal)
        if s > 0 and s < ns - 1:
            load = w02[i] * natural[2] / (hs * hs)
            q += load * elastic.bend(tube_in[i - n], v, tube_in[i + n])
            wp.atomic_sub(force_out, i - n, load * normal)
            wp.atomic_add(force_out, i, 2.0 * load * normal)
            wp.atomic_sub(force_out, i + n, load * normal)
        add_turn(force_out, west, east, south, north, dx, ds, (q - wp.dot(q, normal) * normal) / size)
    if s < ns - 1 and natural[1] != 0.0:
        a = tube_in[east] - v
        b = tube_in[i + n] - v
        corner = tube_in[east + n]
        dx = 0.5 * (a + corner - tube_in[i + n])
        ds = 0.5 * (b + corner - tube_in[east])
        cross = wp.cross(dx, ds)
        size = wp.max(wp.length(cross), elastic.TINY)
        normal = cross / size
        load = 2.0 * w11[i] * natural[1] / (hx * hs)
        q = load * (corner - tube_in[east] - b)
        wp.atomic_sub(force_out, east + n, load * normal)
        wp.atomic_add(force_out, east, load * normal)
        wp.atomic_add(force_out, i + n, load * normal)
        wp.atomic_sub(force_out, i, load * normal)
        m = 0.5 * (q - wp.dot(q, normal) * normal) / size
        add_turn(force_out, i, east, i, i + n, dx, ds, m)
        add_turn(force_out, i + n, east + n, east, east + n, dx, ds, m)
