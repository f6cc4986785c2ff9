# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""The points of an object in its box, in one pass over the depths, and the mean direction of the nearest."""

import numpy as np

from libc.math cimport sqrt
from libc.stdint cimport uint8_t


def object_points(
    const float[:, :] depth_m, const double[::1] x, const double[::1] y, of_class, double distance_m, behind_m
):
    """As ``object_points_plain``.

    Raises:
        ValueError: as there.
    """
    cdef Py_ssize_t height = depth_m.shape[0], width = depth_m.shape[1], row, column, count = 0
    cdef double least_m = behind_m[0], most_m = behind_m[1], z, beyond_m
    cdef const uint8_t[:, :] tags = None
    cdef const uint8_t[::1] wanted = None
    cdef bint any_class = of_class is None
    if not any_class:
        tags, wanted = of_class
    if (y.shape[0], x.shape[0]) != (height, width) or not (
        any_class or tags.shape[0] == height and tags.shape[1] == width and wanted.shape[0] == 256
    ):
        raise ValueError(f"{height}x{width} depths do not fit {y.shape[0]}x{x.shape[0]} rays, their tags "
                         "and 256 of them")
    all_points, all_ranges = np.empty((height * width, 3)), np.empty(height * width)
    cdef double[:, ::1] points = all_points
    cdef double[::1] ranges = all_ranges
    with nogil:
        for row in range(height):
            for column in range(width):
                if not any_class and not wanted[tags[row, column]]:
                    continue
                z = depth_m[row, column]
                beyond_m = z * sqrt(x[column] * x[column] + (y[row] * y[row] + 1.0)) - distance_m
                if beyond_m > least_m and beyond_m < most_m:
                    points[count, 0], points[count, 1], points[count, 2] = x[column] * z, y[row] * z, z
                    ranges[count] = sqrt(
                        points[count, 0] * points[count, 0] + points[count, 1] * points[count, 1] + z * z
                    )
                    count += 1
    return all_points[:count], all_ranges[:count]


def mean_direction(const double[:, ::1] points, const double[::1] ranges_m, double most_m):
    """As ``object_points_plain``.

    Raises:
        ValueError: as there.
    """
    cdef Py_ssize_t n, count = 0
    cdef double x = 0, y = 0
    if points.shape[0] != ranges_m.shape[0] or points.shape[1] != 3:
        raise ValueError(f"{points.shape[0]}x{points.shape[1]} points of {ranges_m.shape[0]} distances")
    with nogil:
        for n in range(points.shape[0]):
            if ranges_m[n] <= most_m:
                x += points[n, 0] / points[n, 2]
                y += points[n, 1] / points[n, 2]
                count += 1
    return (x / count, y / count) if count else (float("nan"), float("nan"))
