"""The image force where a broken tube ends amid the object: on the rims of a gap."""

import warp as wp

from . import contour, image, projection

BLIND = wp.constant(0.2)
"""Share of its pull that a rim which sees no sides feels: smoothed, the faces of a narrow gap have no place yet."""
CYLINDER = wp.constant(0.1)
"""How firmly a rim that sees no sides keeps to the radius of the ring before."""


@wp.kernel(enable_backward=False)
def rim_force(
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
    centroid_in: wp.array[wp.vec3],
    radius_in: wp.array[float],
    # scalars
    view: int,
    literal: int,
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds the image force (11) on the rims of a gap, along the spine: what bounds the object there is the cut's face.

    The face is taken as a straight piece of contour as long as the rim looks wide, but no longer than the two sides that
    the ring stands for, so that a rim is held no more stiffly than other rings are. A push outward fades as the rims of
    both sides meet, for what lies beyond is the other side's.

    Smoothing rounds the corners of a cut. Until it is finer than the last stretch, `contour.blind`, the sides there say
    nothing: the rim then moves as one and little, and its radius is drawn to that of the ring before, which is no gradient.
    """
    r = wp.tid()
    k = ring_tube[r]
    s = ring_s[r]
    inner = int(-1)
    other = int(0)
    if ring_last[r] == s and s < tube_ns[k] - 1:
        inner = r - 1
        other = r + 1
    if ring_first[r] == s and s > 0:
        inner = r + 1
        other = r - 1
    if inner < 0:
        return
    n = tube_nx[k]
    start = ring_node[r]
    eye = eyes[view]
    field = fields[k]
    middle = projection.project(eye, centroid_in[r])
    # the body's way, not that of the rim itself, which must not lead itself aside
    ahead = projection.project(eye, centroid_in[inner]) - projection.project(eye, centroid_in[2 * inner - r])
    if wp.length(ahead) < 1.0e-9:
        return
    outward = wp.normalize(ahead)
    low = float(0.0)
    high = float(0.0)
    for x in range(n):
        across = projection.project(eye, tube_in[start + x]) - middle
        t = across[0] * outward[1] - across[1] * outward[0]
        low = wp.min(low, t)
        high = wp.max(high, t)
    spacing = wp.length(projection.project(eye, centroid_in[inner]) - middle)
    length = wp.min(high - low, 2.0 * spacing)
    room = wp.dot(projection.project(eye, centroid_in[other]) - middle, outward)
    free = wp.clamp(room / wp.max(spacing, 1.0e-6), 0.0, 1.0)
    blind = contour.blind(eye, tube_in[start], tube_in[ring_node[inner]], field.sigma)
    whole = wp.vec3(0.0)
    for x in range(n):
        v = tube_in[start + x]
        p = projection.project(eye, v)
        d = projection.depth(eye, v)
        j0 = projection.jacobian_row(eye.row0, eye.row2, p[0], d)
        j1 = projection.jacobian_row(eye.row1, eye.row2, p[1], d)
        value = image.sample(samples, field, p)
        weight = field.gain * length * image.pixel_size(j0, j1) * float(tube_ns[k] - 1)
        f = wp.vec3(0.0)
        if literal != 0:
            f = weight * image.chain(j0, j1, wp.dot(wp.vec2(value[0], value[1]), outward) * outward)
        else:
            pull_out = wp.dot(image.normal_pull(value, outward), outward)
            if pull_out > 0.0:
                pull_out *= free
            f = weight * image.lift(j0, j1, pull_out * outward)
        f = spread[r] * f
        if blind == 0:
            wp.atomic_add(force_out, start + x, f)
        whole += f / float(n)
    if blind != 0:
        for x in range(n):
            out = tube_in[start + x] - centroid_in[r]
            f = CYLINDER * (radius_in[inner] - radius_in[r]) * out / wp.max(wp.length(out), 1.0e-9)
            wp.atomic_add(force_out, start + x, BLIND * whole + f)
