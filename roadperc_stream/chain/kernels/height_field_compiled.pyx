# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Where rays first dip below a height field: ``geometry.ground`` has the same in numpy, operation by operation."""

from libc.math cimport NAN, fmax, fmin

cdef struct Field:
    const char* z
    Py_ssize_t rows, columns, row_bytes, column_bytes
    double x_min, y_min, step

cdef struct Ray:
    double x, y, z, dx, dy, dz

cdef struct Dip:
    double near, far, above, below


cdef inline double _within_cell(double share) noexcept nogil:
    return 0.0 if share < 0.0 else 1.0 if share > 1.0 else share


cdef inline double _node(const Field* field, Py_ssize_t row, Py_ssize_t column) noexcept nogil:
    return (<const float*>(field.z + row * field.row_bytes + column * field.column_bytes))[0]


cdef inline double _height(const Field* field, double x, double y) noexcept nogil:
    cdef double u = (x - field.x_min) / field.step, v = (y - field.y_min) / field.step
    cdef Py_ssize_t cells_x = max(field.columns - 1, 1), cells_y = max(field.rows - 1, 1)
    cdef Py_ssize_t i = <Py_ssize_t>fmin(fmax(u, 0.0), <double>(cells_x - 1))
    cdef Py_ssize_t j = <Py_ssize_t>fmin(fmax(v, 0.0), <double>(cells_y - 1))
    cdef Py_ssize_t next_i = min(i + 1, field.columns - 1), next_j = min(j + 1, field.rows - 1)
    cdef double corner = _node(field, j, i)
    cdef double along = _node(field, j, next_i) - corner
    cdef double across = _node(field, next_j, i) - corner
    cdef double twist = (_node(field, next_j, next_i) - _node(field, next_j, i)) - along
    cdef double inside_u, inside_v
    u = u - i
    v = v - j
    inside_u = _within_cell(u)
    inside_v = _within_cell(v)
    return corner + along * u + across * v + twist * (u * inside_v + inside_u * (v - inside_v))


cdef inline double _gap(const Field* field, const Ray* ray, double depth) noexcept nogil:
    cdef double height = _height(field, ray.x + ray.dx * depth, ray.y + ray.dy * depth)
    return ray.z + ray.dz * depth - height


cdef inline bint _dips(const Field* field, const Ray* ray, const double[::1] depths, Dip* dip) noexcept nogil:
    """Whether a ray dips below the field between two of some depths."""
    cdef Py_ssize_t k
    cdef double gap
    for k in range(depths.shape[0]):
        gap = _gap(field, ray, depths[k])
        if gap <= 0:
            dip.far = depths[k]
            dip.below = gap
            return k > 0
        dip.near = depths[k]
        dip.above = gap
    return False


cdef inline bint _dips_between(const Field* field, const Ray* ray, const double[::1] parts, Dip* dip) noexcept nogil:
    """The same between parts of the stretch in which it dipped."""
    cdef Py_ssize_t k
    cdef double near = dip.near, far = dip.far, depth, gap
    for k in range(parts.shape[0]):
        depth = near * (1.0 - parts[k]) + far * parts[k]
        gap = _gap(field, ray, depth)
        if gap <= 0:
            dip.far = depth
            dip.below = gap
            return k > 0
        dip.near = depth
        dip.above = gap
    return False


def first_meetings(
    grid, const double[:] centre, const double[:, :] directions, const double[::1] tried, const double[::1] parts,
    int refinements, double[::1] depths,
):
    """Write the depths at which rays first dip below the field, NaN where they never do.

    Args:
        grid: a height grid.
        centre: (3,) where the rays begin, ego frame.
        directions: (N, 3) of the rays.
        tried: depths at which a ray is tested, ascending.
        parts: of the stretch where it dipped, tested again, from 0 to 1.
        refinements: how often that is done.
        depths: (N,) written.

    Raises:
        ValueError: a grid without nodes, directions of other than three numbers, or not as many depths.
    """
    cdef const float[:, :] z = grid.z_m
    cdef Py_ssize_t n, r
    cdef bint met
    cdef Ray ray
    cdef Dip dip
    if not z.shape[0] or not z.shape[1] or centre.shape[0] != 3 or directions.shape[1] != 3:
        raise ValueError(f"a grid of {z.shape[0]}x{z.shape[1]}, rays of {directions.shape[1]} numbers")
    if depths.shape[0] != directions.shape[0]:
        raise ValueError(f"{directions.shape[0]} rays, {depths.shape[0]} depths")
    cdef Field field = Field(
        <const char*>&z[0, 0], z.shape[0], z.shape[1], z.strides[0], z.strides[1], grid.x_min_m, grid.y_min_m, grid.step_m
    )
    with nogil:
        for n in range(directions.shape[0]):
            ray = Ray(centre[0], centre[1], centre[2], directions[n, 0], directions[n, 1], directions[n, 2])
            dip = Dip(NAN, NAN, NAN, NAN)
            met = _dips(&field, &ray, tried, &dip)
            for r in range(refinements):
                met = met and _dips_between(&field, &ray, parts, &dip)
            depths[n] = dip.near + (dip.far - dip.near) * dip.above / (dip.above - dip.below) if met else NAN
