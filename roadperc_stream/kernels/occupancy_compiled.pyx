# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Points counted in the cells of a grid; ``occupancy_plain`` documents the function.

Blocks of a row first compute points, heights and cells in loops that become vector code, then count them.
"""

from libc.float cimport FLT_MAX
from libc.math cimport fabsf
from libc.stdint cimport int32_t, int64_t, uint8_t

import numpy as np

cdef enum:
    DRIVABLE = 1
    MOST = 256

cdef struct Rules:
    float x_min, y_min, resolution, lowest, highest
    int32_t columns, rows

cdef struct Vector:
    float x, y, z

cdef struct Road:
    float a, b, d

cdef struct Points:  # arrays of neighbouring pixels, so that loops over them become vector code
    float depth[MOST]
    float x[MOST]
    float y[MOST]
    float height[MOST]
    int32_t drivable[MOST]
    int32_t obstacle[MOST]
    int32_t place[MOST]
    int32_t kind[MOST]


cdef void _point(
    Points* points, const float* x, const float* y, const float* z, Vector row, Vector centre, Road road, int count
) noexcept nogil:
    """Compute the points at their depths, and their heights above a plane, of one row."""
    cdef int k
    cdef float at_z
    for k in range(count):
        points.x[k] = (row.x + x[k]) * points.depth[k] + centre.x
        points.y[k] = (row.y + y[k]) * points.depth[k] + centre.y
        at_z = (row.z + z[k]) * points.depth[k] + centre.z
        points.height[k] = at_z - ((road.d - road.a * points.x[k]) - road.b * points.y[k])


cdef bint _any_counts(const Rules* rules, const Points* points, int count) noexcept nogil:
    """Return whether any point is drivable or not above all obstacles: most points of a block of sky are neither."""
    cdef int k
    cdef int32_t found = 0
    for k in range(count):
        found |= points.drivable[k] | (points.height[k] <= rules.highest)
    return found != 0


cdef bint _sort(const Rules* rules, Points* points, int count) noexcept nogil:
    """Compute the cell and the kind of each point; both are 0 outside the grid. Return whether any point counts."""
    cdef int k
    cdef int32_t kind, inside, kinds = 0
    cdef float i, j, height
    for k in range(count):
        height = points.height[k]
        kind = points.drivable[k] & (fabsf(height) <= FLT_MAX)
        kind |= (((height >= rules.lowest) | points.obstacle[k]) & (height <= rules.highest)) << 1
        i = (points.x[k] - rules.x_min) / rules.resolution
        j = (points.y[k] - rules.y_min) / rules.resolution
        inside = (i >= 0) & (i < rules.columns) & (j >= 0) & (j < rules.rows)
        i = i if inside else <float>0.0
        j = j if inside else <float>0.0
        points.place[k] = <int32_t>j * rules.columns + <int32_t>i  # truncation is floor for these numbers
        points.kind[k] = kind if inside else 0
        kinds |= points.kind[k]
    return kinds != 0


cdef void _count(const Points* points, int64_t* free, int64_t* occupied, int count) noexcept nogil:
    """Add the points to the counts; neighbours of one cell are added together."""
    cdef int k
    cdef int32_t place = 0, on_road = 0, obstacles = 0
    for k in range(count):
        if points.place[k] != place:
            free[place] += on_road
            occupied[place] += obstacles
            place, on_road, obstacles = points.place[k], 0, 0
        on_road += points.kind[k] & DRIVABLE
        obstacles += points.kind[k] >> 1
    free[place] += on_road
    occupied[place] += obstacles


def count_points(cells, pixels, rays, const float[::1] abd, int64_t[:, ::1] free, int64_t[:, ::1] occupied):
    cdef const float[:, :] depth_m = pixels[0], height_m = pixels[1]
    cdef const uint8_t[:, :] drivable = pixels[2], tags = pixels[3]
    cdef const uint8_t[::1] obstacle_tags = pixels[4]
    cdef const float[:, ::1] column = rays[0], parts = rays[1]
    cdef const float[::1] start = rays[2]
    cdef Py_ssize_t height = depth_m.shape[0], width = depth_m.shape[1], v, u, first, block
    cdef bint is_plane = height_m is None
    cdef Rules rules
    cdef Road road
    cdef Points points
    cdef Vector row, centre
    cdef int count, k
    sizes = {image.shape for image in pixels[:4] if image is not None}
    parts_of = tuple([np.shape(each) for each in (*rays, abd, obstacle_tags)])
    if len(sizes) != 1 or parts_of != ((3, width), (3, height), (3,), (3,), (256,)):
        raise ValueError(f"{height}x{width} depths: expected rays, marks, tags and heights of the same size")
    if free.shape[0] != occupied.shape[0] or free.shape[1] != occupied.shape[1]:
        raise ValueError(f"counts of {np.shape(free)} and {np.shape(occupied)}: expected one shape")
    rules.x_min, rules.y_min, rules.resolution = cells.x_min, cells.y_min, cells.resolution
    rules.lowest, rules.highest = cells.min_height, cells.max_height
    rules.rows, rules.columns = free.shape[0], free.shape[1]
    if not free.size or not width:
        return
    road = Road(abd[0], abd[1], abd[2])
    centre = Vector(start[0], start[1], start[2])
    with nogil:
        for v in range(height):
            row.x, row.y, row.z = parts[0, v], parts[1, v], parts[2, v]
            for block in range((width + MOST - 1) // MOST):
                first = block * MOST
                count = <int>min(width - first, <Py_ssize_t>MOST)
                for k in range(count):
                    u = first + k
                    points.depth[k] = depth_m[v, u]
                    points.drivable[k] = drivable[v, u]
                _point(
                    &points, &column[0, first], &column[1, first], &column[2, first], row, centre, road, count
                )
                for k in range(0 if is_plane else count):
                    points.height[k] = height_m[v, first + k]
                if not _any_counts(&rules, &points, count):
                    continue
                for k in range(count):
                    points.obstacle[k] = obstacle_tags[tags[v, first + k]]
                if _sort(&rules, &points, count):
                    _count(&points, &free[0, 0], &occupied[0, 0], count)
