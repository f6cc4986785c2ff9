# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Which pixels of the left image the right camera sees too, by drawing each row of them into the right image."""

import numpy as np

from libc.stdint cimport uint8_t


cdef void _draw(const float* disparity_px, float* nearest_px, int width) noexcept nogil:
    """The largest disparity in each of a row's columns of the right image, 0 in those that nothing is drawn into."""
    cdef int u, left, right
    cdef float partner_px
    for u in range(width):
        nearest_px[u] = 0
    for u in range(width):
        partner_px = <float>u - disparity_px[u]
        if disparity_px[u] > 0 and partner_px >= 0:
            left = <int>partner_px
            right = left + <bint>(partner_px > <float>left)
            nearest_px[left] = max(nearest_px[left], disparity_px[u])
            nearest_px[right] = max(nearest_px[right], disparity_px[u])


cdef void _see(
    const float* disparity_px, const float* nearest_px, uint8_t* seen, int width, float occlusion_px
) noexcept nogil:
    cdef int u, left
    cdef float partner_px, beyond_px
    cdef bint is_right
    for u in range(width):
        partner_px = <float>u - disparity_px[u]
        seen[u] = 0
        if disparity_px[u] > 0 and partner_px >= 0:
            left = <int>partner_px
            beyond_px = partner_px - <float>left
            is_right = beyond_px > 0.5 or (beyond_px == 0.5 and left % 2 == 1)  # half-way to the even one, as numpy has it
            seen[u] = nearest_px[left + is_right] <= disparity_px[u] + occlusion_px


def seen_by_both(const float[:, :] disparity_px, float occlusion_px):
    """As ``occlusion_plain``."""
    cdef const float[:, ::1] rows = np.ascontiguousarray(disparity_px)
    cdef Py_ssize_t height = rows.shape[0], width = rows.shape[1], v
    result = np.zeros((height, width), np.bool_)
    if not result.size:
        return result
    cdef uint8_t[:, ::1] seen = result.view(np.uint8)
    cdef float[::1] nearest_px = np.empty(width, np.float32)
    with nogil:
        for v in range(height):
            _draw(&rows[v, 0], &nearest_px[0], width)
            _see(&rows[v, 0], &nearest_px[0], &seen[v, 0], width, occlusion_px)
    return result
