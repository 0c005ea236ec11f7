"""Normals, i.n of (12), and the image force on the occluding contour between the nodes."""

import warp as wp

from . import elastic, image, projection

CORNER = wp.constant(3.0)
"""How far from the corners of a cut the smoothed image tells its sides, in smoothing scales."""


@wp.struct
class Crossing:
    """A point of the contour i.n = 0 on an edge of the grid: four nodes and their weights."""

    n0: int
    n1: int
    n2: int
    n3: int
    weight: wp.vec4
    position: wp.vec3
    normal: wp.vec3


@wp.func
def unit(v: wp.vec3):
    """v / |v|, zero where v is: `wp.normalize` by one division."""
    length = wp.length(v)
    return wp.where(length > 0.0, 1.0 / length, 0.0) * v


@wp.func
def cap_normal(v: wp.array[wp.vec3], start: int, n: int, s: int):
    """n of (12) at a closed end, outward: that of the ring beside it."""
    # a pole all but lies in the plane of a flat end: the way to it from there is rounding, and says nothing
    beside = start + n
    if s > 0:
        beside = start - n
    area = wp.vec3(0.0)
    here = v[beside + n - 1] - v[start]
    for j in range(n):
        after = v[beside + j] - v[start]
        area += wp.cross(here, after)
        here = after
    if s > 0:
        return unit(area)
    return -unit(area)


@wp.kernel(enable_backward=False)
def normals(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    ring_first: wp.array[int],
    ring_last: wp.array[int],
    ring_closed: wp.array[int],
    eyes: wp.array[projection.Eye],
    # state in
    tube_in: wp.array[wp.vec3],
    centroid_in: wp.array[wp.vec3],
    # scalars
    view: int,
    # out
    normal_out: wp.array[wp.vec3],
    facing_out: wp.array[float],
):
    """Sets the unit normal n and i.n of (12) at each ring's nodes for one view."""
    r = wp.tid()
    start = ring_node[r]
    n = tube_nx[ring_tube[r]]
    s = ring_s[r]
    eye = eyes[view]
    if ring_closed[r] != 0:
        m = cap_normal(tube_in, start, n, s)
        for x in range(n):
            normal_out[start + x] = m
            facing_out[start + x] = wp.dot(projection.sight(eye, tube_in[start + x]), m)
        return
    # differences within what is in one piece
    south = n * wp.min(s - ring_first[r], 1)
    north = n * wp.min(ring_last[r] - s, 1)
    centroid = centroid_in[r]
    west = tube_in[start + n - 1]
    here = tube_in[start]
    for x in range(n):
        i = start + x
        east = tube_in[start + elastic.wrap(x + 1, n)]
        m = unit(wp.cross(east - west, tube_in[i + north] - tube_in[i - south]))
        if wp.dot(m, here - centroid) < 0.0:
            m = -m
        normal_out[i] = m
        facing_out[i] = wp.dot(projection.sight(eye, here), m)
        west = here
        here = east


@wp.func
def crossing(
    v: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    facing: wp.array[float],
    before: int,
    a: int,
    b: int,
    after: int,
):
    """The contour's point between nodes `a` and `b`: by i.n linear, its place by Catmull-Rom through four nodes.

    `before` or `after` is -1 at an open end, where the third difference is taken as zero.
    """
    t = facing[a] / (facing[a] - facing[b])
    t2 = t * t
    t3 = t2 * t
    w0 = 0.5 * (-t + 2.0 * t2 - t3)
    w1 = 0.5 * (2.0 - 5.0 * t2 + 3.0 * t3)
    w2 = 0.5 * (t + 4.0 * t2 - 3.0 * t3)
    w3 = 0.5 * (t3 - t2)
    c = Crossing()
    c.n0 = before
    c.n1 = a
    c.n2 = b
    c.n3 = after
    if before < 0:
        c.n0 = a
        w1 += 3.0 * w0
        w2 -= 3.0 * w0
        w3 += w0
        w0 = 0.0
    if after < 0:
        c.n3 = b
        w2 += 3.0 * w3
        w1 -= 3.0 * w3
        w0 += w3
        w3 = 0.0
    c.weight = wp.vec4(w0, w1, w2, w3)
    c.position = w0 * v[c.n0] + w1 * v[a] + w2 * v[b] + w3 * v[c.n3]
    c.normal = (1.0 - t) * normal[a] + t * normal[b]
    return c


@wp.func
def blind(eye: projection.Eye, a: wp.vec3, b: wp.vec3, sigma: float):
    """Whether the last stretch before a gap, from a to b, is too short for its sides to be told from the cut's corners."""
    if wp.length(projection.project(eye, a) - projection.project(eye, b)) < CORNER * sigma:
        return 1
    return 0


@wp.func
def scatter(force: wp.array[wp.vec3], c: Crossing, f: wp.vec3):
    """Adds f to the four nodes of a crossing by their weights."""
    wp.atomic_add(force, c.n0, c.weight[0] * f)
    wp.atomic_add(force, c.n1, c.weight[1] * f)
    wp.atomic_add(force, c.n2, c.weight[2] * f)
    wp.atomic_add(force, c.n3, c.weight[3] * f)


@wp.func
def pull(
    eye: projection.Eye,
    field: image.Field,
    samples: wp.array[wp.vec4],
    c: Crossing,
    p: wp.vec2,
    normal: wp.vec2,
    length: float,
    literal: int,
):
    """World force at one end of a contour segment that stands for `length` pixels of contour."""
    d = projection.depth(eye, c.position)
    j0 = projection.jacobian_row(eye.row0, eye.row2, p[0], d)
    j1 = projection.jacobian_row(eye.row1, eye.row2, p[1], d)
    value = image.sample(samples, field, p)
    weight = field.gain * length * image.pixel_size(j0, j1)
    if literal != 0:
        return weight * image.chain(j0, j1, wp.vec2(value[0], value[1]))
    return weight * image.lift(j0, j1, image.normal_pull(value, normal))


@wp.func
def segment(
    eye: projection.Eye,
    field: image.Field,
    samples: wp.array[wp.vec4],
    a: Crossing,
    b: Crossing,
    density: wp.mat33,
    literal: int,
    force: wp.array[wp.vec3],
):
    """Adds the line integral of the image force over one straight piece of contour to the nodes it hangs on."""
    p = projection.project(eye, a.position)
    q = projection.project(eye, b.position)
    e = q - p
    length = wp.length(e)
    if length < 1.0e-6:
        return
    m = 1.0 / length * wp.vec2(e[1], -e[0])
    d = projection.depth(eye, a.position)
    outward = a.normal + b.normal
    ahead = wp.vec2(
        wp.dot(projection.jacobian_row(eye.row0, eye.row2, p[0], d), outward),
        wp.dot(projection.jacobian_row(eye.row1, eye.row2, p[1], d), outward),
    )
    if wp.dot(m, ahead) < 0.0:
        m = -m
    part = image.seen(field, p, q)
    if part[0] >= part[1] or (part[0] == 0.0 and part[1] == 1.0):
        scatter(force, a, density * pull(eye, field, samples, a, p, m, 0.5 * length, literal))
        scatter(force, b, density * pull(eye, field, samples, b, q, m, 0.5 * length, literal))
    else:
        # only what the image holds of it
        half = 0.5 * (part[1] - part[0]) * length
        for i in range(2):
            t = part[i]
            f = density * pull(eye, field, samples, a, (1.0 - t) * p + t * q, m, half, literal)
            scatter(force, a, (1.0 - t) * f)
            scatter(force, b, t * f)


@wp.func
def along_edge(
    v: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    facing: wp.array[float],
    start: int,
    x: int,
    n: int,
    s: int,
    first: int,
    last: int,
    edge: int,
):
    """Crossing on one edge of the cell of node x: 0 of the ring at `start`, 2 of the ring above, 3 and 1 from x, x + 1."""
    x1 = elastic.wrap(x + 1, n)
    ring = start + wp.where(edge == 2, n, 0)
    at = start + wp.where(edge == 1, x1, x)
    flat = edge == 0 or edge == 2
    before = wp.where(flat, ring + elastic.wrap(x - 1, n), wp.where(s > first, at - n, -1))
    after = wp.where(flat, ring + elastic.wrap(x + 2, n), wp.where(s + 1 < last, at + 2 * n, -1))
    low = wp.where(flat, ring + x, at)
    high = wp.where(flat, ring + x1, at + n)
    return crossing(v, normal, facing, before, low, high, after)


@wp.func
def cell_force(
    eye: projection.Eye,
    field: image.Field,
    samples: wp.array[wp.vec4],
    tube: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    facing: wp.array[float],
    start: int,
    x: int,
    n: int,
    s: int,
    first: int,
    last: int,
    density: wp.mat33,
    literal: int,
    force: wp.array[wp.vec3],
):
    """Adds the force of the contour in the cell of node x of the ring at `start`, the next one, and the ring above."""
    i = start + x
    i10 = start + elastic.wrap(x + 1, n)
    g00 = facing[i] >= 0.0
    g10 = facing[i10] >= 0.0
    g01 = facing[i + n] >= 0.0
    g11 = facing[i10 + n] >= 0.0
    # the two edges that the contour crosses, in the order 0, 3, 2, 1
    a = int(2)
    if g00 != g10:
        a = 0
    elif g00 != g01:
        a = 3
    b = int(1)
    if a != 2 and g01 != g11:
        b = 2
    if a == 0 and g01 == g11 and g00 != g01:
        b = 3
    pieces = int(1)
    if g00 != g10 and g01 != g11 and g00 != g01:
        # a saddle: the sign at the cell's middle says which corners are cut off
        pieces = 2
        b = 3
        if (facing[i] + facing[i10] + facing[i + n] + facing[i10 + n] >= 0.0) == g00:
            b = 1
    for _piece in range(pieces):
        near = along_edge(tube, normal, facing, start, x, n, s, first, last, a)
        far = along_edge(tube, normal, facing, start, x, n, s, first, last, b)
        segment(eye, field, samples, near, far, density, literal, force)
        a = 2
        b = 4 - b


@wp.kernel(enable_backward=False)
def contour_force(
    # model
    ring_tube: wp.array[int],
    ring_node: wp.array[int],
    ring_s: wp.array[int],
    tube_nx: wp.array[int],
    tube_ns: wp.array[int],
    ring_first: wp.array[int],
    ring_last: wp.array[int],
    eyes: wp.array[projection.Eye],
    fields: wp.array[image.Field],
    samples: wp.array[wp.vec4],
    spread: wp.array[wp.mat33],
    # state in
    tube_in: wp.array[wp.vec3],
    normal_in: wp.array[wp.vec3],
    facing_in: wp.array[float],
    # scalars
    view: int,
    literal: int,
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds the image force (11) on the sub-node contour: the cells' pieces of i.n = 0, weighted by their length."""
    r = wp.tid()
    k = ring_tube[r]
    n = tube_nx[k]
    ns = tube_ns[k]
    s = ring_s[r]
    # no surface beyond the end, nor across a gap
    if s == ring_last[r]:
        return
    start = ring_node[r]
    if (s + 1 == ring_last[r + 1] and s + 1 < ns - 1) or (s == ring_first[r] and s > 0):
        if blind(eyes[view], tube_in[start], tube_in[start + n], fields[k].sigma) != 0:
            return
    first = ring_first[r + 1]
    last = ring_last[r]
    # a line load along s as a load per hx hs
    density = float(n) * float(ns - 1) * spread[r]
    eye = eyes[view]
    field = fields[k]
    low = facing_in[start] >= 0.0
    high = facing_in[start + n] >= 0.0
    for x in range(n):
        here_low = low
        here_high = high
        low = facing_in[start + elastic.wrap(x + 1, n)] >= 0.0
        high = facing_in[start + n + elastic.wrap(x + 1, n)] >= 0.0
        if here_low != low or here_low != here_high or here_low != high:
            cell_force(
                eye, field, samples, tube_in, normal_in, facing_in, start, x, n, s, first, last,
                density, literal, force_out,
            )  # fmt: skip
