"""Intervals of ratios on known numbers."""

import numpy as np
import pytest
from scipy.stats import wilcoxon

from roadperc_stream.tools.bench.compare import Ratio, ratio_of, signed_rank_probabilities


def test_probabilities_of_three_ranks():
    assert signed_rank_probabilities(3) * 8 == pytest.approx([1, 1, 1, 2, 1, 1, 1])


@pytest.mark.parametrize("count", [1, 6, 12])
def test_probabilities_are_those_of_wilcoxons_test(count):
    rng = np.random.default_rng(count)
    values = rng.normal(0.4, 1, count)
    ranks = np.argsort(np.argsort(np.abs(values))) + 1
    below = signed_rank_probabilities(count)[: int(ranks[values < 0].sum()) + 1].sum()
    assert wilcoxon(values, alternative="greater", method="exact").pvalue == pytest.approx(below)


def test_six_rounds_give_95_percent_with_all_of_them():
    """P(sum of ranks = 0) is 1/64 on either side."""
    ratio = ratio_of([1.0] * 6, [1.0, 1.1, 1.2, 1.3, 1.4, 1.5], 0.95)
    assert (ratio.low, ratio.high) == (pytest.approx(1.0), pytest.approx(1.5))
    assert 1.2 < ratio.middle < 1.3


def test_five_rounds_cannot():
    ratio = ratio_of([1.0] * 5, [1.1] * 5, 0.95)
    assert (ratio.low, ratio.high) == (0.0, np.inf)
    assert ratio.middle == pytest.approx(1.1)
    assert ratio.verdict(0.03) == "no difference shown"


def test_noise_that_both_share_is_none():
    base = [10.0, 30.0, 11.0, 25.0, 9.0, 14.0, 60.0, 10.0]
    ratio = ratio_of(base, [1.2 * value for value in base], 0.99)
    assert (ratio.low, ratio.middle, ratio.high) == pytest.approx((1.2, 1.2, 1.2))


def test_one_disturbed_round_moves_it_little():
    new = [1.05] * 9 + [9.0]
    assert ratio_of([1.0] * 10, new, 0.95).middle == pytest.approx(1.05)


def test_the_interval_holds_the_ratio_as_often_as_it_says():
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(1000):
        base, new = np.exp(0.05 * rng.standard_t(2, (2, 8)))
        ratio = ratio_of(base.tolist(), (1.1 * new).tolist(), 0.95)
        held += ratio.low <= 1.1 <= ratio.high
    assert 930 <= held <= 980


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (1.04, 1.2, "slower"),
        (1.02, 1.2, "no difference shown"),
        (0.8, 0.99, "faster"),
        (0.9, 1.01, "no difference shown"),
    ],
)
def test_verdicts(low, high, verdict):
    assert Ratio((low + high) / 2, low, high).verdict(0.03) == verdict
