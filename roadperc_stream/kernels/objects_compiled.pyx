# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Regions divided at depth jumps, their distances, and the points of an object; see ``objects_plain``."""

from libc.math cimport INFINITY, fabsf, sqrt
from libc.stdint cimport int32_t, int64_t, uint8_t

import numpy as np

cdef inline int32_t _root(int32_t* parent, int32_t place) noexcept nogil:
    while parent[place] != place:
        parent[place] = parent[parent[place]]
        place = parent[place]
    return place


cdef inline void _join(int32_t* parent, int32_t one, int32_t other) noexcept nogil:
    one, other = _root(parent, one), _root(parent, other)
    if one < other:
        parent[other] = one
    else:
        parent[one] = other


cdef void _join_neighbours(
    const float* log_depth, const uint8_t* of_class, int32_t* parent, int32_t height, int32_t width, float jump
) noexcept nogil:
    cdef int32_t y, x, at
    for y in range(height):
        for x in range(width):
            at = y * width + x
            if of_class[at]:
                if x and of_class[at - 1] and fabsf(log_depth[at] - log_depth[at - 1]) < jump:
                    _join(parent, at, at - 1)
                if y and of_class[at - width] and fabsf(log_depth[at] - log_depth[at - width]) < jump:
                    _join(parent, at, at - width)


cdef void _join_regions(
    const float* log_depth, const int32_t* labels, int32_t* parent, int32_t height, int32_t width, float jump
) noexcept nogil:
    """Join labels counted from 1 as ``_join_neighbours`` joins pixels; most neighbours already have one label."""
    cdef int32_t y, x, at, label
    for y in range(height):
        for x in range(width):
            at = y * width + x
            label = labels[at]
            if label:
                if x and labels[at - 1] not in (0, label) and fabsf(log_depth[at] - log_depth[at - 1]) < jump:
                    _join(parent, label - 1, labels[at - 1] - 1)
                if y and labels[at - width] not in (0, label) and fabsf(log_depth[at] - log_depth[at - width]) < jump:
                    _join(parent, label - 1, labels[at - width] - 1)


cdef int32_t _number(const uint8_t* of_class, int32_t* parent, int32_t* labels, int32_t size) noexcept nogil:
    """Write the label of each pixel, in the order of first pixels; return the number of labels."""
    cdef int32_t at, count = 0
    for at in range(size):
        labels[at] = 0
        if of_class[at]:
            if parent[at] == at:
                count += 1
                labels[at] = count
            else:
                labels[at] = labels[_root(parent, at)]
    return count


cdef inline void _add(
    int64_t[:, ::1] bounds, int64_t[::1] pixels, Py_ssize_t k,
    int64_t x0, int64_t y0, int64_t x1, int64_t y1, int64_t number,
) noexcept nogil:
    """Extend region k by bounds and a number of pixels."""
    bounds[0, k], bounds[1, k] = min(bounds[0, k], x0), min(bounds[1, k], y0)
    bounds[2, k], bounds[3, k] = max(bounds[2, k], x1), max(bounds[3, k], y1)
    pixels[k] += number


def divided(const float[:, ::1] log_depth, const uint8_t[:, ::1] of_class, const float[::1] jumps):
    cdef int32_t height = of_class.shape[0], width = of_class.shape[1], size = height * width, x, y, at, count, k
    cdef Py_ssize_t regions, way, root, number, most = jumps.shape[0]
    if log_depth.shape[0] != height or log_depth.shape[1] != width or not size or not most:
        raise ValueError(f"{height}x{width} pixels, {log_depth.shape[0]}x{log_depth.shape[1]} depths, {most} jumps")
    all_labels = np.empty((height, width), np.int32)
    cdef int32_t[::1] labels = all_labels.ravel(), parent = np.arange(size, dtype=np.int32)
    cdef const float* depths = &log_depth[0, 0]
    cdef const uint8_t* chosen = &of_class[0, 0]
    with nogil:
        _join_neighbours(depths, chosen, &parent[0], height, width, jumps[0])
        count = _number(chosen, &parent[0], &labels[0], size)
    all_names, all_ways = np.zeros((most, count + 1), np.int64), np.zeros(most * count, np.int64)
    all_bounds, all_pixels = np.zeros((4, most * count), np.int64), np.zeros(most * count, np.int64)
    all_bounds[:2] = size
    cdef int64_t[:, ::1] names = all_names, bounds = all_bounds
    cdef int64_t[::1] ways = all_ways, pixels = all_pixels
    cdef int64_t[::1] members = np.empty(count, np.int64), before = np.ones(count, np.int64)
    with nogil:
        at = 0
        for y in range(height):
            for x in range(width):
                if labels[at]:
                    _add(bounds, pixels, labels[at] - 1, x, y, x + 1, y + 1, 1)
                at += 1
        for k in range(count):
            names[0, k + 1] = k + 1
            parent[k] = k  # from here on regions are joined, not pixels
        regions = count
        for way in range(1, most):
            _join_regions(depths, &labels[0], &parent[0], height, width, jumps[way])
            for k in range(count):
                members[k] = 0
            for k in range(count):
                members[_root(&parent[0], k)] += 1
            for k in range(count):  # a set's root is its first member, so it comes before the others
                root = _root(&parent[0], k)
                if members[root] == before[root]:
                    continue
                if root == k:
                    regions += 1
                    ways[regions - 1] = way
                    names[way, k + 1] = regions
                names[way, k + 1] = names[way, root + 1]
                number = names[way, k + 1] - 1
                _add(bounds, pixels, number, bounds[0, k], bounds[1, k], bounds[2, k], bounds[3, k], pixels[k])
            for k in range(count):
                before[k] = members[k]
    return all_labels, all_names, all_ways[:regions], all_bounds[:, :regions], all_pixels[:regions]


cdef void _sum_rows(
    const int32_t[:, :] labels, const uint8_t[::1] chosen, const float[:, :] distances_m,
    double* row_m, double[:, ::1] sums, float[:, ::1] counts,
) noexcept nogil:
    """Sum the finite distances of each pixel and its two neighbours of the row; row y goes to row y + 1."""
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


def object_points(const float[:, :] depth_m, camera, box, of_class, double distance_m, behind_m):
    cdef double fx = camera[0], fy = camera[1], cx = camera[2], cy = camera[3]
    cdef Py_ssize_t x0 = box[0], y0 = box[1], x1 = box[2], y1 = box[3], step = box[4], row, column, count = 0, most
    cdef Py_ssize_t height = depth_m.shape[0], width = depth_m.shape[1]
    cdef double least_m = behind_m[0], most_m = behind_m[1], x, y, z, beyond_m
    cdef const uint8_t[:, :] tags = None
    cdef const uint8_t[::1] wanted = None
    cdef bint any_class = of_class is None
    if not any_class:
        tags, wanted = of_class
    if (
        not (0 <= x0 and x1 <= width and 0 <= y0 and y1 <= height and step > 0)
        or not (any_class or (tags.shape[0], tags.shape[1], wanted.shape[0]) == (height, width, 256))
    ):
        raise ValueError(f"{height}x{width} depths: the box {x0, y0, x1, y1} with step {step} or the tags do not fit")
    most = max((x1 - x0 + step - 1) // step, 0) * max((y1 - y0 + step - 1) // step, 0)
    all_points, all_ranges = np.empty((most, 3)), np.empty(most)
    cdef double[:, ::1] points = all_points
    cdef double[::1] ranges = all_ranges
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
    return all_points[:count], all_ranges[:count]
