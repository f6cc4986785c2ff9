# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Regions divided at depth jumps; ``objects_plain`` documents the function."""

from libc.math cimport fabsf
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
                    parent[at] = _root(parent, at - 1)
                if y and of_class[at - width] and fabsf(log_depth[at] - log_depth[at - width]) < jump:
                    _join(parent, at, at - width)


cdef int32_t _number(
    const uint8_t* of_class, int32_t* parent, int32_t* labels, int32_t* borders, int32_t height, int32_t width,
    int32_t* found,
) noexcept nogil:
    """Write the label of each pixel, in the order of first pixels; return the number of labels.

    ``borders`` are the places of neighbours with two labels, and ``found`` is their number.
    """
    cdef int32_t y, x, at = 0, label, count = 0
    found[0] = 0
    for y in range(height):
        for x in range(width):
            label = 0
            if of_class[at]:
                if parent[at] == at:
                    count += 1
                    label = count
                else:
                    label = labels[_root(parent, at)]
                if x and labels[at - 1] not in (0, label):
                    borders[2 * found[0]], borders[2 * found[0] + 1] = at, at - 1
                    found[0] += 1
                if y and labels[at - width] not in (0, label):
                    borders[2 * found[0]], borders[2 * found[0] + 1] = at, at - width
                    found[0] += 1
            labels[at] = label
            at += 1
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
    cdef int32_t height = of_class.shape[0], width = of_class.shape[1], size = height * width, x, y, at, count, k, found
    cdef Py_ssize_t regions, way, root, number, most = jumps.shape[0]
    if log_depth.shape[0] != height or log_depth.shape[1] != width or not size or not most:
        raise ValueError(f"{height}x{width} pixels, {log_depth.shape[0]}x{log_depth.shape[1]} depths, {most} jumps")
    all_labels = np.empty((height, width), np.int32)
    cdef int32_t[::1] labels = all_labels.ravel(), parent = np.arange(size, dtype=np.int32)
    cdef int32_t[:, ::1] borders = np.empty((2 * size, 2), np.int32)
    cdef const float* depths = &log_depth[0, 0]
    cdef const uint8_t* chosen = &of_class[0, 0]
    with nogil:
        _join_neighbours(depths, chosen, &parent[0], height, width, jumps[0])
        count = _number(chosen, &parent[0], &labels[0], &borders[0, 0], height, width, &found)
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
            for k in range(found):
                if fabsf(depths[borders[k, 0]] - depths[borders[k, 1]]) < jumps[way]:
                    _join(&parent[0], labels[borders[k, 0]] - 1, labels[borders[k, 1]] - 1)
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
