"""The user's springs (figure 6) and volcanoes: forces on points of any object, tube, snake or sheet."""

import warp as wp

from . import image, projection


@wp.struct
class Spring:
    """One spring or volcano; lengths in its object's own units, or in pixels where the anchor is an image point."""

    eye: int  # in which the anchor is an image point; -1: the anchor is a world point
    anchor: wp.vec3
    stiffness: float  # 0: not in force
    reach: float  # above 0: a volcano; 0: a spring
    n0: int  # the spring's point: four nodes and their weights
    n1: int
    n2: int
    n3: int
    weight: wp.vec4
    density: float  # of a unit force on the point as a load per hx hs
    first: int  # nodes of its object
    last: int


@wp.func
def at_point(s: Spring, x: wp.array[wp.vec3]):
    """Value at the spring's point between its four nodes."""
    return s.weight[0] * x[s.n0] + s.weight[1] * x[s.n1] + s.weight[2] * x[s.n2] + s.weight[3] * x[s.n3]


@wp.func
def way(spring: Spring, eyes: wp.array[projection.Eye], v: wp.vec3):
    """From v to the anchor, for an image point the least way that projects to it; fourth its length [px or own units]."""
    if spring.eye < 0:
        e = spring.anchor - v
        return wp.vec4(e[0], e[1], e[2], wp.length(e))
    eye = eyes[spring.eye]
    p = projection.project(eye, v)
    d = projection.depth(eye, v)
    j0 = projection.jacobian_row(eye.row0, eye.row2, p[0], d)
    j1 = projection.jacobian_row(eye.row1, eye.row2, p[1], d)
    gap = wp.vec2(spring.anchor[0] - p[0], spring.anchor[1] - p[1])
    e = image.lift(j0, j1, gap)
    return wp.vec4(e[0], e[1], e[2], wp.length(gap))


@wp.kernel(enable_backward=False)
def spring_force(
    # model
    springs: wp.array[Spring],
    eyes: wp.array[projection.Eye],
    # state in
    node_in: wp.array[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds k (anchor - v), minus the gradient of k/2 |anchor - v|^2, at each spring's point v between four nodes."""
    s = springs[wp.tid()]
    if s.stiffness == 0.0 or s.reach > 0.0:
        return
    e = way(s, eyes, at_point(s, node_in))
    f = s.stiffness * s.density * wp.vec3(e[0], e[1], e[2])
    wp.atomic_add(force_out, s.n0, s.weight[0] * f)
    wp.atomic_add(force_out, s.n1, s.weight[1] * f)
    wp.atomic_add(force_out, s.n2, s.weight[2] * f)
    wp.atomic_add(force_out, s.n3, s.weight[3] * f)


@wp.kernel(enable_backward=False)
def volcano_force(
    # model
    springs: wp.array[Spring],
    eyes: wp.array[projection.Eye],
    mass: wp.array[float],
    # state in
    node_in: wp.array[wp.vec3],
    # out
    force_out: wp.array[wp.vec3],
):
    """Adds to each node the repulsion of its object's volcanoes, -k e / (1 + r^2/R^2)^2 with e the way to the anchor.

    Minus the gradient of k R^2 / 2 / (1 + r^2/R^2) per unit of material: as 1/r^2 far off, as the snakes' volcano, and
    even at its middle.
    """
    i = wp.tid()
    f = wp.vec3(0.0)
    for j in range(springs.shape[0]):
        s = springs[j]
        if s.reach > 0.0 and s.stiffness != 0.0 and i >= s.first and i < s.last:
            e = way(s, eyes, node_in[i])
            fall = 1.0 + (e[3] / s.reach) * (e[3] / s.reach)
            f -= s.stiffness / (fall * fall) * wp.vec3(e[0], e[1], e[2])
    force_out[i] = force_out[i] + mass[i] * f


@wp.kernel(enable_backward=False)
def give_way(
    # model
    springs: wp.array[Spring],
    inverse: wp.array2d[float],
    # state in
    velocity_in: wp.array[wp.vec3],
    # out
    back_out: wp.array[wp.vec3],
):
    """Sets what each spring, taken implicitly, takes back of a step, (1/k + B'Z)^-1 B' step (see `step_back`)."""
    i = wp.tid()
    c = wp.vec3(0.0)
    for j in range(springs.shape[0]):
        if inverse[i, j] != 0.0:
            c += inverse[i, j] * at_point(springs[j], velocity_in)
    back_out[i] = c


@wp.kernel(enable_backward=False)
def step_back(
    # model
    reply: wp.array2d[float],
    # state in
    back_in: wp.array[wp.vec3],
    # out
    node_out: wp.array[wp.vec3],
    velocity_out: wp.array[wp.vec3],
):
    """Takes Z (1/k + B'Z)^-1 B' step from positions and step: it is then the scheme's step with the springs in its matrix.

    Woodbury's formula, whatever the scheme: column j of Z is its step under a unit force at spring j, B is where they hang.
    """
    i = wp.tid()
    d = wp.vec3(0.0)
    for j in range(back_in.shape[0]):
        d += reply[j, i] * back_in[j]
    node_out[i] = node_out[i] - d
    velocity_out[i] = velocity_out[i] - d
