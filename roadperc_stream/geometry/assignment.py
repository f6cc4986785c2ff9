"""The assignment problem: one-to-one pairs with the largest total score."""

import math
from itertools import groupby, product
from operator import itemgetter
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float

_TIE: Final = 1e-9
"""Difference of totals below which rounding may change the order."""
_ROUNDS: Final = 4
"""Most frames need two; an unbounded number would take seconds for thousands of crafted boxes."""
_TRIALS: Final = 1000
"""At most 2 ms; four rows with four columns each have 625."""


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
    few = math.prod((np.count_nonzero(left, axis=1) + 1).tolist()) <= _TRIALS
    return dict(sorted((found | (_by_trial(left) if few else _by_scipy(left))).items()))


def _best_of_others(scores: Float) -> Float:
    """(M, N) largest other score of the same row, at least 0."""
    second, first = np.sort(np.pad(scores, ((0, 0), (2, 0))), axis=1)[:, -2:, None].transpose(1, 0, 2)
    others: Float = np.where(scores == first, second, first)
    return others


def _by_trial(scores: Float) -> dict[int, int]:
    """The best of all one-to-one selections of at most one pair per row."""
    scored = zip(*(places.tolist() for places in np.nonzero(scores)), strict=True)
    choices = ([*pairs, None] for _, pairs in groupby(scored, key=itemgetter(0)))
    selections = (dict(filter(None, pairs)) for pairs in product(*choices))
    one_to_one = (pairs for pairs in selections if len(set(pairs.values())) == len(pairs))
    return max(one_to_one, key=lambda pairs: math.fsum(scores[pair] for pair in pairs.items()))


def _by_scipy(scores: Float) -> dict[int, int]:
    from scipy.optimize import linear_sum_assignment

    pairs = zip(*(places.tolist() for places in linear_sum_assignment(scores, maximize=True)), strict=True)
    return {row: column for row, column in pairs if scores[row, column] > 0}
