# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Robust quadratics; ``lanes_plain`` documents the functions. Arrays of different lengths are a ValueError."""

from libc.math cimport fabs
from libc.stdint cimport int64_t
from libc.stdlib cimport free, malloc

import numpy as np

from roadperc_stream.kernels.lanes_plain import Quadratic

cdef enum:
    REWEIGHTINGS = 5

cdef double ROUNDING = 1e-9

cdef struct Sums:
    double one, x, q, xx, xq, qq, y, xy, qy

cdef struct Fit:
    double s0, s1, s2, spread, reached
    Sums sums


cdef struct Points:
    Py_ssize_t count
    const double* x
    const double* y
    const double* std
    const int64_t* rows
    const double* inside
    const double* outside

cdef struct Rules:
    double inward, reach, step, farthest
    bint innermost
    Py_ssize_t least_points, least_rows
    double huber, alike, prior

cdef struct Chosen:
    Py_ssize_t count
    Py_ssize_t* at
    double* in_row
    double* weight


cdef inline double _beside(const Points* points, const Fit* fit, Py_ssize_t i) noexcept nogil:
    """How far a point lies to the left of a quadratic, metres."""
    return points.y[i] - (fit.s0 + fit.s1 * points.x[i] + 0.5 * fit.s2 * (points.x[i] * points.x[i]))


cdef void _choose(const Points* points, const Fit* fit, const Rules* rules, double reach, Chosen* chosen) noexcept nogil:
    """Choose the points near a quadratic."""
    cdef Py_ssize_t i, found = 0
    cdef double aside, best = 0.0
    for i in range(points.count):
        if not points.x[i] <= reach:
            continue
        aside = rules.inward * _beside(points, fit, i)
        if not (aside < points.inside[i] and aside > -points.outside[i]):
            continue
        if rules.innermost and found and points.rows[chosen.at[found - 1]] == points.rows[i]:
            if aside > best:
                chosen.at[found - 1] = i
                best = aside
            continue
        chosen.at[found] = i
        best = aside
        found += 1
    chosen.count = found


cdef Py_ssize_t _share_rows(const Points* points, Chosen* chosen) noexcept nogil:
    """Return the number of rows of the chosen points, and count the points in the row of each."""
    cdef Py_ssize_t first = 0, last, rows = 0, k
    while first < chosen.count:
        last = first + 1
        while last < chosen.count and points.rows[chosen.at[last]] == points.rows[chosen.at[first]]:
            last += 1
        for k in range(first, last):
            chosen.in_row[k] = <double>(last - first)
        rows += 1
        first = last
    return rows


cdef bint _solve(Fit* fit, double prior) noexcept nogil:
    cdef Sums* s = &fit.sums
    cdef double by_x, by_q, xx, xq, qq, by_xq, y1, y2
    if not s.one > 0:
        return False
    by_x = s.x / s.one
    by_q = s.q / s.one
    xx = s.xx - by_x * s.x
    xq = s.xq - by_x * s.q
    if not xx > ROUNDING * s.xx:
        return False
    by_xq = xq / xx
    qq = (s.qq + prior) - by_q * s.q - by_xq * xq
    if not qq > ROUNDING * (s.qq + prior):
        return False
    y1 = s.xy - by_x * s.y
    y2 = s.qy - by_q * s.y - by_xq * y1
    fit.s2 = y2 / qq
    fit.s1 = (y1 - xq * fit.s2) / xx
    fit.s0 = (s.y - s.x * fit.s1 - s.q * fit.s2) / s.one
    return True


cdef bint _fit_chosen(const Points* points, Chosen* chosen, const Rules* rules, Fit* fit) noexcept nogil:
    """Fit the chosen points by iterative reweighting, starting from ``fit``; False if they do not determine it."""
    cdef Py_ssize_t k, i
    cdef double std, off, w, x, q, wx, wq
    cdef Sums sums
    for _ in range(REWEIGHTINGS):
        sums = Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for k in range(chosen.count):
            i = chosen.at[k]
            std = points.std[i]
            off = fabs(_beside(points, fit, i)) / std / rules.huber
            chosen.weight[k] = 1.0 / (std * std * (off if off > 1.0 else 1.0) * chosen.in_row[k])
            w = chosen.weight[k] / rules.alike
            x = points.x[i]
            q = 0.5 * (x * x)
            wx = w * x
            wq = w * q
            sums.one += w
            sums.x += wx
            sums.q += wq
            sums.xx += wx * x
            sums.xq += wx * q
            sums.qq += wq * q
            sums.y += w * points.y[i]
            sums.xy += wx * points.y[i]
            sums.qy += wq * points.y[i]
        fit.sums = sums
        if not _solve(fit, rules.prior):
            return False
    return True


cdef void _judge(const Points* points, const Chosen* chosen, Fit* fit) noexcept nogil:
    """Compute the largest x of the chosen points and their mean squared residual."""
    cdef Py_ssize_t k
    cdef double off
    cdef double squares = 0.0, weights = 0.0
    fit.reached = points.x[chosen.at[0]]
    for k in range(chosen.count):
        off = _beside(points, fit, chosen.at[k]) / points.std[chosen.at[k]]
        squares += off * off * chosen.weight[k]
        weights += chosen.weight[k]
        fit.reached = max(fit.reached, points.x[chosen.at[k]])
    fit.spread = squares / weights


cdef bint _followed(const Points* points, Chosen* chosen, const Rules* rules, Fit* fit) noexcept nogil:
    cdef double reach = rules.reach
    while True:
        _choose(points, fit, rules, reach, chosen)
        if chosen.count < rules.least_points or _share_rows(points, chosen) < rules.least_rows:
            return False
        if not _fit_chosen(points, chosen, rules, fit):
            return False
        if reach >= rules.farthest:
            _judge(points, chosen, fit)
            return True
        reach = min(reach + rules.step, rules.farthest)


cdef class _Arrays:
    """The pointers to the arrays of ``Points``, and references that keep the arrays alive."""

    cdef const double[::1] x, y, std, inside, outside
    cdef const int64_t[::1] rows
    cdef Points points

    def __init__(self, points):
        self.x, self.y, self.std, self.rows = points.x, points.y, points.std, points.rows
        self.inside, self.outside = points.inside, points.outside
        cdef Py_ssize_t count = self.x.shape[0]
        for length in (self.y.shape[0], self.std.shape[0], self.rows.shape[0], self.inside.shape[0],
                       self.outside.shape[0]):
            if length != count:
                raise ValueError(f"expected {count} numbers in every array, got {length}")
        self.points.count = count
        if count:
            self.points = Points(
                count, &self.x[0], &self.y[0], &self.std[0], &self.rows[0], &self.inside[0], &self.outside[0]
            )


def follow(points, first, following, weighing):
    cdef _Arrays arrays = _Arrays(points)
    cdef Py_ssize_t count = arrays.points.count
    if not count:
        return None
    cdef Rules rules = Rules(
        following.inward, following.reach, following.step, following.farthest, following.innermost,
        following.least_points, following.least_rows, weighing.huber, weighing.alike, weighing.prior,
    )
    cdef Fit fit
    fit.s0, fit.s1, fit.s2 = first
    cdef bint found
    cdef double* numbers = <double*>malloc(2 * count * sizeof(double))
    cdef Py_ssize_t* at = <Py_ssize_t*>malloc(count * sizeof(Py_ssize_t))
    cdef Chosen chosen = Chosen(0, at, numbers, numbers + count)
    try:
        if not numbers or not at:
            raise MemoryError
        with nogil:
            found = _followed(&arrays.points, &chosen, &rules, &fit)
    finally:
        free(numbers)
        free(at)
    if not found:
        return None
    s = fit.sums
    return Quadratic((fit.s0, fit.s1, fit.s2), (s.one, s.x, s.q, s.xx, s.xq, s.qq), fit.spread, fit.reached)
