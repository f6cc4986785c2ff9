# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Disparities moved to where the two images fit best: ``refinement_plain`` says how.

Of disparities in sixteenths and 8-bit greys all sums are whole numbers of 1/512 or 1/1024: taken as such they are exact,
as the sums in float64 are that OpenCV takes, so that their order does not matter.
"""

from libc.math cimport NAN, fabsf
from libc.stdint cimport int16_t, int32_t, int64_t, uint8_t

import numpy as np

cdef enum:
    PARTS = 16  # of a pixel
    OUTSIDE = 2  # columns of nothing on either side of a row

cdef int[5] PARTS_OF = [1, 32, 16, 512, 1024]
"""What 1 is of the sums: of known pixels, slopes, differences, their products, and the slopes' squares."""


cdef Py_ssize_t _reflected(Py_ssize_t place, Py_ssize_t count) noexcept nogil:
    """The place inside that stands for one outside, as OpenCV's BORDER_REFLECT_101 has it."""
    if count == 1:
        return 0
    while not 0 <= place < count:
        place = -place if place < 0 else 2 * (count - 1) - place
    return place


cdef void _slope(const int16_t* grey, int16_t* slope, Py_ssize_t width) noexcept nogil:
    """Differences of a row's pixels on either side, twice the slope."""
    cdef Py_ssize_t u
    for u in range(1, width - 1):
        slope[u] = grey[u + 1] - grey[u - 1]
    slope[0] = slope[width - 1] = 0  # reflected, both sides are one pixel


cdef void _compare(
    const int16_t* sixteenths, const uint8_t* left, const int16_t* grey, const int16_t* slope, int16_t* known,
    int16_t* slope_32, int16_t* difference_16, int width,
) noexcept nogil:
    """Of a row: what is known, the slope of the right image there in 1/32, and by how many 1/16 the left one differs.

    ``grey`` and ``slope``, in halves, are the right image's, with columns of nothing on either side.
    """
    cdef int u, at, beyond, column_16, is_known
    for u in range(width):
        is_known = sixteenths[u] > 0
        column_16 = PARTS * (u + OUTSIDE) - is_known * sixteenths[u]
        column_16 = max(column_16, 0)
        at, beyond = column_16 >> 4, column_16 & (PARTS - 1)
        known[u] = <int16_t>is_known
        slope_32[u] = <int16_t>(is_known * (PARTS * slope[at] + beyond * (slope[at + 1] - slope[at])))
        difference_16[u] = <int16_t>(
            is_known * (PARTS * (left[u] - grey[at]) - beyond * (grey[at + 1] - grey[at]))
        )


cdef void _exchange(int32_t* sums, const int16_t* new, const int16_t* old, int width) noexcept nogil:
    cdef int u
    for u in range(width):
        sums[u] += <int>new[u] - <int>old[u]


cdef void _exchange_products(
    int32_t* sums, const int16_t* new, const int16_t* new_by, const int16_t* old, const int16_t* old_by, int width
) noexcept nogil:
    cdef int u
    for u in range(width):
        sums[u] += <int>new[u] * <int>new_by[u] - <int>old[u] * <int>old_by[u]


cdef void _mean(const int32_t* sums, float* means, Py_ssize_t width, Py_ssize_t size, int parts) noexcept nogil:
    """Means over squares, of sums over their columns in so many parts of one."""
    cdef double part = 1.0 / <double>parts, share = 1.0 / <double>(size * size)
    cdef int64_t total = 0
    cdef Py_ssize_t u
    for u in range(size - 1):
        total += sums[u]
    for u in range(width):
        total += sums[u + size - 1]
        means[u] = <float>(<double>total * part * share)
        total -= sums[u]


cdef void _move(
    const int16_t* sixteenths, const float* known, const float* slope, const float* difference, const float* product,
    const float* square, float* moved_px, int width, float least_share,
) noexcept nogil:
    cdef float share, covariance, variance, step_px, disparity_px
    cdef int u
    for u in range(width):
        share = max(known[u], least_share)
        covariance = product[u] - slope[u] * difference[u] / share
        variance = square[u] - slope[u] * slope[u] / share
        step_px = -covariance / (variance + <float>1)
        disparity_px = <float><int>sixteenths[u] * <float>0.0625
        step_px = step_px if fabsf(step_px) <= <float>0.5 else <float>0
        disparity_px = disparity_px if disparity_px > 0 else <float>NAN
        moved_px[u] = disparity_px + step_px


cdef void _refine(
    const int16_t[:, ::1] matched, const uint8_t[:, ::1] left, const uint8_t[:, ::1] right, Py_ssize_t size,
    int16_t[:, ::1] grey, int16_t[:, :, ::1] maps, int32_t[:, ::1] sums, float[:, ::1] means, float[:, ::1] moved_px,
) noexcept nogil:
    """Row by row; ``grey`` is a row of the right image and its slope, of ``maps`` the last row is nothing."""
    cdef Py_ssize_t height = matched.shape[0], width = matched.shape[1], reach = size // 2, v, u, k, new, old
    cdef float least_share = <float>(1.0 / <double>(size * size))
    for v in range(height):
        for u in range(width):
            grey[0, u + OUTSIDE] = right[v, u]
        _slope(&grey[0, OUTSIDE], &grey[1, OUTSIDE], width)
        _compare(
            &matched[v, 0], &left[v, 0], &grey[0, 0], &grey[1, 0], &maps[0, v, 0], &maps[1, v, 0],
            &maps[2, v, 0], <int>width,
        )
    for v in range(-2 * reach, height):
        new = _reflected(v + reach, height)
        old = _reflected(v - reach - 1, height) if v > 0 else height  # the first row's square is only filled
        for k in range(3):
            _exchange(&sums[k, reach], &maps[k, new, 0], &maps[k, old, 0], <int>width)
        _exchange_products(
            &sums[3, reach], &maps[1, new, 0], &maps[2, new, 0], &maps[1, old, 0], &maps[2, old, 0], <int>width
        )
        _exchange_products(
            &sums[4, reach], &maps[1, new, 0], &maps[1, new, 0], &maps[1, old, 0], &maps[1, old, 0], <int>width
        )
        if v < 0:
            continue
        for k in range(5):
            for u in range(reach):
                sums[k, u] = sums[k, reach + _reflected(u - reach, width)]
                sums[k, reach + width + u] = sums[k, reach + _reflected(width + u, width)]
        for k in range(5):
            _mean(&sums[k, 0], &means[k, 0], width, size, PARTS_OF[k])
        _move(
            &matched[v, 0], &means[0, 0], &means[1, 0], &means[2, 0], &means[3, 0], &means[4, 0], &moved_px[v, 0],
            <int>width, least_share,
        )


def refined_disparities(const int16_t[:, :] sixteenths, const uint8_t[:, :] left, const uint8_t[:, :] right, int size):
    cdef Py_ssize_t height = sixteenths.shape[0], width = sixteenths.shape[1], reach = size // 2
    if not (left.shape[0] == right.shape[0] == height and left.shape[1] == right.shape[1] == width):
        raise ValueError(f"{height}x{width} disparities of {left.shape[0]}x{left.shape[1]} and "
                         f"{right.shape[0]}x{right.shape[1]} pixels: expected one size")
    if size < 1 or size % 2 == 0:
        raise ValueError(f"squares of {size} pixels: expected an odd number")
    result = np.empty((height, width), np.float32)
    if not result.size:
        return result
    cdef float[:, ::1] moved_px = result
    cdef const int16_t[:, ::1] matched = np.ascontiguousarray(sixteenths)
    cdef const uint8_t[:, ::1] left_grey = np.ascontiguousarray(left), right_grey = np.ascontiguousarray(right)
    cdef int16_t[:, ::1] grey = np.zeros((2, width + 2 * OUTSIDE), np.int16)  # a row, and its slope
    cdef int16_t[:, :, ::1] maps = np.zeros((3, height + 1, width), np.int16)  # the last row is nothing
    cdef int32_t[:, ::1] sums = np.zeros((5, width + 2 * reach), np.int32)
    cdef float[:, ::1] means = np.empty((5, width), np.float32)
    with nogil:
        _refine(matched, left_grey, right_grey, size, grey, maps, sums, means, moved_px)
    return result
