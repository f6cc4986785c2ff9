"""Metrics with answers worked out by hand; identity gives zero everywhere."""

from dataclasses import fields, replace

import numpy as np
import pytest

from roadperc_stream import metrics as m
from roadperc_stream.chain import ChainState, step
from roadperc_stream.config import ReplayConfig
from roadperc_stream.datatypes import (
    Boundary,
    DepthImage,
    HeightGrid,
    Lanes,
    Object,
    Objects,
    Sample,
    TagImage,
    Truth,
)
from roadperc_stream.geometry import Camera
from roadperc_stream.rows import FrameMetrics
from roadperc_stream.schemas.roadperc_pb2 import FrameMetrics as FrameMetricsProto
from roadperc_stream.semantics import CARLA_BEFORE_0_9_14 as TABLE
from roadperc_stream.stereo_errors import both_see, stereo_errors
from tests.analytic import Road, box
from tests.hills import Hill

CFG = ReplayConfig()


def boundary(offset_m, heading=0.0, side="left"):
    x = np.arange(0.0, 30.0)
    line = np.stack((x, offset_m + heading * x, np.zeros_like(x)), axis=-1)
    return Boundary(side, "measured", None, None, offset_m, heading, 0.0, line_ego_m=line)


def test_lane_error_is_taken_ten_metres_ahead():
    assert m.lane_error_m(boundary(1.8, 0.01), boundary(1.8)) == pytest.approx(0.1)
    assert m.lane_error_m(boundary(1.55), boundary(1.8)) == pytest.approx(-0.25)
    assert m.lane_error_m(boundary(1.8), boundary(1.8)) == 0.0


def test_lane_error_needs_both():
    assert m.lane_error_m(Boundary("left", "lost"), boundary(1.8)) is None
    assert m.lane_error_m(boundary(1.8), Boundary("left", "measured")) is None


def test_intersection_over_union():
    a, b = np.zeros((2, 4), bool), np.zeros((2, 4), bool)
    a[0], b[0, 2:], b[1, :2] = True, True, True
    assert m.intersection_over_union(a, b) == pytest.approx(2 / 6)
    assert m.intersection_over_union(a, a) == 1.0
    assert m.intersection_over_union(a & False, b & False) is None


def sample_and_result(**truth):
    frame = Road().frame(detections=(box("Car", 0, 0, 10, 10), box("Unicorn", 300, 300, 340, 340)))
    _, result = step(CFG, ChainState(), frame)
    return Sample(0, frame.stamp_ns, frame, Truth(**truth), (), 0), result


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
    row = m.frame_metrics(CFG, "id", sample, result)
    assert (row.surface_angle_error_deg, row.camera_height_error_m, row.drivable_iou) == (0.0, 0.0, 1.0)
    assert row.lane_left_error_m == pytest.approx(0.0, abs=1e-9)
    assert row.lane_right_error_m == pytest.approx(0.0, abs=1e-9)


def test_a_surface_turned_by_a_degree():
    _, result = sample_and_result()
    turned = replace(
        result.surface, ego_plane=type(result.surface.ego_plane)((np.sin(np.pi / 180), 0.0, np.cos(np.pi / 180)), 0.0)
    )
    level = replace(result.surface, ego_plane=type(result.surface.ego_plane)((0.0, 0.0, 1.0), 0.0))
    sample, _ = sample_and_result(surface=replace(turned, camera_height_m=1.5))
    row = m.frame_metrics(CFG, "id", sample, replace(result, surface=replace(level, camera_height_m=1.4)))
    assert row.surface_angle_error_deg == pytest.approx(1.0)
    assert row.camera_height_error_m == pytest.approx(-0.1)


def test_columns_of_a_frame():
    sample, result = sample_and_result()
    row = m.frame_metrics(CFG, "id", sample, result)
    assert row.lane_width_m == pytest.approx(1.8 + 1.9, abs=0.03)
    assert (row.detections, row.detections_kept, row.detections_unjudged) == (2, 1, 1)
    assert row.lane_right_boundary_class == "sidewalk"
    assert row.surface_source == "depth"
    assert row.lane_left_error_m is None


def test_objects_are_matched_best_first_and_once():
    near, far = box("Car", 0, 0, 10, 10), box("Car", 1, 0, 11, 10)
    objects = Objects((Object(far, True, distance_m=5.0), Object(near, True, distance_m=3.5)))
    truth = Objects((Object(near, True, distance_m=3.0),))
    sample, result = sample_and_result(objects=truth)
    result = replace(result, objects=objects)
    rows = m.object_metrics("id", sample, result)
    assert [row.true_distance_m for row in rows] == [None, 3.0]
    assert m.frame_metrics(CFG, "id", sample, result).object_distance_error_m == pytest.approx(0.5)


def test_dropped_objects_do_not_count():
    objects = Objects(
        (Object(box("Car", 0, 0, 9, 9), False, distance_m=2.0), Object(box("Bus", 20, 0, 29, 9), True, distance_m=7.0))
    )
    sample, result = sample_and_result()
    row = m.frame_metrics(CFG, "id", sample, replace(result, objects=objects))
    assert (row.nearest_object_m, row.nearest_object_class, row.detections_kept) == (7.0, "Bus", 1)


def test_the_message_has_a_field_for_every_column():
    names = {f.name for f in FrameMetricsProto.DESCRIPTOR.fields} - {"timestamp", "frame_id"}
    assert names == {f.name for f in fields(FrameMetrics)}


def test_lost_lanes_have_no_width():
    lanes = Lanes((boundary(1.8), Boundary("right", "lost")))
    sample, result = sample_and_result()
    row = m.frame_metrics(CFG, "id", sample, replace(result, lanes=lanes))
    assert (row.lane_width_m, row.lane_right_status, row.lane_right_offset_m) == (None, "lost", None)


STEREO = Camera("left", 80, 10, 100.0, 100.0, 39.5, 4.5)


def flat(disparity_px):
    """Depth by f b / d with f b = 50."""
    return np.full(STEREO.size, 50.0 / disparity_px, np.float32)


def test_true_stereo_has_no_errors():
    epe_px, d1_ratio, coverage = stereo_errors(flat(10), flat(10), STEREO, 0.5)
    assert (epe_px, d1_ratio, coverage) == (0.0, 0.0, 1.0)


def test_stereo_errors_are_counted_over_known_pixels_beside_their_share():
    estimated = flat(10)
    estimated[:, 10:40] = 50.0 / 14
    estimated[:5] = np.nan
    epe_px, d1_ratio, coverage = stereo_errors(estimated, flat(10), STEREO, 0.5)
    assert (epe_px, d1_ratio, coverage) == (pytest.approx(4 * 30 / 70), pytest.approx(30 / 70), 0.5)


@pytest.mark.parametrize(("true_px", "off_px", "bad"), [(10, 2.9, 0.0), (10, 3.1, 1.0), (70, 3.4, 0.0), (70, 3.6, 1.0)])
def test_a_bad_disparity_is_three_pixels_and_five_percent_off(true_px, off_px, bad):
    assert stereo_errors(flat(true_px + off_px), flat(true_px), STEREO, 0.5).d1_ratio == bad


def test_far_and_unknown_truth_does_not_count():
    true = flat(10)
    true[:, :20], true[:, 20:40] = 61.0, np.nan
    estimated = flat(10)
    estimated[:, :40] = 1.0
    assert stereo_errors(estimated, true, STEREO, 0.5) == (0.0, 0.0, 1.0)
    assert stereo_errors(estimated, flat(0.5), STEREO, 0.5) == (None, None, None)
    assert stereo_errors(flat(np.nan), flat(10), STEREO, 0.5) == (None, None, 0.0)
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


def test_heights_are_judged_between_five_and_forty_metres():
    hill = Hill().surface()
    assert m.surface_height_error_m(hill, hill) == pytest.approx(0.0, abs=1e-6)
    z = hill.height_grid.z_m.copy()
    z[:, :5] += 9  # nearer than 5 m
    z[:, 41:] += 9  # farther than 40 m
    z[np.abs(np.arange(-8, 9)) >= 4] += 9
    z[5:12, 5:41] += 0.25
    raised = replace(hill, height_grid=HeightGrid(0.0, -8.0, 1.0, z))
    assert m.surface_height_error_m(raised, hill) == pytest.approx(0.25, abs=1e-6)


def test_heights_of_a_plane_and_without_truth():
    level = replace(Hill(grade=0.0).surface(), height_grid=None)
    raised = replace(level, ego_plane=type(level.ego_plane)((0.0, 0.0, 1.0), -0.1))
    assert m.surface_height_error_m(raised, Hill(grade=0.0).surface()) == pytest.approx(0.1)
    assert m.surface_height_error_m(level, level) is None
    far = replace(level, height_grid=HeightGrid(50.0, 0.0, 1.0, np.zeros((2, 2), np.float32)))
    assert m.surface_height_error_m(level, far) is None
