# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""The points of an object in its box, beside the path, in one pass over the depths; the mean direction of the nearest."""

import numpy as np

from libc.math cimport hypot, sqrt
from libc.stdint cimport uint8_t


def object_points(
    const float[:, :] depth_m, camera, box, of_class, double distance_m, behind_m,
    const double[:, :] ego_T_camera, circle,
):
    """As ``object_points_plain``.

    Raises:
        ValueError: as there.
    """
    cdef double fx = camera[0], fy = camera[1], cx = camera[2], cy = camera[3]
    cdef Py_ssize_t x0 = box[0], y0 = box[1], x1 = box[2], y1 = box[3], step = box[4], row, column, count = 0, most
    cdef Py_ssize_t height = depth_m.shape[0], width = depth_m.shape[1]
    cdef double least_m = behind_m[0], most_m = behind_m[1], x, y, z, beyond_m
    cdef double offset_m = circle[0], cosine = circle[1], sine = circle[2], bend = circle[3]
    cdef double across, along, ahead, aside
    cdef const uint8_t[:, :] tags = None
    cdef const uint8_t[::1] wanted = None
    cdef bint any_class = of_class is None
    cdef double[2][4] T
    if not any_class:
        tags, wanted = of_class
    if (
        not (0 <= x0 and x1 <= width and 0 <= y0 and y1 <= height and step > 0)
        or not (any_class or (tags.shape[0], tags.shape[1], wanted.shape[0]) == (height, width, 256))
        or ego_T_camera.shape[0] != 4 or ego_T_camera.shape[1] != 4
    ):
        raise ValueError(f"{height}x{width} depths, every {step}. of {x0, y0, x1, y1}, do not fit "
                         "their tags, 256 of them or (4, 4)")
    for row in range(2):
        for column in range(4):
            T[row][column] = ego_T_camera[row, column]
    most = max((x1 - x0 + step - 1) // step, 0) * max((y1 - y0 + step - 1) // step, 0)
    all_points, all_ranges, all_lateral = np.empty((most, 3)), np.empty(most), np.empty(most)
    cdef double[:, ::1] points = all_points
    cdef double[::1] ranges = all_ranges, lateral = all_lateral
    with nogil:
        for row from y0 <= row < y1 by step:
            y = (row - cy) / fy
            for column from x0 <= column < x1 by step:
                if not any_class and not wanted[tags[row, column]]:
                    continue
                z = depth_m[row, column]
                x = (column - cx) / fx
                beyond_m = z * sqrt(x * x + (y * y + 1.0)) - distance_m
                if beyond_m > least_m and beyond_m < most_m:
                    points[count, 0], points[count, 1], points[count, 2] = x * z, y * z, z
                    ranges[count] = sqrt(
                        points[count, 0] * points[count, 0] + points[count, 1] * points[count, 1] + z * z
                    )
                    count += 1
        for row in range(count):
            x, y, z = points[row, 0], points[row, 1], points[row, 2]
            along = T[0][0] * x + T[0][1] * y + T[0][2] * z + T[0][3]
            across = T[1][0] * x + T[1][1] * y + T[1][2] * z + T[1][3] - offset_m
            ahead, aside = cosine * along + sine * across, cosine * across - sine * along
            lateral[row] = (2.0 * aside - bend * (ahead * ahead + aside * aside)) / (
                1.0 + hypot(bend * ahead, 1.0 - bend * aside)
            )
    return all_points[:count], all_ranges[:count], all_lateral[:count]


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
