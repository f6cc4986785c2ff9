# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Patches of one image aligned with another one, as ``patches_plain`` has them: the same sums, in its order."""

from libc.math cimport sqrt
from libc.stdint cimport uint8_t

from roadperc_stream.core.kernels.patches_plain import require_belonging

cdef enum:
    REACH_PX = 5
    SIDE = 2 * REACH_PX + 1
    WIDE = SIDE + 2
    PIXELS = SIDE * SIDE
    MOST = WIDE * WIDE

cdef double FLAT = 1e-3

cdef struct Levels:
    const uint8_t* at
    Py_ssize_t height, width

cdef struct Patch:
    double template[PIXELS]
    double gx[PIXELS]
    double gy[PIXELS]
    double xx, xy, yy, power


cdef struct Places:
    int column[MOST]
    int row[MOST]
    double x[MOST]
    double y[MOST]


cdef void _placed(double* px, int* whole, double last, int count) noexcept nogil:
    """Pixels, kept to the image, NaN to its edge, as whole ones and the rest, which stays."""
    cdef double at
    cdef int k
    for k in range(count):
        at = px[k] if px[k] > 0 else 0.0
        at = at if at < last else last
        whole[k] = <int>at
        px[k] = at - whole[k]


cdef void _sampled(const Levels* image, Places* places, int count, double* found) noexcept nogil:
    """Grey levels at pixels, linear between them: in turns of one kind of work each, which become vectors."""
    cdef int upper[MOST]
    cdef int lower[MOST]
    cdef int upper_step[MOST]
    cdef int lower_step[MOST]
    cdef const uint8_t* row
    cdef Py_ssize_t next_row
    cdef int k, beside, last_column = <int>image.width - 1, last_row = <int>image.height - 1
    cdef double above, below
    _placed(places.x, places.column, last_column, count)
    _placed(places.y, places.row, last_row, count)
    for k in range(count):
        row = image.at + places.row[k] * image.width + places.column[k]
        next_row = image.width if places.row[k] < last_row else 0
        beside = places.column[k] < last_column
        upper[k] = row[0]
        upper_step[k] = row[beside] - upper[k]
        lower[k] = row[next_row]
        lower_step[k] = row[next_row + beside] - lower[k]
    for k in range(count):
        above = upper[k] + places.x[k] * upper_step[k]
        below = lower[k] + places.x[k] * lower_step[k]
        found[k] = above + places.y[k] * (below - above)


cdef void _centre(double* levels) noexcept nogil:
    cdef double total = 0
    cdef int k
    for k in range(PIXELS):
        total += levels[k]
    total /= PIXELS
    for k in range(PIXELS):
        levels[k] -= total


cdef double _product(const double* a, const double* b) noexcept nogil:
    cdef double total = 0
    cdef int k
    for k in range(PIXELS):
        total += a[k] * b[k]
    return total


cdef void _cut(const Levels* image, double x, double y, Patch* patch) noexcept nogil:
    """The patch around a pixel, and what its shift changes."""
    cdef Places places
    cdef double around[MOST]
    cdef int row, column, k, at
    for row in range(WIDE):
        for column in range(WIDE):
            places.x[row * WIDE + column] = x + (column - REACH_PX - 1)
            places.y[row * WIDE + column] = y + (row - REACH_PX - 1)
    _sampled(image, &places, MOST, around)
    for row in range(SIDE):
        for column in range(SIDE):
            k = row * SIDE + column
            at = (row + 1) * WIDE + column + 1
            patch.template[k] = around[at]
            patch.gx[k] = 0.5 * (around[at + 1] - around[at - 1])
            patch.gy[k] = 0.5 * (around[at + WIDE] - around[at - WIDE])
    _centre(patch.template)
    _centre(patch.gx)
    _centre(patch.gy)
    patch.xx = _product(patch.gx, patch.gx) + FLAT
    patch.xy = _product(patch.gx, patch.gy)
    patch.yy = _product(patch.gy, patch.gy) + FLAT
    patch.power = _product(patch.template, patch.template)


cdef void _stretched(const Levels* image, const double* px, const double* stretch, double* found) noexcept nogil:
    """The grey levels of a stretched patch around a pixel."""
    cdef Places places
    cdef int row, column
    cdef double right, down
    for row in range(SIDE):
        for column in range(SIDE):
            right = column - REACH_PX
            down = row - REACH_PX
            places.x[row * SIDE + column] = px[0] + (stretch[0] * right + stretch[1] * down)
            places.y[row * SIDE + column] = px[1] + (stretch[2] * right + stretch[3] * down)
    _sampled(image, &places, PIXELS, found)


cdef void _shift(const Levels* image, const Patch* patch, const double* stretch, double* px) noexcept nogil:
    """One step of the search."""
    cdef double found[PIXELS]
    cdef double error, x = 0, y = 0, determinant = patch.xx * patch.yy - patch.xy * patch.xy, shift_x, shift_y
    cdef int k
    _stretched(image, px, stretch, found)
    for k in range(PIXELS):
        error = found[k] - patch.template[k]
        x += patch.gx[k] * error
        y += patch.gy[k] * error
    shift_x = (patch.yy * x - patch.xy * y) / determinant
    shift_y = (patch.xx * y - patch.xy * x) / determinant
    px[0] -= stretch[0] * shift_x + stretch[1] * shift_y
    px[1] -= stretch[2] * shift_x + stretch[3] * shift_y


cdef double _correlation(const Levels* image, const Patch* patch, const double* stretch, const double* px) noexcept nogil:
    cdef double found[PIXELS]
    _stretched(image, px, stretch, found)
    _centre(found)
    return _product(found, patch.template) / sqrt(_product(found, found) * patch.power + FLAT)


def align_patches(
    const uint8_t[:, ::1] before,
    const double[:, ::1] before_px,
    const double[:, :, ::1] stretch,
    const uint8_t[:, ::1] after,
    double[:, ::1] px,
    double[::1] correlation,
    int iterations,
):
    cdef Py_ssize_t count = correlation.shape[0], i
    cdef Levels first, second
    cdef Patch patch
    cdef int step
    require_belonging(
        (before.shape[0], before.shape[1]),
        (before_px.shape[0], before_px.shape[1]),
        (stretch.shape[0], stretch.shape[1], stretch.shape[2]),
        (after.shape[0], after.shape[1]),
        (px.shape[0], px.shape[1]),
        (count,),
    )
    first = Levels(&before[0, 0], before.shape[0], before.shape[1])
    second = Levels(&after[0, 0], after.shape[0], after.shape[1])
    with nogil:
        for i in range(count):
            _cut(&first, before_px[i, 0], before_px[i, 1], &patch)
            for step in range(iterations):
                _shift(&second, &patch, &stretch[i, 0, 0], &px[i, 0])
            correlation[i] = _correlation(&second, &patch, &stretch[i, 0, 0], &px[i, 0])
