"""The assignment problem: one-to-one pairs with the largest total score.

Usually the pairs split into groups of two or three, and trying all combinations is enough. Otherwise scipy solves it;
its import takes half a second.
"""

from collections.abc import Iterable
from itertools import product
from math import fsum, prod

import numpy as np

from roadperc_stream.geometry import Float

_MOST_PAIRS = 512
"""Largest number of candidate pairs that are split into groups."""
_MOST_WAYS = 512
"""Largest number of combinations tried per group."""
_TIE = 1e-9
"""Difference of totals below which rounding may change the order; scipy then solves the problem."""

Pair = tuple[int, int]


def largest_total(scores: Float) -> dict[int, int]:
    """The column of each row: the one-to-one pairs with the largest total of (M, N) scores, which are not negative.

    Pairs with score 0 are left out. Equal totals are decided as by ``scipy.optimize.linear_sum_assignment``.
    """
    best = scores.max(axis=1, initial=0.0)
    rows, columns = np.nonzero((scores == best[:, None]) & (best[:, None] > 0))
    if len(np.unique(rows)) == len(rows) and len(np.unique(columns)) == len(columns):
        return dict(zip(rows.tolist(), columns.tolist(), strict=True))
    return _of_groups(scores) or _of_all(scores)


def _of_all(scores: Float) -> dict[int, int]:
    from scipy.optimize import linear_sum_assignment

    pairs = zip(*(places.tolist() for places in linear_sum_assignment(scores, maximize=True)), strict=True)
    return {row: column for row, column in pairs if scores[row, column] > 0}


def _of_groups(scores: Float) -> dict[int, int] | None:
    """The pairs found by trying all combinations; None if they are too many or the best is not unique."""
    rows, columns = np.nonzero(scores > 0)
    if len(rows) > _MOST_PAIRS:
        return None
    found: dict[int, int] = {}
    for group in _groups(zip(rows.tolist(), columns.tolist(), strict=True)):
        best = _best(scores, group)
        if best is None:
            return None
        found.update(best)
    return dict(sorted(found.items()))


def _groups(pairs: Iterable[Pair]) -> list[list[Pair]]:
    """The pairs in groups; pairs that share a row or column are in one group."""
    of_row: dict[int, list[Pair]] = {}
    of_column: dict[int, list[Pair]] = {}
    for row, column in pairs:
        ours, theirs = of_row.get(row, []), of_column.get(column, [])
        joined = [*ours, *(theirs if theirs is not ours else []), (row, column)]
        for r, c in joined:
            of_row[r] = of_column[c] = joined
    return list({id(group): group for group in of_row.values()}.values())


def _best(scores: Float, group: list[Pair]) -> list[Pair] | None:
    """The pairs of a group with the largest total; None if it is not unique."""
    choices: dict[int, list[int | None]] = {}
    for row, column in group:
        choices.setdefault(row, [None]).append(column)
    if prod(len(columns) for columns in choices.values()) > _MOST_WAYS:
        return None
    totals = []
    for way in product(*choices.values()):
        pairs = [(row, column) for row, column in zip(choices, way, strict=True) if column is not None]
        if len({column for _, column in pairs}) == len(pairs):
            totals.append((fsum(scores[pair] for pair in pairs), pairs))
    totals.sort(reverse=True)
    return totals[0][1] if totals[0][0] - totals[1][0] > _TIE else None
