"""The whole row of a frame: identity gives zero everywhere."""

from dataclasses import replace

import pytest

from roadperc_stream.metrics import frame_metrics
from roadperc_stream.model import Boundary, DepthImage, Lanes, TagImage
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE
from tests.analytic import Road
from tests.metrics.frames import CFG, boundary, sample_and_result


def test_identity_gives_zero_errors():
    road = Road()
    _, result = sample_and_result()
    tags, depth = road.tags(), road.depth_m()
    sample, _ = sample_and_result(
        surface=result.surface,
        lanes=result.lanes,
        depth=DepthImage("camera", lambda: (depth, 65.535)),
        segmentation=TagImage("camera", TABLE, lambda: tags),
    )
    row = frame_metrics(CFG, "id", sample, result)
    assert (row.surface_angle_error_deg, row.camera_height_error_m, row.drivable_iou) == (0.0, 0.0, 1.0)
    assert row.lane_left_error_m == pytest.approx(0.0, abs=1e-9)
    assert row.lane_right_error_m == pytest.approx(0.0, abs=1e-9)
    assert row.lane_left_true_offset_m == row.lane_left_offset_m
    assert row.lane_right_true_offset_m == row.lane_right_offset_m
    assert (row.lane_tusimple_accuracy, row.lane_tusimple_fp, row.lane_tusimple_fn) == (1.0, 0.0, 0.0)
    assert (row.lane_culane_tp_50, row.lane_culane_fp_50, row.lane_culane_fn_50) == (2, 0, 0)
    assert (row.lane_culane_tp_30, row.lane_culane_fp_30, row.lane_culane_fn_30) == (2, 0, 0)


def test_columns_of_a_frame():
    sample, result = sample_and_result()
    row = frame_metrics(CFG, "id", sample, result)
    assert row.lane_width_m == pytest.approx(1.8 + 1.9, abs=0.03)
    assert (row.detections, row.detections_kept, row.detections_unjudged) == (2, 1, 1)
    assert row.lane_right_boundary_class == "sidewalk"
    assert row.surface_source == "depth"
    assert row.lane_left_error_m is None
    lanes = Lanes((boundary(1.8), Boundary("right", "lost")))
    row = frame_metrics(CFG, "id", sample, replace(result, lanes=lanes))
    assert (row.lane_width_m, row.lane_right_status, row.lane_right_offset_m) == (None, "lost", None)
