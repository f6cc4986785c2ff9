# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Which pixels of the left image the right camera sees too, by drawing each row of them into the right image."""

from libc.stdint cimport int32_t, uint8_t

import numpy as np


cdef struct Row:
    int32_t* column  # the column of the right image that a pixel is drawn from, the one behind the last if it is not
    int32_t* nearest_column  # of the right image
    float* at_px  # largest disparity of the pixels drawn from a column; one more column is for all that are not
    float* behind_px  # of those that reach into the next one
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
        is_right = left & 1 if beyond_px == <float>0.5 else is_right  # half-way to the even one, as numpy has it
        row.nearest_column[u] = left + is_right
        row.nearest_px[u] = disparity_px[u] if beyond_px > 0 else 0


cdef void _draw(const float* disparity_px, const Row row, int width) noexcept nogil:
    """The largest disparity in each column of the right image, 0 in those that nothing is drawn into.

    A pixel's two columns are kept apart: the next pixel's first column is mostly this one's second, and would have to
    wait for it.
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
    """As ``occlusion_plain``."""
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
