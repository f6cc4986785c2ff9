# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Points in the cells of a grid, counted one by one: ``cell_counts_plain`` says which."""

from libc.math cimport isfinite
from libc.stdint cimport int64_t, uint8_t


def count_points(
    cells, const float[:, :] x, const float[:, :] y, const float[:, :] height, const uint8_t[:, :] drivable,
    const uint8_t[:, :] obstacles, int64_t[:, ::1] free, int64_t[:, ::1] occupied,
):
    cdef float x_min = cells.x_min, y_min = cells.y_min, resolution = cells.resolution
    cdef float lowest = cells.min_height, highest = cells.max_height, i, j
    cdef Py_ssize_t rows = free.shape[0], columns = free.shape[1], v, u
    cdef bint on_road, in_the_way
    if not x.shape[0] == y.shape[0] == height.shape[0] == drivable.shape[0] == obstacles.shape[0] or not (
        x.shape[1] == y.shape[1] == height.shape[1] == drivable.shape[1] == obstacles.shape[1]
    ):
        raise ValueError(f"{(x.shape[0], x.shape[1])} points of other sizes")
    if (occupied.shape[0], occupied.shape[1]) != (rows, columns):
        raise ValueError(f"counts of {(rows, columns)} and {(occupied.shape[0], occupied.shape[1])}")
    with nogil:
        for v in range(x.shape[0]):
            for u in range(x.shape[1]):
                on_road = drivable[v, u] and isfinite(height[v, u])
                in_the_way = (height[v, u] >= lowest or obstacles[v, u]) and height[v, u] <= highest
                if not on_road and not in_the_way:
                    continue
                i = (x[v, u] - x_min) / resolution
                j = (y[v, u] - y_min) / resolution
                if i >= 0 and i < columns and j >= 0 and j < rows:  # then what is cut off is what floor takes
                    free[<Py_ssize_t>j, <Py_ssize_t>i] += on_road
                    occupied[<Py_ssize_t>j, <Py_ssize_t>i] += in_the_way
