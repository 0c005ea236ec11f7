"""Rays through a mesh of all surfaces as a view sees them: the second way to tell what is hidden."""

import warp as wp


@wp.kernel(enable_backward=False)
def cast(
    # model
    mesh: wp.uint64,
    # state in
    start_in: wp.array[wp.vec3],
    # scalars
    way: float,
    # out
    distance_out: wp.array[float],
    face_out: wp.array[int],
):
    """Sets how far along the depth axis, away (way 1) or nearer (way -1), a ray meets a face, and which; -1 for none."""
    i = wp.tid()
    found = wp.mesh_query_ray(mesh, start_in[i], wp.vec3(0.0, 0.0, way), 1.0e6)
    face_out[i] = -1
    if found.result:
        distance_out[i] = found.t
        face_out[i] = found.face
