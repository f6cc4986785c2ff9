"""Stereo's columns against the depth at its camera."""

from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream.metrics.stereo import stereo_errors_of
from roadperc_stream.model import DepthImage, StereoDepth
from roadperc_stream.schemas.columns.errors import StereoErrorColumns
from tests.metrics.frames import sample_and_result

BASELINE_M = 0.5


def columns(estimated_m, true_m, **changes):
    sample, _ = sample_and_result()
    camera = sample.frame.camera
    right, depth = replace(camera, baseline_m=BASELINE_M), DepthImage("camera", lambda: (true_m, 65.535))
    frame = replace(sample.frame, **{"right_camera": right, "depth": depth, **changes})
    return stereo_errors_of(StereoDepth("camera", estimated_m), replace(sample, frame=frame))


def wall(distance_m):
    return np.full((480, 640), distance_m, np.float32)


def test_the_logs_own_depth_is_stereos_truth():
    """f b = 160: 16 px at 10 m, so columns 16 to 639 are seen by both; the upper half is unknown."""
    estimated = wall(12.5)
    estimated[:240] = np.nan
    found = columns(estimated, wall(10.0))
    assert found.stereo_epe_px == pytest.approx(16 - 12.8)
    assert found.stereo_d1_ratio == 1.0
    assert found.stereo_abs_rel == pytest.approx(0.25)
    assert found.stereo_coverage == 0.5


def test_the_true_depth_has_no_errors():
    found = columns(wall(10.0), wall(10.0))
    assert found == StereoErrorColumns(0, 0, 0, 1.0)


def test_nothing_is_said_without_depth_at_the_left_camera():
    assert columns(wall(10.0), wall(10.0), depth=None) == StereoErrorColumns()
    assert columns(wall(10.0), wall(10.0), right_camera=None) == StereoErrorColumns()
    assert columns(wall(10.0), np.zeros((2, 2), np.float32)) == StereoErrorColumns()
