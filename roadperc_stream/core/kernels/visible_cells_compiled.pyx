# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Cells of a grid on the road that an image shows to be drivable, one by one: ``visible_cells_plain`` says which."""

from libc.math cimport fabs, rint
from libc.stdint cimport uint8_t

from roadperc_stream.core.kernels.visible_cells_plain import require_belonging

cdef enum:
    MOST = 5  # of nine

cdef double NEAREST_M = 1e-6


cdef inline bint _is_mostly(const uint8_t[:, :] drivable, Py_ssize_t v, Py_ssize_t u) noexcept nogil:
    """Whether most of a pixel and its eight neighbours are drivable; beyond the image lies what is at its edge."""
    cdef Py_ssize_t last_row = drivable.shape[0] - 1, last_column = drivable.shape[1] - 1, row, k
    cdef Py_ssize_t left = u - 1 if u > 0 else 0, right = u + 1 if u < last_column else last_column
    cdef int found = 0
    for k in range(-1, 2):
        row = v + k
        row = 0 if row < 0 else last_row if row > last_row else row
        found += drivable[row, left] + drivable[row, u] + drivable[row, right]
    return found >= MOST


def mark_visible(
    projection, const double[:, ::1] camera_T_ego, middles, const uint8_t[:, :] drivable, const float[:, :] depth_m,
    double tolerance, double slack_m, uint8_t[:, ::1] visible,
):
    cdef const double[::1] x_m = middles[0], y_m = middles[1]
    cdef const double[:, ::1] z_m = middles[2]
    cdef double fx, fy, cx, cy, x, y, z, right, down, ahead, column, row
    cdef Py_ssize_t j, i, v, u, height = drivable.shape[0], width = drivable.shape[1]
    cdef const double* T
    cdef bint seen
    require_belonging(
        (camera_T_ego.shape[0], camera_T_ego.shape[1]), (x_m.shape[0],), (y_m.shape[0],), (z_m.shape[0], z_m.shape[1]),
        (height, width), None if depth_m is None else (depth_m.shape[0], depth_m.shape[1]),
        (visible.shape[0], visible.shape[1]),
    )
    fx, fy, cx, cy = projection
    T = &camera_T_ego[0, 0]
    with nogil:
        for j in range(y_m.shape[0]):
            y = y_m[j]
            for i in range(x_m.shape[0]):
                x = x_m[i]
                z = z_m[j, i]
                ahead = T[8] * x + T[9] * y + T[10] * z + T[11]
                seen = False
                if ahead > NEAREST_M:
                    right = T[0] * x + T[1] * y + T[2] * z + T[3]
                    down = T[4] * x + T[5] * y + T[6] * z + T[7]
                    column = rint(fx * right / ahead + cx)
                    row = rint(fy * down / ahead + cy)
                    if column >= 0 and column < width and row >= 0 and row < height:
                        v = <Py_ssize_t>row
                        u = <Py_ssize_t>column
                        seen = _is_mostly(drivable, v, u)
                        if seen and depth_m is not None:
                            seen = fabs(<double>depth_m[v, u] - ahead) <= tolerance * ahead + slack_m
                visible[j, i] = seen
