"""Pentadiagonal lines, open and cyclic: the forward-reverse resolution of section 5 with factors made by the host.

Factors are those of L D L^T (the paper's normalised Cholesky step), three to an unknown: the two entries of L left of its
diagonal, and 1 / D.
"""

import warp as wp


@wp.func
def solve_open(factor: wp.array[wp.vec3], x: wp.array[wp.vec3], start: int, stride: int, n: int):
    """Solves an open line in place; factors and unknowns share `start` and `stride`."""
    p = wp.vec3(0.0)
    q = wp.vec3(0.0)
    for i in range(n):
        at = start + i * stride
        f = factor[at]
        y = x[at] - f[1] * q - f[0] * p
        x[at] = y
        q = p
        p = y
    p = wp.vec3(0.0)
    q = wp.vec3(0.0)
    l1 = float(0.0)
    l2 = float(0.0)
    l2_next = float(0.0)
    for k in range(n):
        at = start + (n - 1 - k) * stride
        f = factor[at]
        y = x[at] * f[2] - l2 * q - l1 * p
        x[at] = y
        q = p
        p = y
        l1 = f[0]
        l2 = l2_next
        l2_next = f[1]


@wp.func
def solve_cyclic(
    factor: wp.array[wp.vec3],
    border: wp.array[wp.vec2],
    corner: wp.vec3,
    x: wp.array[wp.vec3],
    start: int,
    n: int,
):
    """Solves a cyclic line in place by bordering: the first n - 2 unknowns open, the last two by their Schur complement.

    `border` holds B^-1 C by rows, B being the open part and C what couples it to the last two unknowns, and `corner` the
    symmetric inverse (00, 01, 11) of the Schur complement. Its right side C' B^-1 r is border' r.
    """
    m = n - 2
    u = x[start + m]
    v = x[start + m + 1]
    p = wp.vec3(0.0)
    q = wp.vec3(0.0)
    for i in range(m):
        f = factor[start + i]
        w = border[start + i]
        y = x[start + i]
        u -= w[0] * y
        v -= w[1] * y
        y = y - f[1] * q - f[0] * p
        x[start + i] = y
        q = p
        p = y
    a = corner[0] * u + corner[1] * v
    b = corner[1] * u + corner[2] * v
    x[start + m] = a
    x[start + m + 1] = b
    p = wp.vec3(0.0)
    q = wp.vec3(0.0)
    l1 = float(0.0)
    l2 = float(0.0)
    l2_next = float(0.0)
    for k in range(m):
        i = start + m - 1 - k
        f = factor[i]
        w = border[i]
        y = x[i] * f[2] - l2 * q - l1 * p
        x[i] = y - w[0] * a - w[1] * b
        q = p
        p = y
        l1 = f[0]
        l2 = l2_next
        l2_next = f[1]
