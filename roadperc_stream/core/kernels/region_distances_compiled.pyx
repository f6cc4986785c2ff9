# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Distances of a region's pixels, each the mean of those around it, in two passes."""

import numpy as np

from libc.math cimport INFINITY
from libc.stdint cimport int32_t, uint8_t


cdef void _sum_rows(
    const int32_t[:, :] labels, const uint8_t[::1] chosen, const float[:, :] distances_m,
    double* row_m, double[:, ::1] sums, float[:, ::1] counts,
) noexcept nogil:
    """Of the finite ones beside each pixel and its own: in row y + 1 those of row y."""
    cdef Py_ssize_t width = labels.shape[1], y, x
    cdef bint finite
    for y in range(labels.shape[0]):
        for x in range(width):
            finite = chosen[labels[y, x]] and distances_m[y, x] < INFINITY
            row_m[x + 1] = distances_m[y, x] if finite else 0
            if finite:
                counts[y + 1, x] += 1
                counts[y + 1, x + 1] += 1
                counts[y + 1, x + 2] += 1
        for x in range(width):
            sums[y + 1, x] = row_m[x] + row_m[x + 1] + row_m[x + 2]


def region_distances(const int32_t[:, :] labels, of_region, const float[:, :] distances_m, const float[:, :] noise):
    """As ``region_distances_plain``.

    Raises:
        ValueError: as there.
    """
    cdef const uint8_t[::1] chosen = of_region.view(np.uint8)
    cdef Py_ssize_t height = labels.shape[0], width = labels.shape[1], y, x, known = 0, finite = 0
    if not (distances_m.shape[0] == noise.shape[0] == height and distances_m.shape[1] == noise.shape[1] == width):
        raise ValueError(f"{height}x{width} pixels, {distances_m.shape[0]}x{distances_m.shape[1]} distances and "
                         f"{noise.shape[0]}x{noise.shape[1]} noise")
    all_near, all_noise = np.empty(height * width, np.float32), np.empty(height * width, np.float32)
    cdef float[::1] near = all_near, noise_of_finite = all_noise
    cdef float distance_m
    cdef double[::1] row_m = np.zeros(width + 2)
    cdef double[:, ::1] sums = np.zeros((height + 2, width))
    cdef float[:, ::1] counts = np.zeros((height + 2, width + 2), np.float32)
    with nogil:
        _sum_rows(labels, chosen, distances_m, &row_m[0], sums, counts)
        for y in range(height):
            for x in range(width):
                distance_m = distances_m[y, x]
                if not chosen[labels[y, x]] or distance_m != distance_m:
                    continue
                if distance_m < INFINITY:
                    distance_m = <float>(sums[y, x] + sums[y + 1, x] + sums[y + 2, x])
                    distance_m /= counts[y, x + 1] + counts[y + 1, x + 1] + counts[y + 2, x + 1]
                    noise_of_finite[finite] = noise[y, x]
                    finite += 1
                near[known] = distance_m
                known += 1
    return all_near[:known], all_noise[:finite]
