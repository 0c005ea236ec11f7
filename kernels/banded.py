"""Pentadiagonal lines, open and cyclic: the forward-reverse resolution of section 5 with factors made by the host.

Factors are those of L D L^T (the paper's normalised Cholesky step): `lower1` and `lower2` below the diagonal of L,
`inverse` = 1 / D.
"""

import warp as wp


@wp.func
def solve_open(
    lower1: wp.array[float],
    lower2: wp.array[float],
    inverse: wp.array[float],
    x: wp.array[wp.vec3],
    start: int,
    stride: int,
    n: int,
):
    """Solves an open line in place; factors and unknowns share `start` and `stride`."""
    p = wp.vec3(0.0)
    q = wp.vec3(0.0)
    for i in range(n):
        at = start + i * stride
        y = x[at] - lower1[at] * p - lower2[at] * q
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
        y = x[at] * inverse[at] - l1 * p - l2 * q
        x[at] = y
        q = p
        p = y
        l1 = lower1[at]
        l2 = l2_next
        l2_next = lower2[at]


@wp.func
def solve_cyclic(
    lower1: wp.array[float],
    lower2: wp.array[float],
    inverse: wp.array[float],
    border: wp.array[wp.vec2],
    corner: wp.array[wp.vec3],
    edge: wp.array2d[float],
    ring: int,
    x: wp.array[wp.vec3],
    start: int,
    n: int,
):
    """Solves a cyclic line in place by bordering: the first n - 2 unknowns open, the last two by their Schur complement.

    `border` holds B^-1 C by rows, `corner` the symmetric inverse (00, 01, 11) of the Schur complement and `edge` the
    entries of C in rows 0, 0, 1, n - 4, n - 3, n - 3.
    """
    m = n - 2
    u = x[start + m]
    v = x[start + m + 1]
    solve_open(lower1, lower2, inverse, x, start, 1, m)
    u -= edge[ring, 0] * x[start] + edge[ring, 3] * x[start + m - 2] + edge[ring, 4] * x[start + m - 1]
    v -= edge[ring, 1] * x[start] + edge[ring, 2] * x[start + 1] + edge[ring, 5] * x[start + m - 1]
    c = corner[ring]
    a = c[0] * u + c[1] * v
    b = c[1] * u + c[2] * v
    for i in range(m):
        w = border[start + i]
        x[start + i] = x[start + i] - w[0] * a - w[1] * b
    x[start + m] = a
    x[start + m + 1] = b
