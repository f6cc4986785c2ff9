# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""How far points project from where they were found, and how that changes: ``reprojection_plain`` says what is what."""

from libc.math cimport sqrt
from libc.stdint cimport uint8_t

from roadperc_stream.core.kernels.reprojection_plain import require_belonging

cdef double NEAREST_M = 0.1

cdef struct Rules:
    double fx, fy, cx, cy
    double pixel_variance, depth_std_per_m, full, gate


cdef uint8_t _rows(
    const Rules* rules, const double* point, const double* px, const double* T, double* residual, double* J
) noexcept nogil:
    """The two rows of a point, and whether it agrees."""
    cdef double X = point[0], Y = point[1], Z = point[2]
    cdef double x = T[0] * X + T[1] * Y + T[2] * Z + T[3]
    cdef double y = T[4] * X + T[5] * Y + T[6] * Z + T[7]
    cdef double z = T[8] * X + T[9] * Y + T[10] * Z + T[11]
    cdef double ray_x = T[0] * (X / Z) + T[1] * (Y / Z) + T[2]
    cdef double ray_y = T[4] * (X / Z) + T[5] * (Y / Z) + T[6]
    cdef double ray_z = T[8] * (X / Z) + T[9] * (Y / Z) + T[10]
    cdef double a = rules.fx / z, b = -rules.fx * x / (z * z), c = rules.fy / z, d = -rules.fy * y / (z * z)
    cdef double off_u = px[0] - (rules.fx * x / z + rules.cx), off_v = px[1] - (rules.fy * y / z + rules.cy)
    cdef double along_u = a * ray_x + b * ray_z, along_v = c * ray_y + d * ray_z
    cdef double depth_std_m = rules.depth_std_per_m * (Z * Z)
    cdef double variance, off, weight
    cdef int k
    variance = rules.pixel_variance + (along_u * along_u + along_v * along_v) * (depth_std_m * depth_std_m)
    off = sqrt((off_u * off_u + off_v * off_v) / variance)
    if not (z > NEAREST_M and off < rules.gate):
        for k in range(2):
            residual[k] = 0
        for k in range(12):
            J[k] = 0
        return False
    weight = sqrt((rules.full / off if off > rules.full else 1.0) / variance)
    residual[0] = weight * off_u
    residual[1] = weight * off_v
    J[0] = weight * a
    J[1] = weight * 0.0
    J[2] = weight * b
    J[3] = weight * (b * y)
    J[4] = weight * (a * z - b * x)
    J[5] = weight * (-a * y)
    J[6] = weight * 0.0
    J[7] = weight * c
    J[8] = weight * d
    J[9] = weight * (d * y - c * z)
    J[10] = weight * (-d * x)
    J[11] = weight * (c * x)
    return True


def linearise(
    projection,
    weighting,
    const double[:, ::1] points_m,
    const double[:, ::1] px,
    const double[:, ::1] this_T_key,
    double[::1] residual,
    double[:, ::1] derivative,
    uint8_t[::1] agrees,
):
    cdef Py_ssize_t count = agrees.shape[0], i
    cdef Rules rules
    require_belonging(
        (points_m.shape[0], points_m.shape[1]),
        (px.shape[0], px.shape[1]),
        (this_T_key.shape[0], this_T_key.shape[1]),
        (residual.shape[0],),
        (derivative.shape[0], derivative.shape[1]),
        (count,),
    )
    rules.fx, rules.fy, rules.cx, rules.cy = projection
    rules.pixel_variance = weighting.std_px**2
    rules.depth_std_per_m, rules.full, rules.gate = weighting[1:]
    with nogil:
        for i in range(count):
            agrees[i] = _rows(
                &rules, &points_m[i, 0], &px[i, 0], &this_T_key[0, 0], &residual[2 * i], &derivative[2 * i, 0]
            )
