"""The assignment problem: one-to-one pairs with the largest total score.

Usually the pairs split into small groups, in which a best-first search (A*: Hart, Nilsson and Raphael 1968) takes a few
steps. Otherwise scipy solves it; its import takes half a second.
"""

from collections.abc import Iterable
from heapq import heappop, heappush
from itertools import count

import numpy as np

from roadperc_stream.geometry import Float

_MOST_PAIRS = 512
"""Largest number of candidate pairs that are split into groups."""
_MOST_STEPS = 512
"""Largest number of steps of the search in a group."""
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
    """The pairs found by a search in each group; None if it takes too long or the best is not unique."""
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
    """The pairs of a group with the largest total; None if it is not unique or the search takes too long."""
    choices: dict[int, list[int]] = {}
    for row, column in group:
        choices.setdefault(row, []).append(column)
    rows = sorted(choices, key=lambda row: len(choices[row]))
    highest = [max(scores.item(row, column) for column in choices[row]) for row in rows]
    rest = [sum(highest[k:]) for k in range(len(rows) + 1)]  # at most so much is added from row k on
    found: tuple[float, list[Pair]] | None = None
    number = count()
    # The highest possible total first: its negative, a number for equal ones, the total of k rows, k, and the pairs.
    waiting: list[tuple[float, int, float, int, list[Pair]]] = [(-rest[0], 0, 0.0, 0, [])]
    for _ in range(_MOST_STEPS):
        negative, _, total, k, pairs = heappop(waiting)
        if found is not None:
            return found[1] if found[0] + negative > _TIE else None
        if k == len(rows):
            found = total, pairs
            continue
        taken = [column for _, column in pairs]
        ways = [(total, pairs)]
        ways += [
            (total + scores.item(rows[k], column), [*pairs, (rows[k], column)])
            for column in choices[rows[k]]
            if column not in taken
        ]
        for after, chosen in ways:
            heappush(waiting, (-(after + rest[k + 1]), next(number), after, k + 1, chosen))
    return None
