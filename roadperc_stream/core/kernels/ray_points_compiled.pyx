# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Points of depth pixels in a turned and moved frame, in one pass: ``ray_points_plain`` says what they are."""


cdef void _coordinate_of_row(
    const char* depth, Py_ssize_t bytes_apart, const float* column, float row, float start, float* points,
    Py_ssize_t width,
) noexcept nogil:
    cdef Py_ssize_t u
    if bytes_apart == sizeof(float):  # said so, the compiler makes vectors of it
        for u in range(width):
            points[u] = (row + column[u]) * (<const float*>depth)[u] + start
    else:
        for u in range(width):
            points[u] = (row + column[u]) * (<const float*>(depth + u * bytes_apart))[0] + start


def points_along_rays(
    const float[:, :] depth_m, const float[:, ::1] column, const float[:, ::1] row, const float[::1] start_m,
    float[:, :, ::1] points,
):
    cdef Py_ssize_t height = depth_m.shape[0], width = depth_m.shape[1], v, k
    if (
        (column.shape[0], column.shape[1], row.shape[0], row.shape[1]) != (3, width, 3, height)
        or start_m.shape[0] != 3
        or (points.shape[0], points.shape[1], points.shape[2]) != (3, height, width)
    ):
        raise ValueError(
            f"rays of {(row.shape[0], row.shape[1])} and {(column.shape[0], column.shape[1])}, "
            f"{(points.shape[0], points.shape[1], points.shape[2])} points of {height}x{width} depths"
        )
    with nogil:
        for v in range(height if width else 0):
            for k in range(3):
                _coordinate_of_row(
                    <const char*>&depth_m[v, 0], depth_m.strides[1], &column[k, 0], row[k, v], start_m[k],
                    &points[k, v, 0], width,
                )
