"""Position updates: a ring's slow modes apart from the rest, line solves, and the step itself."""

import warp as wp

from . import banded

SMALL = wp.constant(1.0e-9)
GROWTH = wp.constant(3.0)
"""Momentum n steps after it started anew is n / (n + this), until it is as large as it may be."""


@wp.kernel(enable_backward=False)
def split_modes(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    tube_nx: wp.array[int],
    ring_closed: wp.array[int],
    node_wave: wp.array[wp.vec2],
    first_mode: wp.array[float],
    step: wp.array2d[float],
    # state in
    tube_in: wp.array[wp.vec3],
    centroid_in: wp.array[wp.vec3],
    radius_in: wp.array[float],
    force_in: wp.array[wp.vec3],
    spine_force_in: wp.array[wp.vec3],
    velocity_in: wp.array[wp.vec3],
    # scalars
    rings: int,
    # out
    delta_out: wp.array[wp.vec3],
    low_out: wp.array[wp.vec3],
    residual_out: wp.array[float],
    power_out: wp.array[float],
):
    """Sets dt R, parted into the ring's modes k = 0, +-1 (with a longer step) and the rest; squared residual and power.

    `low_out` holds four lines of `rings` entries: mean, cosine, sine, spine. `first_mode` is the ring's stiffness in
    mode 1. A closed end has its mean alone. Power is that of the force along the step before, by which momentum is judged.
    """
    r = wp.tid()
    k = ring_tube[r]
    n = tube_nx[k]
    start = ring_node[r]
    dt = step[k, 0]
    slow = step[k, 1]
    centroid = centroid_in[r]
    mean = wp.vec3(0.0)
    cosine = wp.vec3(0.0)
    sine = wp.vec3(0.0)
    radial = float(0.0)
    power = float(0.0)
    for x in range(n):
        f = force_in[start + x]
        wave = node_wave[start + x]
        mean += f
        power += wp.dot(f, velocity_in[start + x])
        cosine += wave[0] * f
        sine += wave[1] * f
        radial += wp.dot(f, tube_in[start + x] - centroid)
    mean /= float(n)
    power_out[r] = power / float(n)
    low_out[3 * rings + r] = step[k, 2] * spine_force_in[r]
    if ring_closed[r] != 0:
        residual_out[r] = wp.dot(mean, mean)
        low_out[r] = slow * mean
        low_out[rings + r] = wp.vec3(0.0)
        low_out[2 * rings + r] = wp.vec3(0.0)
        for x in range(n):
            delta_out[start + x] = wp.vec3(0.0)
        return
    # the other modes relax within a few steps, down to the rounding of float32
    radial /= float(n) * wp.max(radius_in[r], SMALL)
    residual_out[r] = wp.dot(mean, mean) + radial * radial
    cosine *= 2.0 / float(n)
    sine *= 2.0 / float(n)
    first = slow / (1.0 + slow * first_mode[r])
    low_out[r] = slow * mean
    low_out[rings + r] = first * cosine
    low_out[2 * rings + r] = first * sine
    for x in range(n):
        wave = node_wave[start + x]
        rest = force_in[start + x] - mean - wave[0] * cosine - wave[1] * sine
        delta_out[start + x] = dt * rest


@wp.kernel(enable_backward=False)
def sweep_rings(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    tube_nx: wp.array[int],
    ring_closed: wp.array[int],
    factor: wp.array[wp.vec3],
    border: wp.array[wp.vec2],
    corner: wp.array[wp.vec3],
    # out
    delta_out: wp.array[wp.vec3],
):
    """Solves (1 + dt Kx) D = rhs in place on every ring (first sweep of the ADI step, section 5)."""
    r = wp.tid()
    if ring_closed[r] != 0:
        return
    n = tube_nx[ring_tube[r]]
    banded.solve_cyclic(factor, border, corner[r], delta_out, ring_node[r], n)


@wp.kernel(enable_backward=False)
def sweep_meridians(
    # model
    line_tube: wp.array[int],
    line_x: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    tube_node: wp.array[int],
    tube_ring: wp.array[int],
    factor: wp.array[wp.vec3],
    low_factor: wp.array[wp.vec3],
    # scalars
    rings: int,
    # out
    delta_out: wp.array[wp.vec3],
    low_out: wp.array[wp.vec3],
):
    """Solves (1 + dt Ks) D = rhs in place on every meridian and on the lines of slow modes and spine (second sweep)."""
    i = wp.tid()
    k = line_tube[i]
    x = line_x[i]
    ns = tube_ns[k]
    if x >= 0:
        banded.solve_open(factor, delta_out, tube_node[k] + x, tube_nx[k], ns)
    else:
        at = tube_ring[k] - (x + 1) * rings
        banded.solve_open(low_factor, low_out, at, 1, ns)


@wp.kernel(enable_backward=False)
def scale_nodes(
    # model
    inverse: wp.array[float],
    # out
    delta_out: wp.array[wp.vec3],
):
    """Multiplies each entry by its inverse diagonal (implicit Jacobi)."""
    i = wp.tid()
    delta_out[i] = inverse[i] * delta_out[i]


@wp.kernel(enable_backward=False)
def gather_momentum(
    # model
    tube_ring: wp.array[int],
    tube_ns: wp.array[int],
    # state in
    power_in: wp.array[float],
    # scalars
    most: float,
    # out
    age_out: wp.array[float],
    momentum_out: wp.array[float],
):
    """Sets each tube's momentum: it grows to `most`, and starts anew when the last step goes on against the force.

    Soft modes then gather speed and stiff ones do not swing (O'Donoghue and Candes, adaptive restart).
    """
    k = wp.tid()
    power = float(0.0)
    for s in range(tube_ns[k]):
        power += power_in[tube_ring[k] + s]
    age = age_out[k] + 1.0
    if power < 0.0:
        age = 0.0
    age_out[k] = age
    momentum_out[k] = wp.min(age / (age + GROWTH), most)


@wp.kernel(enable_backward=False)
def advance(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    tube_nx: wp.array[int],
    node_wave: wp.array[wp.vec2],
    # state in
    delta_in: wp.array[wp.vec3],
    low_in: wp.array[wp.vec3],
    momentum_in: wp.array[float],
    # scalars
    rings: int,
    # out
    tube_out: wp.array[wp.vec3],
    spine_out: wp.array[wp.vec3],
    velocity_out: wp.array[wp.vec3],
    spine_velocity_out: wp.array[wp.vec3],
):
    """Adds the step and the tube's momentum times the one before to tube and spine."""
    r = wp.tid()
    k = ring_tube[r]
    start = ring_node[r]
    momentum = momentum_in[k]
    mean = low_in[r]
    cosine = low_in[rings + r]
    sine = low_in[2 * rings + r]
    for i in range(start, start + tube_nx[k]):
        wave = node_wave[i]
        d = delta_in[i] + mean + wave[0] * cosine + wave[1] * sine + momentum * velocity_out[i]
        velocity_out[i] = d
        tube_out[i] = tube_out[i] + d
    e = low_in[3 * rings + r] + momentum * spine_velocity_out[r]
    spine_velocity_out[r] = e
    spine_out[r] = spine_out[r] + e


@wp.kernel(enable_backward=False)
def join_modes(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    tube_ring: wp.array[int],
    ring_closed: wp.array[int],
    mu: wp.array[float],
    gamma: wp.array[float],
    spine_mu: wp.array[float],
    spine_gamma: wp.array[float],
    step: wp.array2d[float],
    # state in
    force_in: wp.array[wp.vec3],
    spine_force_in: wp.array[wp.vec3],
    velocity_in: wp.array[wp.vec3],
    spine_velocity_in: wp.array[wp.vec3],
    # scalars
    rings: int,
    means_apart: int,
    h: float,
    # out
    delta_out: wp.array[wp.vec3],
    low_out: wp.array[wp.vec3],
    residual_out: wp.array[float],
):
    """Sets the right side of a step in which all modes of a ring go alike: dt R, or with mass 4 dt (R - gamma M u).

    A step h above 0 says that there is mass. A closed end, one node, has the first entry of `low_out` for it; the other
    rings of a closed tube have theirs for their means if `means_apart`. With mass, adds the square of the force that
    would stop the ring in one step to the residual, which else would vanish at speed.
    """
    r = wp.tid()
    k = ring_tube[r]
    n = tube_nx[k]
    start = ring_node[r]
    share = float(1.0)
    if ring_s[r] == 0 or ring_s[r] == tube_ns[k] - 1:
        share = 0.5
    scale = step[k, 0]
    spine_scale = step[k, 2]
    if h > 0.0:
        scale *= 4.0
        spine_scale *= 4.0
    mean = wp.vec3(0.0)
    push = wp.vec3(0.0)
    for x in range(n):
        i = start + x
        f = force_in[i]
        if h > 0.0:
            f -= gamma[i] * share * velocity_in[i]
            push += mu[i] / h * share * velocity_in[i]
        delta_out[i] = scale * f
        mean += f
    mean /= float(n)
    push /= float(n)
    residual_out[r] = residual_out[r] + wp.dot(push, push)
    low_out[r] = wp.vec3(0.0)
    low_out[rings + r] = wp.vec3(0.0)
    low_out[2 * rings + r] = wp.vec3(0.0)
    if ring_closed[r] != 0:
        low_out[r] = scale * mean
        for x in range(n):
            delta_out[start + x] = wp.vec3(0.0)
    elif means_apart != 0 and ring_closed[tube_ring[k]] != 0:
        low_out[r] = scale * mean
        for x in range(n):
            delta_out[start + x] = delta_out[start + x] - scale * mean
    g = spine_force_in[r]
    if h > 0.0:
        g -= spine_gamma[r] * share * spine_velocity_in[r]
    low_out[3 * rings + r] = spine_scale * g


@wp.kernel(enable_backward=False)
def advance_mass(
    # model
    node_ring: wp.array[int],
    ring_node: wp.array[int],
    # state in
    delta_in: wp.array[wp.vec3],
    low_in: wp.array[wp.vec3],
    # scalars
    rings: int,
    h: float,
    # out
    tube_out: wp.array[wp.vec3],
    spine_out: wp.array[wp.vec3],
    velocity_out: wp.array[wp.vec3],
    spine_velocity_out: wp.array[wp.vec3],
):
    """Adds the change of the step, D' - D, to the velocity D / h of tube and spine; moves them by D' ((10) with mass)."""
    i = wp.tid()
    r = node_ring[i]
    u = velocity_out[i] + (delta_in[i] + low_in[r]) / h
    velocity_out[i] = u
    tube_out[i] = tube_out[i] + h * u
    if i == ring_node[r]:
        e = spine_velocity_out[r] + low_in[3 * rings + r] / h
        spine_velocity_out[r] = e
        spine_out[r] = spine_out[r] + h * e


@wp.kernel(enable_backward=False)
def relax_color(
    # model
    order: wp.array[int],
    row: wp.array[int],
    column: wp.array[int],
    entry: wp.array[float],
    inverse: wp.array[float],
    # state in
    rhs_in: wp.array[wp.vec3],
    # scalars
    first: int,
    omega: float,
    # out
    x_out: wp.array[wp.vec3],
):
    """Over-relaxes the unknowns of one colour, which do not meet in the matrix (section 5: an analogue of SOR)."""
    i = order[first + wp.tid()]
    left = rhs_in[i]
    for j in range(row[i], row[i + 1]):
        left -= entry[j] * x_out[column[j]]
    x_out[i] = x_out[i] + omega * inverse[i] * left
