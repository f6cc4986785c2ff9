# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Normal equations as a band, summed where they stand: one equation after the other."""

import numpy as np


def normal_equations(
    const Py_ssize_t[:] first, const double[:, ::1] values, const double[:] weights, const double[:] targets,
    Py_ssize_t count,
):
    """As ``bands_plain``.

    Raises:
        ValueError: as there.
    """
    cdef Py_ssize_t equations = values.shape[0], unknowns = values.shape[1], n, i, j, at
    cdef double weight, pull
    if not first.shape[0] == weights.shape[0] == targets.shape[0] == equations:
        raise ValueError(f"{equations} equations, {first.shape[0]} places, {weights.shape[0]} weights, "
                         f"{targets.shape[0]} targets")
    for n in range(equations):
        if not 0 <= first[n] <= count - unknowns:
            raise ValueError(f"unknowns {first[n]} to {first[n] + unknowns - 1} of {count}")
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
