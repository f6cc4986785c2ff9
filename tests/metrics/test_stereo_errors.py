"""Stereo's errors with answers worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.geometry import Camera
from roadperc_stream.metrics.stereo import both_see, low_quantile, stereo_errors

STEREO = Camera("left", 80, 10, 100.0, 100.0, 39.5, 4.5)


def flat(disparity_px):
    """Depth by f b / d with f b = 50."""
    return np.full(STEREO.size, 50.0 / disparity_px, np.float32)


def test_true_stereo_has_no_errors():
    assert stereo_errors(flat(10), flat(10), STEREO, 0.5) == (0.0, 0.0, 0.0, 1.0)


def test_a_tenth_of_the_pixels_four_pixels_off():
    """70 columns of 10 rows are seen by both; in 7 of them Z is 50 / 14 instead of 50 / 10: too near by 2 / 7."""
    estimated = flat(10)
    estimated[:, 20:27] = 50.0 / 14
    errors = stereo_errors(estimated, flat(10), STEREO, 0.5)
    assert errors == (pytest.approx(0.4), pytest.approx(0.1), pytest.approx(0.1 * 2 / 7), 1.0)


def test_the_depth_error_is_relative_to_the_true_one():
    errors = stereo_errors(1.25 * flat(10), flat(10), STEREO, 0.5)
    assert (errors.abs_rel, errors.epe_px) == (pytest.approx(0.25), pytest.approx(2.0))


def test_stereo_errors_are_counted_over_known_pixels_beside_their_share():
    estimated = flat(10)
    estimated[:, 10:40] = 50.0 / 14
    estimated[:5] = np.nan
    epe_px, d1_ratio, _, coverage = stereo_errors(estimated, flat(10), STEREO, 0.5)
    assert (epe_px, d1_ratio, coverage) == (pytest.approx(4 * 30 / 70), pytest.approx(30 / 70), 0.5)


@pytest.mark.parametrize(("true_px", "off_px", "bad"), [(10, 2.9, 0.0), (10, 3.1, 1.0), (70, 3.4, 0.0), (70, 3.6, 1.0)])
def test_a_bad_disparity_is_three_pixels_and_five_percent_off(true_px, off_px, bad):
    assert stereo_errors(flat(true_px + off_px), flat(true_px), STEREO, 0.5).d1_ratio == bad


def test_far_and_unknown_truth_does_not_count():
    true = flat(10)
    true[:, :20], true[:, 20:40] = 61.0, np.nan
    estimated = flat(10)
    estimated[:, :40] = 1.0
    assert stereo_errors(estimated, true, STEREO, 0.5) == (0.0, 0.0, 0.0, 1.0)
    assert stereo_errors(estimated, flat(0.5), STEREO, 0.5) == (None, None, None, None)
    assert stereo_errors(flat(np.nan), flat(10), STEREO, 0.5) == (None, None, None, 0.0)
    with pytest.raises(ValueError, match="true depth is"):
        stereo_errors(estimated[1:], true, STEREO, 0.5)


def test_what_something_near_hides_is_not_seen_by_both():
    """Columns 50 to 59 at 20 px land on 30 to 39, where the ground's columns 34 to 43 at 4 px would be."""
    disparity = np.full((3, 80), 4.0, np.float32)
    disparity[:, 50:60] = 20.0
    seen = both_see(disparity)
    hidden = np.flatnonzero(~seen[1])
    assert hidden.tolist() == [0, 1, 2, 3, *range(34, 44)]
    disparity[1, 70] = np.nan
    assert np.flatnonzero(~both_see(disparity)[1]).tolist() == [*hidden, 70]


@given(st.lists(st.floats(0.5, 80.0, width=32), min_size=1, max_size=400), st.sampled_from([0.001, 0.02, 0.4]))
def test_the_low_quantile_is_numpys(values, share):
    array = np.array(values, np.float32)
    assert low_quantile(array, share) == float(np.quantile(array, share))
