# cython: language_level=3, boundscheck=False, wraparound=False
"""Metres of a depth camera's millimetres and back, each in one pass: ``depth_plain`` says what they are."""

from libc.math cimport NAN
from libc.stdint cimport uint16_t

cdef enum:
    MOST_MM = 65535
    NO_FRACTION = 8388608  # 2^23: a float32 of this size has no room for one, and rounds to even as it loses it


cdef void _metres_of_row(const uint16_t* millimetres, float* metres, Py_ssize_t width) noexcept nogil:
    cdef float known
    cdef Py_ssize_t x
    for x in range(width):
        known = <float><int>millimetres[x] * <float>0.001
        metres[x] = known if millimetres[x] else <float>NAN


cdef void _mm_of_row(const float* metres, uint16_t* millimetres, Py_ssize_t width) noexcept nogil:
    cdef float exact
    cdef int rounded
    cdef Py_ssize_t x
    for x in range(width):
        exact = metres[x] * <float>1000.0
        exact = exact if exact < MOST_MM else <float>MOST_MM
        exact = exact if metres[x] > 0 else <float>0
        rounded = <int>((exact + <float>NO_FRACTION) - <float>NO_FRACTION)
        rounded = rounded if rounded > 0 else metres[x] > 0
        millimetres[x] = <uint16_t>rounded


def metres_of_mm(const uint16_t[:, ::1] depth_mm, float[:, ::1] depth_m):
    cdef Py_ssize_t height = depth_mm.shape[0], width = depth_mm.shape[1], y
    _require_equal(height, width, depth_m.shape[0], depth_m.shape[1])
    with nogil:
        for y in range(height if width else 0):
            _metres_of_row(&depth_mm[y, 0], &depth_m[y, 0], width)


def mm_of_metres(const float[:, ::1] depth_m, uint16_t[:, ::1] depth_mm):
    cdef Py_ssize_t height = depth_m.shape[0], width = depth_m.shape[1], y
    _require_equal(height, width, depth_mm.shape[0], depth_mm.shape[1])
    with nogil:
        for y in range(height if width else 0):
            _mm_of_row(&depth_m[y, 0], &depth_mm[y, 0], width)


cdef _require_equal(Py_ssize_t height, Py_ssize_t width, Py_ssize_t other_height, Py_ssize_t other_width):
    if (height, width) != (other_height, other_width):
        raise ValueError(f"{height}x{width} depths into {other_height}x{other_width}: expected one size")
