"""The assignment problem: one-to-one pairs with the largest total score."""

import math
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float

_TIE: Final = 1e-9
"""Difference of totals below which rounding may change the order."""
_ROUNDS: Final = 4
"""Most frames need two; an unbounded number would take seconds for thousands of crafted boxes."""
_MOST_SETS: Final = 512
"""Largest number of rows in doubt, times sets of columns in doubt, for which no import is worth its time."""


def largest_total(scores: Float) -> dict[int, int]:
    """The column of each row: the one-to-one pairs with the largest total of (M, N) scores, which are not negative.

    Pairs with score 0 are left out. Of equal totals, earlier rows get their first columns. If many pairs are in
    doubt, scipy decides; most logs do not need its import, which takes half a second and 40 MB.
    """
    found, left = dict[int, int](), scores.copy()
    for _ in range(_ROUNDS):
        if not (left > 0).any():
            break
        # A pair that scores more than its row and its column could score with others is in the best assignment.
        rows, columns = np.nonzero(left > _best_of_others(left) + _best_of_others(left.T).T + _TIE)
        found.update(zip(rows.tolist(), columns.tolist(), strict=True))
        left[rows], left[:, columns] = 0.0, 0.0
    many_rows, many_columns = (int(np.count_nonzero(left.any(axis=axis))) for axis in (1, 0))
    is_little = many_rows * 2**many_columns <= _MOST_SETS
    return dict(sorted((found | (_by_sets(left) if is_little else _by_scipy(left))).items()))


def _best_of_others(scores: Float) -> Float:
    """(M, N) largest other score of the same row, at least 0."""
    second, first = np.sort(np.hstack((np.zeros((len(scores), 2)), scores)), axis=1)[:, -2:, None].transpose(1, 0, 2)
    others: Float = np.where(scores == first, second, first)
    return others


def _by_sets(scores: Float) -> dict[int, int]:
    """The best one-to-one selection: row by row, the best one for each set of columns that it takes."""
    rows, none = np.flatnonzero(scores.any(axis=1)).tolist(), scores.shape[1]
    best: dict[frozenset[int], tuple[int, ...]] = {frozenset(): ()}

    def rank(chosen: tuple[int, ...]) -> tuple[float, list[int]]:
        total = math.fsum(scores[row, column] for row, column in zip(rows, chosen, strict=False) if column != none)
        return total, [-column for column in chosen]

    for row in rows:
        longer: dict[frozenset[int], tuple[int, ...]] = {}
        for taken, chosen in best.items():
            for column in {*np.flatnonzero(scores[row]).tolist(), none} - taken:
                key, more = (taken | {column}) - {none}, (*chosen, column)
                if key not in longer or rank(more) > rank(longer[key]):
                    longer[key] = more
        best = longer
    selected: tuple[int, ...] = max(best.values(), key=rank)
    return {row: column for row, column in zip(rows, selected, strict=True) if column != none}


def _by_scipy(scores: Float) -> dict[int, int]:
    from scipy.optimize import linear_sum_assignment

    pairs = zip(*(places.tolist() for places in linear_sum_assignment(scores, maximize=True)), strict=True)
    return {row: column for row, column in pairs if scores[row, column] > 0}
