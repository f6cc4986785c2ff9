# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""The place of each cell's median: values are dealt out to their cells, and each cell's middle one is selected.

By Hoare's quickselect (1961) among keys, unsigned numbers in the order of value and place.
"""

from libc.stdint cimport int32_t, int64_t, uint32_t, uint64_t
from libc.stdlib cimport free, malloc
from libc.string cimport memcpy

import numpy as np


cdef inline uint64_t _key(float value, Py_ssize_t place) noexcept nogil:
    """The bits of a float grow with it but for its sign; 0 is added for the sake of -0."""
    cdef uint32_t bits
    value = value + <float>0.0
    memcpy(&bits, &value, sizeof(bits))
    bits = ~bits if bits >> 31 else bits | (<uint32_t>1 << 31)
    return (<uint64_t>bits << 32) | <uint64_t>place


cdef uint64_t _select(uint64_t* keys, Py_ssize_t count, Py_ssize_t rank) noexcept nogil:
    """The key of a rank; no two are equal."""
    cdef Py_ssize_t low = 0, high = count - 1, i, j
    cdef uint64_t pivot, other
    while low < high:
        pivot = keys[low + (high - low) // 2]
        i = low
        j = high
        while i <= j:
            while keys[i] < pivot:
                i += 1
            while keys[j] > pivot:
                j -= 1
            if i <= j:
                other = keys[i]
                keys[i] = keys[j]
                keys[j] = other
                i += 1
                j -= 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return keys[rank]


def median_places(const int32_t[::1] cell, const float[::1] values, Py_ssize_t cells):
    cdef Py_ssize_t count = cell.shape[0], n, c, first, size, found = 0
    if count != values.shape[0]:
        raise ValueError(f"{values.shape[0]} values in {count} places of {cells} cells")
    for n in range(count):
        if not 0 <= cell[n] < cells:
            raise ValueError(f"{values.shape[0]} values in {count} places of {cells} cells")
    cdef int64_t[::1] end = np.zeros(cells + 1, np.int64)
    cdef int64_t[::1] places = np.empty(min(count, cells), np.int64), counts = np.empty(min(count, cells), np.int64)
    cdef uint64_t* keys = <uint64_t*>malloc((count + 1) * sizeof(uint64_t))
    if not keys:
        raise MemoryError
    with nogil:
        for n in range(count):
            end[cell[n] + 1] += 1
        for c in range(cells):
            end[c + 1] += end[c]
        for n in range(count):
            c = cell[n]
            keys[end[c]] = _key(values[n], n)
            end[c] += 1  # from the cell's first place to the next cell's, by and by
        first = 0
        for c in range(cells):
            size = end[c] - first
            if size:
                places[found] = <uint32_t>_select(keys + first, size, (size - 1) // 2)
                counts[found] = size
                found += 1
            first = end[c]
    free(keys)
    return np.asarray(places)[:found], np.asarray(counts)[:found]
