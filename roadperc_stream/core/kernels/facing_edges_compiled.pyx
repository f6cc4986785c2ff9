# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Edges of marked pixels towards the road beside them: stretches in which nothing changes are passed by eights."""

import numpy as np

from libc.stdint cimport uint8_t, uint64_t
from libc.string cimport memcpy

cdef enum:
    EIGHT = 8


cdef inline bint _all_alike(const uint8_t* pixels) noexcept nogil:
    """Whether each of eight pixels is as the one after it."""
    cdef uint64_t these, those
    memcpy(&these, pixels, EIGHT)
    memcpy(&those, pixels + 1, EIGHT)
    return these == those


cdef inline int _gap(
    const uint8_t* marked, const uint8_t* road, Py_ssize_t width, Py_ssize_t last, int towards, int fringe
) noexcept nogil:
    """Pixels between the last marked one and the road; -1 where there is none so near."""
    cdef Py_ssize_t beyond
    cdef int step
    for step in range(fringe + 1):
        beyond = min(max(last + towards * (1 + step), 0), width - 1)
        if marked[beyond]:
            return -1
        if road[beyond]:
            return step
    return -1


cdef Py_ssize_t _of_row(
    const uint8_t* marked, const uint8_t* road, Py_ssize_t width, double row, int towards, int fringe, double* edges
) noexcept nogil:
    """Write a row's edges, and count them."""
    cdef Py_ssize_t inner = 1 if towards > 0 else 0, left = width - 1, found = 0, pair
    cdef int gap
    while left > 0:  # pairs of neighbours, the first of them at ``pair``
        pair = width - 1 - left if towards > 0 else left - 1
        if left >= EIGHT and _all_alike(marked + (pair if towards > 0 else pair - EIGHT + 1)):
            left -= EIGHT
            continue
        left -= 1
        if marked[pair + 1 - inner] <= marked[pair + inner]:
            continue
        gap = _gap(marked, road, width, pair + 1 - inner, towards, fringe)
        if gap < 0:
            continue
        edges[2 * found] = (pair + 1 - inner) + towards * 0.5 * (gap + 1)
        edges[2 * found + 1] = row
        found += 1
    return found


def facing_edges(marked, road, int towards, int fringe):
    """As ``facing_edges_plain``.

    Raises:
        ValueError: as there.
    """
    cdef const uint8_t[:, ::1] all_marked = np.ascontiguousarray(marked), all_road = np.ascontiguousarray(road)
    cdef Py_ssize_t height = all_marked.shape[0], width = all_marked.shape[1], count = 0, y
    if all_road.shape[0] != height or all_road.shape[1] != width:
        raise ValueError(f"{marked.shape} marked pixels, {road.shape} of road: expected one size")
    found = np.empty((height * (width // 2) + 1, 2))  # what is not written takes no memory
    cdef double[:, ::1] edges = found
    if width:
        with nogil:
            for y in range(height):
                count += _of_row(&all_marked[y, 0], &all_road[y, 0], width, y, towards, fringe, &edges[count, 0])
    return found[:count].copy()
