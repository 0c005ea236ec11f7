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
    density: float  # of a unit load on the point as a load per hx hs
    first: int  # nodes of its object
    last: int


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
    v = s.weight[0] * node_in[s.n0] + s.weight[1] * node_in[s.n1] + s.weight[2] * node_in[s.n2] + s.weight[3] * node_in[s.n3]
    e = way(s, eyes, v)
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
