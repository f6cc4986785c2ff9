# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Points of a strip of road and their cells, one after the other: ``strip_points_plain`` says which."""

from libc.math cimport fabsf
from libc.stdint cimport int32_t, uint8_t

import numpy as np

from roadperc_stream.core.kernels.strip_points_plain import require_belonging


def points_on_strip(
    strip, const float[:, :] depth_m, rays, const float[::1] abd, const uint8_t[:, :] among,
):
    cdef const float[:, ::1] column = rays[0], row = rays[1]
    cdef const float[::1] start = rays[2]
    cdef Py_ssize_t height = depth_m.shape[0], width = depth_m.shape[1], v, u, found = 0
    cdef float length = strip.length_m, half = strip.half_width_m, step = strip.step_m, x, y, z, depth
    cdef int32_t across = strip.across
    require_belonging(
        (height, width), (column.shape[0], column.shape[1]), (row.shape[0], row.shape[1]), (start.shape[0],),
        (abd.shape[0],), (among.shape[0], among.shape[1]),
    )
    cdef float[:, ::1] points = np.empty((3, height * width), np.float32)
    cdef int32_t[::1] cells = np.empty(height * width, np.int32)
    with nogil:
        for v in range(height):
            for u in range(width):
                if not among[v, u]:
                    continue
                depth = depth_m[v, u]
                x = (row[0, v] + column[0, u]) * depth + start[0]
                y = (row[1, v] + column[1, u]) * depth + start[1]
                if x >= 0 and x < length and fabsf(y) < half:
                    z = (row[2, v] + column[2, u]) * depth + start[2]
                    points[0, found] = x
                    points[1, found] = y
                    points[2, found] = z - ((abd[2] - abd[0] * x) - abd[1] * y)
                    cells[found] = <int32_t>(x / step) * across + <int32_t>((y + half) / step)
                    found += 1
    return np.asarray(points)[:, :found], np.asarray(cells)[:found]
