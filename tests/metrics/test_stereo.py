"""Errors of stereo against the depth of its camera, computed by hand."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.geometry import Camera
from roadperc_stream.kernels import seen_by_both
from roadperc_stream.metrics.stereo import OCCLUSION_PX, low_quantile, stereo_errors, stereo_errors_of
from roadperc_stream.model import DepthImage, StereoDepth
from roadperc_stream.schemas.columns.errors import StereoErrorColumns
from tests.metrics.frames import sample_and_result

BASELINE_M = 0.5


NO_ERRORS = StereoErrorColumns(0.0, 0.0, 0.0, 1.0)


def columns(estimated_m, true_m, **changes):
    sample, _ = sample_and_result()
    camera = sample.frame.camera
    right, depth = replace(camera, baseline_m=BASELINE_M), DepthImage("camera", lambda: (true_m, 65.535))
    frame = replace(sample.frame, **{"right_camera": right, "depth_image": depth, **changes})
    return stereo_errors_of(StereoDepth("camera", estimated_m), replace(sample, frame=frame))


def wall(distance_m):
    return np.full((480, 640), distance_m, np.float32)


def test_the_depth_of_the_log_is_the_truth_of_stereo():
    """f b = 160: 16 px at 10 m, so columns 16 to 639 are seen by both; the upper half is unknown."""
    estimated = wall(12.5)
    estimated[:240] = np.nan
    found = columns(estimated, wall(10.0))
    assert found.stereo_epe_px == pytest.approx(16 - 12.8)
    assert found.stereo_d1_ratio == 1.0
    assert found.stereo_abs_rel == pytest.approx(0.25)
    assert found.stereo_coverage == 0.5


def test_without_depth_at_the_left_camera_there_are_no_errors():
    assert columns(wall(10.0), wall(10.0), depth_image=None) == StereoErrorColumns()
    assert columns(wall(10.0), wall(10.0), right_camera=None) == StereoErrorColumns()
    assert columns(wall(10.0), np.zeros((2, 2), np.float32)) == StereoErrorColumns()


STEREO = Camera("left", 80, 10, 100.0, 100.0, 39.5, 4.5)


def flat(disparity_px):
    """Depth by f b / d with f b = 50."""
    return np.full(STEREO.size, 50.0 / disparity_px, np.float32)


def test_a_tenth_of_the_pixels_four_pixels_off():
    """70 columns of 10 rows are seen by both; in 7 of them Z is 50 / 14 instead of 50 / 10: too near by 2 / 7."""
    estimated = flat(10)
    estimated[:, 20:27] = 50.0 / 14
    errors = stereo_errors(estimated, flat(10), STEREO, 0.5)
    assert astuple(errors) == pytest.approx((0.4, 0.1, 0.1 * 2 / 7, 1.0))


@pytest.mark.parametrize(("true_px", "off_px", "bad"), [(10, 2.9, 0.0), (10, 3.1, 1.0), (70, 3.4, 0.0), (70, 3.6, 1.0)])
def test_a_bad_disparity_is_three_pixels_and_five_percent_off(true_px, off_px, bad):
    assert stereo_errors(flat(true_px + off_px), flat(true_px), STEREO, 0.5).stereo_d1_ratio == bad


def test_far_and_unknown_truth_does_not_count():
    true = flat(10)
    true[:, :20], true[:, 20:40] = 61.0, np.nan
    estimated = flat(10)
    estimated[:, :40] = 1.0
    assert stereo_errors(estimated, true, STEREO, 0.5) == NO_ERRORS
    assert stereo_errors(estimated, flat(0.5), STEREO, 0.5) == StereoErrorColumns()
    assert stereo_errors(flat(np.nan), flat(10), STEREO, 0.5) == StereoErrorColumns(stereo_coverage=0.0)


def test_a_hidden_pixel_is_not_visible_in_both_images():
    """Columns 50 to 59 at 20 px land on 30 to 39, where the ground's columns 34 to 43 at 4 px would be."""
    disparity = np.full((3, 80), 4.0, np.float32)
    disparity[:, 50:60] = 20.0
    seen = seen_by_both(disparity, OCCLUSION_PX)
    hidden = np.flatnonzero(~seen[1])
    assert hidden.tolist() == [0, 1, 2, 3, *range(34, 44)]
    disparity[1, 70] = np.nan
    assert np.flatnonzero(~seen_by_both(disparity, OCCLUSION_PX)[1]).tolist() == [*hidden, 70]


@given(st.lists(st.floats(0.5, 80.0, width=32), min_size=1, max_size=400), st.sampled_from([0.001, 0.02, 0.4]))
def test_the_low_quantile_equals_numpys(values, share):
    array = np.array(values, np.float32)
    assert low_quantile(array, share) == float(np.quantile(array, share))
