"""Projection Pi of (11) and (15) by a 3 x 4 camera, its Jacobian, and the line of sight i of (12)."""

import warp as wp


@wp.struct
class Eye:
    """One view: rows of its 3 x 4 matrix and what follows from them."""

    row0: wp.vec4
    row1: wp.vec4
    row2: wp.vec4
    centre: wp.vec3  # focal point; unused where affine
    axis: wp.vec3  # unit direction of sight where affine
    affine: int


@wp.func
def project(eye: Eye, v: wp.vec3):
    """World point to (column, row)."""
    h = wp.vec4(v[0], v[1], v[2], 1.0)
    return wp.vec2(wp.dot(eye.row0, h), wp.dot(eye.row1, h)) / wp.dot(eye.row2, h)


@wp.func
def sight(eye: Eye, v: wp.vec3):
    """Unit vector i of (12), from the viewer towards v."""
    if eye.affine != 0:
        return eye.axis
    return wp.normalize(v - eye.centre)


@wp.func
def jacobian_row(row: wp.vec4, row2: wp.vec4, value: float, depth: float):
    """Derivative of one image coordinate by the world point."""
    return 1.0 / depth * (wp.vec3(row[0], row[1], row[2]) - value * wp.vec3(row2[0], row2[1], row2[2]))


@wp.func
def depth(eye: Eye, v: wp.vec3):
    """Third homogeneous coordinate."""
    return wp.dot(eye.row2, wp.vec4(v[0], v[1], v[2], 1.0))
