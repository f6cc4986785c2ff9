# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Disparities refined and doubled, and their errors; ``stereo_plain`` documents the functions.

With disparities in sixteenths and 8-bit greys all sums are multiples of 1/512 or 1/1024. As integers they are exact,
as are OpenCV's sums in float64, so their order does not matter.
"""

from libc.float cimport FLT_MAX
from libc.math cimport NAN, fabsf
from libc.stdint cimport int16_t, int32_t, int64_t, uint8_t

import numpy as np

cdef enum:
    PARTS = 16  # of a pixel
    OUTSIDE = 2  # empty columns on either side of a row

cdef int[5] PARTS_OF = [1, 32, 16, 512, 1024]
"""Units per 1 of the sums of known pixels, slopes, differences, their products, and the slopes' squares."""


cdef Py_ssize_t _reflected(Py_ssize_t place, Py_ssize_t count) noexcept nogil:
    """Reflect an index outside the image into it, as OpenCV's BORDER_REFLECT_101 does."""
    if count == 1:
        return 0
    while not 0 <= place < count:
        place = -place if place < 0 else 2 * (count - 1) - place
    return place


cdef void _slope(const int16_t* grey, int16_t* slope, Py_ssize_t width) noexcept nogil:
    """Compute twice the slope: the difference of the pixels on either side."""
    cdef Py_ssize_t u
    for u in range(1, width - 1):
        slope[u] = grey[u + 1] - grey[u - 1]
    slope[0] = slope[width - 1] = 0  # reflection makes both sides the same pixel


cdef void _compare(
    const int16_t* sixteenths, const uint8_t* left, const int16_t* grey, const int16_t* slope, int16_t* known,
    int16_t* slope_32, int16_t* difference_16, int width,
) noexcept nogil:
    """Compute for a row: known pixels, the right image's slope there in 1/32, the left one's difference in 1/16.

    ``grey`` and ``slope`` (in halves) are the right image's, with empty columns on either side.
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
    """Compute the means over squares from the sums over their columns, which are in units of 1 / ``parts``."""
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
    """Refine row by row; ``grey`` is a row of the right image and its slope, the last row of ``maps`` is empty."""
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
        old = _reflected(v - reach - 1, height) if v > 0 else height  # up to the first row the square only fills
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
        raise ValueError(f"size {size}: expected an odd number of pixels")
    result = np.empty((height, width), np.float32)
    if not result.size:
        return result
    cdef float[:, ::1] moved_px = result
    cdef const int16_t[:, ::1] matched = np.ascontiguousarray(sixteenths)
    cdef const uint8_t[:, ::1] left_grey = np.ascontiguousarray(left), right_grey = np.ascontiguousarray(right)
    cdef int16_t[:, ::1] grey = np.zeros((2, width + 2 * OUTSIDE), np.int16)  # a row, and its slope
    cdef int16_t[:, :, ::1] maps = np.zeros((3, height + 1, width), np.int16)  # the last row stays empty
    cdef int32_t[:, ::1] sums = np.zeros((5, width + 2 * reach), np.int32)
    cdef float[:, ::1] means = np.empty((5, width), np.float32)
    with nogil:
        _refine(matched, left_grey, right_grey, size, grey, maps, sums, means, moved_px)
    return result


cdef inline float _between(float here, float following, double share) noexcept nogil:
    return <float>(<double>here + <double>(following - here) * share)


cdef void _double_row(const float* half, float* smooth, Py_ssize_t width) noexcept nogil:
    """Interpolate the 2 ``width`` values of the doubled image along a row."""
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
    """Interpolate between two rows with the weight ``beside`` of the lower one; at object borders take the nearest."""
    cdef float smooth
    cdef Py_ssize_t u
    for u in range(width):
        smooth = _between(above[u], below[u], beside)
        doubled[u] = smooth if fabsf(smooth - nearest[u]) < step_px else nearest[u]


cdef void _double(const float[:, ::1] half, float[:, ::1] rows, float[:, ::1] doubled, float step_px) noexcept nogil:
    """Double an image; ``rows`` holds the interpolated rows above and below, and the repeated nearest row."""
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


cdef struct Limits:
    float scale_px_m, max_depth_m, bad_px, bad_share

cdef struct Counts:
    int64_t counted, known, bad

cdef enum:
    UNKNOWN = -1  # an absolute error is never negative


cdef void _compare_disparities(
    const float* estimated_m, const float* true_m, const uint8_t* seen, const Limits limits, float* error_px,
    float* relative, Counts* counts, int width,
) noexcept nogil:
    """Compute a row's errors; numbers instead of conditions let the compiler use vector code."""
    cdef int u, is_counted, is_known, is_bad, counted = 0, bad = 0
    cdef float estimated_px, true_px, off_px, most_px
    for u in range(width):
        estimated_px = limits.scale_px_m / estimated_m[u]
        true_px = limits.scale_px_m / true_m[u]
        off_px = fabsf(estimated_px - true_px)
        most_px = max(limits.bad_share * true_px, limits.bad_px)  # NaN stays NaN
        is_counted = seen[u] & <int>(true_m[u] < limits.max_depth_m)
        is_known = is_counted & <int>(fabsf(estimated_px) <= FLT_MAX)
        is_bad = is_known & <int>(off_px > most_px)
        counted += is_counted
        bad += is_bad
        error_px[u] = off_px if is_known else <float>UNKNOWN
        relative[u] = fabsf(estimated_m[u] - true_m[u]) / true_m[u]
    counts.counted += counted
    counts.bad += bad


cdef void _append(
    const float* error_px, const float* relative, Counts* counts, float* known_px, float* known_relative, int width
) noexcept nogil:
    """Append a row's known errors; unknown ones are written, too, and overwritten by the next error."""
    cdef int u
    cdef int64_t known = counts.known
    for u in range(width):
        known_px[known] = error_px[u]
        known_relative[known] = relative[u]
        known += error_px[u] != <float>UNKNOWN
    counts.known = known


def disparity_errors(estimated_m, true_m, seen, all_limits):
    if not estimated_m.shape == true_m.shape == seen.shape:
        raise ValueError(f"{estimated_m.shape}, {true_m.shape}, {seen.shape}: expected one size")
    cdef const float[:, ::1] estimated = np.ascontiguousarray(estimated_m), true = np.ascontiguousarray(true_m)
    cdef const uint8_t[:, ::1] both = np.ascontiguousarray(seen).view(np.uint8)
    cdef Py_ssize_t height = estimated.shape[0], width = estimated.shape[1], v
    cdef float[:, ::1] known = np.empty((2, height * width + 1), np.float32)
    cdef float[:, ::1] of_row = np.empty((2, width + 1), np.float32)
    cdef Limits limits
    limits.scale_px_m, limits.max_depth_m, limits.bad_px, limits.bad_share = all_limits
    cdef Counts counts = Counts(0, 0, 0)
    with nogil:
        for v in range(height if width else 0):
            _compare_disparities(
                &estimated[v, 0], &true[v, 0], &both[v, 0], limits, &of_row[0, 0], &of_row[1, 0], &counts, <int>width
            )
            _append(&of_row[0, 0], &of_row[1, 0], &counts, &known[0, 0], &known[1, 0], <int>width)
    of_known = np.asarray(known)[:, : counts.known]
    return of_known[0], of_known[1], counts.counted, counts.bad


cdef struct Row:
    int32_t* column  # left one of the right image's two columns of each pixel; the width if the pixel is not seen
    int32_t* nearest_column  # of the right image
    float* at_px  # largest disparity in each column; an additional column takes pixels that are not seen
    float* behind_px  # the same for pixels that reach into the next column
    float* nearest_px


cdef void _place(const float* disparity_px, const Row row, int width) noexcept nogil:
    cdef int u, left, is_right
    cdef float partner_px, beyond_px
    for u in range(width):
        partner_px = <float>u - disparity_px[u]
        partner_px = partner_px if disparity_px[u] > 0 else <float>-1
        left = <int>(partner_px if partner_px >= 0 else <float>0)
        row.column[u] = left if partner_px >= 0 else width
        beyond_px = partner_px - <float>left
        is_right = 1 if beyond_px > <float>0.5 else 0
        is_right = left & 1 if beyond_px == <float>0.5 else is_right  # round half to even, as numpy does
        row.nearest_column[u] = left + is_right
        row.nearest_px[u] = disparity_px[u] if beyond_px > 0 else 0


cdef void _draw(const float* disparity_px, const Row row, int width) noexcept nogil:
    """Compute the largest disparity in each column of the right image, 0 in empty columns.

    A pixel's two columns have separate arrays: the next pixel's first column is mostly this pixel's second one, and
    would have to wait for it.
    """
    cdef int u, column
    for u in range(width + 1):
        row.at_px[u] = 0
        row.behind_px[u] = 0
    for u in range(width):
        column = row.column[u]
        row.at_px[column] = max(row.at_px[column], disparity_px[u])
        row.behind_px[column] = max(row.behind_px[column], row.nearest_px[u])
    row.nearest_px[0] = row.at_px[0]
    for u in range(1, width):
        row.nearest_px[u] = max(row.at_px[u], row.behind_px[u - 1])


cdef void _see(const float* disparity_px, const Row row, uint8_t* seen, int width, float occlusion_px) noexcept nogil:
    cdef int u
    for u in range(width):
        seen[u] = (row.nearest_px[row.nearest_column[u]] <= disparity_px[u] + occlusion_px) & (row.column[u] < width)


def seen_by_both(const float[:, :] disparity_px, float occlusion_px):
    cdef const float[:, ::1] rows = np.ascontiguousarray(disparity_px)
    cdef Py_ssize_t height = rows.shape[0], width = rows.shape[1], v
    result = np.zeros((height, width), np.bool_)
    if not result.size:
        return result
    cdef uint8_t[:, ::1] seen = result.view(np.uint8)
    cdef int32_t[:, ::1] columns = np.empty((2, width), np.int32)
    cdef float[:, ::1] drawn_px = np.empty((3, width + 1), np.float32)
    cdef Row row
    row.column, row.nearest_column = &columns[0, 0], &columns[1, 0]
    row.at_px, row.behind_px, row.nearest_px = &drawn_px[0, 0], &drawn_px[1, 0], &drawn_px[2, 0]
    with nogil:
        for v in range(height):
            _place(&rows[v, 0], row, width)
            _draw(&rows[v, 0], row, width)
            _see(&rows[v, 0], row, &seen[v, 0], width, occlusion_px)
    return result
