# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Disparities of an image twice as fine, in one pass: ``doubling_plain`` says what they are."""

from libc.math cimport fabsf

import numpy as np


cdef inline float _between(float here, float following, double share) noexcept nogil:
    return <float>(<double>here + <double>(following - here) * share)


cdef void _double_row(const float* half, float* smooth, Py_ssize_t width) noexcept nogil:
    """(2 width) values of the doubled image between those of a row."""
    cdef Py_ssize_t u
    for u in range(width - 1):
        smooth[2 * u + 1] = _between(2 * half[u], 2 * half[u + 1], 0.25)
        smooth[2 * u + 2] = _between(2 * half[u], 2 * half[u + 1], 0.75)
    smooth[0] = 2 * half[0]
    smooth[2 * width - 1] = 2 * half[width - 1]


cdef void _repeat_row(const float* half, float* nearest, Py_ssize_t width) noexcept nogil:
    cdef Py_ssize_t u
    for u in range(width):
        nearest[2 * u] = nearest[2 * u + 1] = 2 * half[u]


cdef void _combine(
    const float* above, const float* below, const float* nearest, float* doubled, Py_ssize_t width,
    double beside, float step_px,
) noexcept nogil:
    """What lies between two rows, ``beside`` of the lower one, but the nearest where that is another thing."""
    cdef float smooth
    cdef Py_ssize_t u
    for u in range(width):
        smooth = _between(above[u], below[u], beside)
        doubled[u] = smooth if fabsf(smooth - nearest[u]) < step_px else nearest[u]


cdef void _double(const float[:, ::1] half, float[:, ::1] rows, float[:, ::1] doubled, float step_px) noexcept nogil:
    """``rows`` are three of the doubled image: what lies between the pixels of one row and of the next, the nearest."""
    cdef Py_ssize_t height = half.shape[0], width = half.shape[1], wide = 2 * width, v
    cdef float* above = &rows[0, 0]
    cdef float* below = &rows[1, 0]
    cdef float* nearest = &rows[2, 0]
    cdef float* other
    _double_row(&half[0, 0], above, width)
    _repeat_row(&half[0, 0], nearest, width)
    _combine(above, above, nearest, &doubled[0, 0], wide, 0, step_px)
    for v in range(height - 1):
        _double_row(&half[v + 1, 0], below, width)
        _combine(above, below, nearest, &doubled[2 * v + 1, 0], wide, 0.25, step_px)
        _repeat_row(&half[v + 1, 0], nearest, width)
        _combine(above, below, nearest, &doubled[2 * v + 2, 0], wide, 0.75, step_px)
        other = above
        above = below
        below = other
    _combine(above, above, nearest, &doubled[2 * height - 1, 0], wide, 0, step_px)


def doubled(const float[:, :] half, float step_px):
    cdef Py_ssize_t height = half.shape[0], width = half.shape[1]
    result = np.empty((2 * height, 2 * width), np.float32)
    if not result.size:
        return result
    cdef const float[:, ::1] ours = np.ascontiguousarray(half)
    cdef float[:, ::1] rows = np.empty((3, 2 * width), np.float32), values = result
    with nogil:
        _double(ours, rows, values, step_px)
    return result
