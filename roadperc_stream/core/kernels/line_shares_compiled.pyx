# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""How much of lines lies on a mask: it is looked at where a line runs, and nowhere else."""

import numpy as np

from libc.math cimport fabs, lrint
from libc.stdint cimport uint8_t


cdef inline bint _near(const uint8_t[:, :] mask, Py_ssize_t x, Py_ssize_t y, Py_ssize_t margin) noexcept nogil:
    """Whether the mask has a pixel there or so near."""
    cdef Py_ssize_t row, column
    if mask[y, x]:
        return True
    for row in range(max(y - margin, 0), min(y + margin + 1, mask.shape[0])):
        for column in range(max(x - margin, 0), min(x + margin + 1, mask.shape[1])):
            if mask[row, column]:
                return True
    return False


cdef double _share(
    double x, double y, double end_x, double end_y, const uint8_t[:, :] mask, Py_ssize_t margin
) noexcept nogil:
    cdef Py_ssize_t steps = <Py_ssize_t>max(fabs(end_x - x), fabs(end_y - y)), step, found
    cdef double along_x = (end_x - x) / max(steps, 1), along_y = (end_y - y) / max(steps, 1)
    found = _near(mask, lrint(end_x), lrint(end_y), margin)
    for step in range(steps):
        found += _near(mask, lrint(step * along_x + x), lrint(step * along_y + y), margin)
    return <double>found / <double>(steps + 1)


def line_shares(const double[:, :] lines, const uint8_t[:, :] mask, Py_ssize_t margin):
    """As ``line_shares_plain``.

    Raises:
        ValueError: as there.
    """
    cdef Py_ssize_t count = lines.shape[0], height = mask.shape[0], width = mask.shape[1], i
    for i in range(count):
        if not (0 <= lines[i, 0] <= width - 1 and 0 <= lines[i, 1] <= height - 1
                and 0 <= lines[i, 2] <= width - 1 and 0 <= lines[i, 3] <= height - 1):
            raise ValueError(f"expected lines in an image of {height}x{width}")
    all_shares = np.empty(count)
    cdef double[::1] shares = all_shares
    with nogil:
        for i in range(count):
            shares[i] = _share(lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3], mask, margin)
    return all_shares
