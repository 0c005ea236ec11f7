"""Looking a potential up and the image force of (11), as the paper writes it and normalised."""

import warp as wp


@wp.struct
class Field:
    """Where one potential lies in the flat array of samples, and how image points map to its pixels."""

    start: int
    width: int
    height: int
    x0: float  # image column of sample (0, 0)
    y0: float
    step: float  # image pixels a sample
    gain: float  # of the force at this field
    sigma: float  # it was smoothed by, image pixels
    first: wp.vec2  # first and last pixel of the image, beyond which nothing is known
    last: wp.vec2


@wp.func
def outside(field: Field, p: wp.vec2):
    """Whether the image point `p` lies on no pixel of the image."""
    lo = p - field.first
    hi = field.last - p
    if wp.min(wp.min(lo[0], lo[1]), wp.min(hi[0], hi[1])) < -0.5:
        return 1
    return 0


@wp.func
def sample(samples: wp.array[wp.vec4], field: Field, p: wp.vec2):
    """Bilinear look-up (section 5) at image point `p`: the nearest sample's value beyond the samples.

    Beyond the image nothing draws out; what has strayed beyond a border that shows background is still pressed back.
    """
    x = wp.clamp((p[0] - field.x0) / field.step, 0.0, float(field.width) - 1.001)
    y = wp.clamp((p[1] - field.y0) / field.step, 0.0, float(field.height) - 1.001)
    i = int(x)
    j = int(y)
    u = x - float(i)
    v = y - float(j)
    at = field.start + j * field.width + i
    top = (1.0 - u) * samples[at] + u * samples[at + 1]
    low = (1.0 - u) * samples[at + field.width] + u * samples[at + field.width + 1]
    value = (1.0 - v) * top + v * low
    if outside(field, p) != 0:
        return wp.vec4(0.0, 0.0, wp.min(value[2], 0.0), wp.min(value[3], 0.0))
    return value


@wp.func
def seen(field: Field, p: wp.vec2, q: wp.vec2):
    """From where to where the straight line from p to q lies in the image, in shares of it; (1, 0) where it does not."""
    low = float(0.0)
    high = float(1.0)
    lo = wp.min(p, q) - field.first
    hi = field.last - wp.max(p, q)
    if wp.min(wp.min(lo[0], lo[1]), wp.min(hi[0], hi[1])) >= 0.0:
        return wp.vec2(0.0, 1.0)
    for i in range(2):
        e = q[i] - p[i]
        if e == 0.0:
            if p[i] < field.first[i] or p[i] > field.last[i]:
                high = 0.0
                low = 1.0
        else:
            a = (field.first[i] - p[i]) / e
            b = (field.last[i] - p[i]) / e
            low = wp.max(low, wp.min(a, b))
            high = wp.min(high, wp.max(a, b))
    return wp.vec2(low, high)


@wp.func
def normal_pull(value: wp.vec4, normal: wp.vec2):
    """Normalised force [px]: the pull (value.xy) across the contour and the region's pressure (value.z), outward."""
    return (value[0] * normal[0] + value[1] * normal[1] + value[2]) * normal


@wp.func
def lift(j0: wp.vec3, j1: wp.vec3, f: wp.vec2):
    """Least world displacement whose projection is the image displacement `f`: J^T (J J^T)^-1 f."""
    a = wp.dot(j0, j0)
    b = wp.dot(j0, j1)
    c = wp.dot(j1, j1)
    det = a * c - b * b
    return 1.0 / det * ((c * f[0] - b * f[1]) * j0 + (a * f[1] - b * f[0]) * j1)


@wp.func
def pixel_size(j0: wp.vec3, j1: wp.vec3):
    """World length of an image pixel at a point, (det J J^T)^(-1/4)."""
    a = wp.dot(j0, j0)
    b = wp.dot(j0, j1)
    c = wp.dot(j1, j1)
    return 1.0 / wp.sqrt(wp.sqrt(wp.max(a * c - b * b, 1.0e-30)))


@wp.func
def chain(j0: wp.vec3, j1: wp.vec3, f: wp.vec2):
    """Gradient of (11) by the chain rule, J^T f."""
    return f[0] * j0 + f[1] * j1
