# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Patches aligned with an image; ``odometry_plain`` documents the function."""

from libc.math cimport fabs, sqrt
from libc.stdint cimport uint8_t

import numpy as np

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

cdef struct Stretched:
    double across[PIXELS]
    double along[PIXELS]
    double reach_x, reach_y

cdef struct Places:
    int column[MOST]
    int row[MOST]
    double x[MOST]
    double y[MOST]


cdef void _placed(double* px, int* whole, double last, int count) noexcept nogil:
    """Clip coordinates to the image (NaN to 0), and split them into whole pixels and the rest."""
    cdef double at
    cdef int k
    for k in range(count):
        at = px[k] if px[k] > 0 else 0.0
        at = at if at < last else last
        whole[k] = <int>at
        px[k] = at - whole[k]


cdef void _sampled(const Levels* image, Places* places, int count, bint is_inside, double* found) noexcept nogil:
    """Interpolate grey levels linearly, in separate loops that become vector code.

    With ``is_inside`` all pixels lie inside the image, none on its edge, and are not clipped.
    """
    cdef int upper[MOST]
    cdef int lower[MOST]
    cdef int upper_step[MOST]
    cdef int lower_step[MOST]
    cdef const uint8_t* row
    cdef Py_ssize_t next_row
    cdef int k, beside, last_column = <int>image.width - 1, last_row = <int>image.height - 1
    cdef double above, below
    if is_inside:
        for k in range(count):
            places.column[k] = <int>places.x[k]
            places.x[k] -= places.column[k]
        for k in range(count):
            places.row[k] = <int>places.y[k]
            places.y[k] -= places.row[k]
        for k in range(count):
            row = image.at + places.row[k] * image.width + places.column[k]
            upper[k] = row[0]
            upper_step[k] = row[1] - upper[k]
            lower[k] = row[image.width]
            lower_step[k] = row[image.width + 1] - lower[k]
    else:
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


cdef bint _is_inside(const Levels* image, double x, double y, double reach_x, double reach_y) noexcept nogil:
    """Whether all pixels within reach lie at least a pixel from the image's edge; False for NaN."""
    return (
        x - reach_x >= 1 and y - reach_y >= 1 and x + reach_x <= image.width - 3 and y + reach_y <= image.height - 3
    )


cdef void _centre(double* levels) noexcept nogil:
    cdef double total = 0
    cdef int k
    for k in range(PIXELS):
        total += levels[k]
    total /= PIXELS
    for k in range(PIXELS):
        levels[k] -= total


cdef void _centre_patch(Patch* patch) noexcept nogil:
    """Subtract the means of template and gradients; the three sums run in parallel."""
    cdef double levels = 0, x = 0, y = 0
    cdef int k
    for k in range(PIXELS):
        levels += patch.template[k]
        x += patch.gx[k]
        y += patch.gy[k]
    levels /= PIXELS
    x /= PIXELS
    y /= PIXELS
    for k in range(PIXELS):
        patch.template[k] -= levels
        patch.gx[k] -= x
        patch.gy[k] -= y


cdef void _multiply_patch(Patch* patch) noexcept nogil:
    """Sum the products of template and gradients."""
    cdef double xx = 0, xy = 0, yy = 0, power = 0
    cdef int k
    for k in range(PIXELS):
        xx += patch.gx[k] * patch.gx[k]
        xy += patch.gx[k] * patch.gy[k]
        yy += patch.gy[k] * patch.gy[k]
        power += patch.template[k] * patch.template[k]
    patch.xx = xx + FLAT
    patch.xy = xy
    patch.yy = yy + FLAT
    patch.power = power


cdef void _cut(const Levels* image, double x, double y, Patch* patch) noexcept nogil:
    """Cut the patch around a pixel, with its gradients."""
    cdef Places places
    cdef double around[MOST]
    cdef int row, column, k, at
    for row in range(WIDE):
        for column in range(WIDE):
            places.x[row * WIDE + column] = x + (column - REACH_PX - 1)
            places.y[row * WIDE + column] = y + (row - REACH_PX - 1)
    _sampled(image, &places, MOST, _is_inside(image, x, y, REACH_PX + 1, REACH_PX + 1), around)
    for row in range(SIDE):
        for column in range(SIDE):
            k = row * SIDE + column
            at = (row + 1) * WIDE + column + 1
            patch.template[k] = around[at]
            patch.gx[k] = 0.5 * (around[at + 1] - around[at - 1])
            patch.gy[k] = 0.5 * (around[at + WIDE] - around[at - WIDE])
    _centre_patch(patch)
    _multiply_patch(patch)


cdef void _stretch(const double* stretch, Stretched* stretched) noexcept nogil:
    cdef int row, column
    cdef double right, down
    for row in range(SIDE):
        for column in range(SIDE):
            right = column - REACH_PX
            down = row - REACH_PX
            stretched.across[row * SIDE + column] = stretch[0] * right + stretch[1] * down
            stretched.along[row * SIDE + column] = stretch[2] * right + stretch[3] * down
    stretched.reach_x = REACH_PX * (fabs(stretch[0]) + fabs(stretch[1]))
    stretched.reach_y = REACH_PX * (fabs(stretch[2]) + fabs(stretch[3]))


cdef void _found(const Levels* image, const double* px, const Stretched* stretched, double* found) noexcept nogil:
    """Sample the grey levels of a stretched patch around a pixel."""
    cdef Places places
    cdef int k
    for k in range(PIXELS):
        places.x[k] = px[0] + stretched.across[k]
    for k in range(PIXELS):
        places.y[k] = px[1] + stretched.along[k]
    _sampled(image, &places, PIXELS, _is_inside(image, px[0], px[1], stretched.reach_x, stretched.reach_y), found)


cdef double _shift(
    const Levels* image, const Patch* patch, const Stretched* stretched, const double* stretch, double* px
) noexcept nogil:
    """Move the pixel by one Gauss-Newton step; its squared length."""
    cdef double found[PIXELS]
    cdef double error, x = 0, y = 0, determinant = patch.xx * patch.yy - patch.xy * patch.xy, shift_x, shift_y
    cdef double step_x, step_y
    cdef int k
    _found(image, px, stretched, found)
    for k in range(PIXELS):
        error = found[k] - patch.template[k]
        x += patch.gx[k] * error
        y += patch.gy[k] * error
    shift_x = (patch.yy * x - patch.xy * y) / determinant
    shift_y = (patch.xx * y - patch.xy * x) / determinant
    step_x = stretch[0] * shift_x + stretch[1] * shift_y
    step_y = stretch[2] * shift_x + stretch[3] * shift_y
    px[0] -= step_x
    px[1] -= step_y
    return step_x * step_x + step_y * step_y


cdef double _correlation(
    const Levels* image, const Patch* patch, const Stretched* stretched, const double* px
) noexcept nogil:
    cdef double found[PIXELS]
    cdef double product = 0, power = 0
    cdef int k
    _found(image, px, stretched, found)
    _centre(found)
    for k in range(PIXELS):
        product += found[k] * patch.template[k]
        power += found[k] * found[k]
    return product / sqrt(power * patch.power + FLAT)


def align_patches(
    const uint8_t[:, ::1] before, const double[:, ::1] before_px, const double[:, :, ::1] stretch,
    const uint8_t[:, ::1] after, double[:, ::1] px, int iterations, double still_px,
):
    cdef Py_ssize_t count = px.shape[0], i
    cdef Levels first, second
    cdef Patch patch
    cdef Stretched stretched
    cdef int step
    shapes = tuple(map(np.shape, (before_px, stretch, px)))
    if shapes != ((count, 2), (count, 2, 2), (count, 2)) or not before.size * after.size:
        raise ValueError(f"patches of {shapes}: expected equally many of each, and images that are not empty")
    cdef double[::1] correlation = np.empty(count)
    first = Levels(&before[0, 0], before.shape[0], before.shape[1])
    second = Levels(&after[0, 0], after.shape[0], after.shape[1])
    with nogil:
        for i in range(count):
            _cut(&first, before_px[i, 0], before_px[i, 1], &patch)
            _stretch(&stretch[i, 0, 0], &stretched)
            for step in range(iterations):
                if _shift(&second, &patch, &stretched, &stretch[i, 0, 0], &px[i, 0]) < still_px * still_px:
                    break
            correlation[i] = _correlation(&second, &patch, &stretched, &px[i, 0])
    return np.asarray(correlation)
