# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""How far disparities and depths are off, in one pass: ``disparity_errors_plain`` says over which pixels."""

from libc.float cimport FLT_MAX
from libc.math cimport fabsf
from libc.stdint cimport int64_t, uint8_t

import numpy as np


cdef struct Limits:
    float scale_px_m
    float max_depth_m
    float bad_px
    float bad_share


cdef struct Counts:
    int64_t counted
    int64_t known
    int64_t bad


cdef enum:
    UNKNOWN = -1  # no absolute error is


cdef void _compare(
    const float* estimated_m, const float* true_m, const uint8_t* seen, const Limits limits, float* error_px,
    float* relative, Counts* counts, int width,
) noexcept nogil:
    """Numbers instead of conditions: so the compiler makes vectors of it."""
    cdef int u, is_counted, is_known, is_bad, counted = 0, bad = 0
    cdef float estimated_px, true_px, off_px, most_px
    for u in range(width):
        estimated_px = limits.scale_px_m / estimated_m[u]
        true_px = limits.scale_px_m / true_m[u]
        off_px = fabsf(estimated_px - true_px)
        most_px = max(limits.bad_share * true_px, limits.bad_px)  # NaN of NaN
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
    """Behind those of earlier rows; each is written, and stays where it is known."""
    cdef int u
    cdef int64_t known = counts.known
    for u in range(width):
        known_px[known] = error_px[u]
        known_relative[known] = relative[u]
        known += error_px[u] != <float>UNKNOWN
    counts.known = known


def disparity_errors(estimated_m, true_m, seen, float scale_px_m, float max_depth_m, float bad_px, float bad_share):
    if not estimated_m.shape == true_m.shape == seen.shape:
        raise ValueError(f"{estimated_m.shape}, {true_m.shape}, {seen.shape}: expected one size")
    cdef const float[:, ::1] estimated = np.ascontiguousarray(estimated_m), true = np.ascontiguousarray(true_m)
    cdef const uint8_t[:, ::1] both = np.ascontiguousarray(seen).view(np.uint8)
    cdef Py_ssize_t height = estimated.shape[0], width = estimated.shape[1], v
    cdef float[:, ::1] known = np.empty((2, height * width + 1), np.float32)
    cdef float[:, ::1] of_row = np.empty((2, width + 1), np.float32)
    cdef Limits limits = Limits(scale_px_m, max_depth_m, bad_px, bad_share)
    cdef Counts counts = Counts(0, 0, 0)
    with nogil:
        for v in range(height if width else 0):
            _compare(
                &estimated[v, 0], &true[v, 0], &both[v, 0], limits, &of_row[0, 0], &of_row[1, 0], &counts, <int>width
            )
            _append(&of_row[0, 0], &of_row[1, 0], &counts, &known[0, 0], &known[1, 0], <int>width)
    of_known = np.asarray(known)[:, : counts.known]
    return of_known[0], of_known[1], counts.counted, counts.bad
