# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Medians of cells, and normal equations; ``surface_plain`` documents the functions.

Medians use Hoare's quickselect (1961) on keys, unsigned numbers in the order of value and index.
"""

from libc.stdint cimport int32_t, int64_t, uint32_t, uint64_t
from libc.stdlib cimport free, malloc
from libc.string cimport memcpy

import numpy as np


cdef inline uint64_t _key(float value, Py_ssize_t place) noexcept nogil:
    """A key in the order of value and index: flipped bits order negative floats; adding 0 makes -0 equal 0."""
    cdef uint32_t bits
    value = value + <float>0.0
    memcpy(&bits, &value, sizeof(bits))
    bits = ~bits if bits >> 31 else bits | (<uint32_t>1 << 31)
    return (<uint64_t>bits << 32) | <uint64_t>place


cdef uint64_t _select(uint64_t* keys, Py_ssize_t count, Py_ssize_t rank) noexcept nogil:
    """The key of a rank; all keys differ."""
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
    if count != values.shape[0] or (count and not 0 <= np.min(cell) <= np.max(cell) < cells):
        raise ValueError(f"{values.shape[0]} values: expected the index of one of {cells} cells for each, got {count}")
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
            end[c] += 1
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


def normal_equations(
    const Py_ssize_t[:] first, const double[:, ::1] values, const double[:] weights, const double[:] targets,
    Py_ssize_t count,
):
    cdef Py_ssize_t equations = values.shape[0], unknowns = values.shape[1], n, i, j, at
    cdef double weight, pull
    if not first.shape[0] == weights.shape[0] == targets.shape[0] == equations:
        raise ValueError(f"{equations} equations: expected as many numbers of each kind, got {first.shape[0]} first "
                         f"unknowns, {weights.shape[0]} weights, {targets.shape[0]} targets")
    for n in range(equations):
        if not 0 <= first[n] <= count - unknowns:
            raise ValueError(f"unknowns {first[n]} to {first[n] + unknowns - 1}: expected 0 to {count - 1}")
    cdef double[:, ::1] lower = np.zeros((unknowns, count))
    cdef double[::1] right = np.zeros(count)
    with nogil:
        for n in range(equations):
            at, weight = first[n], weights[n]
            pull = weight * targets[n]
            for i in range(unknowns):
                right[at + i] += pull * values[n, i]
                for j in range(i + 1):
                    lower[i - j, at + j] += weight * (values[n, i] * values[n, j])
    return np.asarray(lower), np.asarray(right)


def solve_band(const double[:, ::1] lower, const double[:] right):
    cdef Py_ssize_t diagonals = lower.shape[0], count = lower.shape[1], j, b, c, reach
    cdef bint solvable = True
    cdef double factor
    if right.shape[0] != count:
        raise ValueError(f"{count} unknowns: expected as many right sides, got {right.shape[0]}")
    cdef double[:, ::1] rest = np.array(lower)
    cdef double[::1] x = np.array(right)
    with nogil:
        for j in range(count):
            if not rest[0, j] > 0:
                solvable = False
                break
            reach = min(diagonals, count - j)
            for b in range(1, reach):
                factor = rest[b, j] / rest[0, j]
                for c in range(b, reach):
                    rest[c - b, j + b] -= factor * rest[c, j]
                x[j + b] -= factor * x[j]
                rest[b, j] = factor
        if solvable:
            for j in range(count - 1, -1, -1):
                x[j] = x[j] / rest[0, j]
                for b in range(1, min(diagonals, count - j)):
                    x[j] -= rest[b, j] * x[j + b]
    return np.asarray(x) if solvable else None
