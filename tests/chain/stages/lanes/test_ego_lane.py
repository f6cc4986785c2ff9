"""The ego lane on roads computed by hand, over time, and on real frames."""

import json

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from roadperc_stream.chain.stages.lanes.ego_lane import step
from roadperc_stream.chain.stages.lanes.tracking import LanesState
from roadperc_stream.chain.stages.surface.road import assumed_surface
from roadperc_stream.config import LanesConfig
from roadperc_stream.model import Absent, Odometry, Reason
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE
from tests.analytic import LINE, ROAD, SIDEWALK, STEP_NS, Road
from tests.scenes import scene_of

CFG = LanesConfig()
ROAD_CLASSES = ("road", "road_line")


def look(road, tags=None, state=None, index=0, cfg=CFG, motion=None, seen=True):
    tags = road.tags() if tags is None else tags
    surface = assumed_surface(road.camera, road.ego_T_camera)
    drivable = TABLE.lookup(ROAD_CLASSES)[tags].view(bool) & seen
    scene = scene_of(road.camera, road.ego_T_camera, tags=tags, stamp_ns=1_000_000_000 + index * STEP_NS)
    return step(cfg, state or LanesState(), scene, surface, drivable, motion)


def y_at(boundary, x):
    return boundary.offset_m + boundary.heading * x + 0.5 * boundary.curvature_per_m * x**2


@settings(max_examples=20)
@given(st.floats(1.2, 2.5), st.floats(-2.5, -1.2), st.floats(-0.04, 0.04), st.floats(-0.004, 0.004))
@example(1.7094382602544518, -2.0, 0.0, 0.0)  # the closest line found is but 0.46 m long on the road
def test_a_lane_is_found_at_its_true_position(left_m, right_m, heading, curvature):
    road = Road(left_m, right_m, heading, curvature, width=1280, height=960)
    _, lanes = look(road)
    for boundary, offset_m in zip(lanes.boundaries, (left_m, right_m), strict=True):
        assert boundary.status == "measured"
        assert y_at(boundary, 10.0) == pytest.approx(road.lateral(offset_m, 10.0), abs=0.03)


@pytest.mark.parametrize("first", [0, 1])
def test_a_lane_is_found_on_a_road_with_regular_holes(first):
    """Depth that is projected into a larger image is known in every second row and column only."""
    road, seen = Road(width=1280, height=960), np.zeros((960, 1280), bool)
    seen[first::2, first::2] = True
    _, lanes = look(road, seen=seen)
    assert [boundary.status for boundary in lanes.boundaries] == ["measured", "measured"]


def test_bend_is_tracked_to_30_metres():
    road = Road(curvature_per_m=1 / 150, width=1280, height=960)
    _, lanes = look(road)
    assert y_at(lanes.side("left"), 30.0) == pytest.approx(road.lateral(1.8, 30.0), abs=0.25)
    _, straight = look(road, cfg=CFG.model_copy(update={"model": "line"}))
    assert straight.side("left").curvature_per_m == 0.0


@pytest.mark.parametrize("curvature", [0.0, 0.003])
def test_lanes_begin_above_the_bonnet(curvature):
    road = Road(curvature_per_m=curvature, width=1280, height=960)
    tags = road.tags()
    bonnet_row = 576
    tags[bonnet_row:] = TABLE.names.index("vehicle")
    _, lanes = look(road, tags)
    for boundary, offset_m in zip(lanes.boundaries, (road.left_m, road.right_m), strict=True):
        assert boundary.status == "measured"
        assert y_at(boundary, 15.0) == pytest.approx(road.lateral(offset_m, 15.0), abs=0.1)
        assert abs(boundary.offset_m - offset_m) < 3 * boundary.covariance[0] ** 0.5
        assert boundary.line_px[:, 1].max() < bonnet_row
        assert boundary.inside == "road"


def test_classes_beside_the_boundaries():
    _, lanes = look(Road())
    assert (lanes.side("left").inside, lanes.side("left").outside) == ("road", "road")
    assert (lanes.side("right").inside, lanes.side("right").outside) == ("road", "sidewalk")


def test_drawn_lines_lie_on_the_edges():
    road = Road(width=1280, height=960)
    _, lanes = look(road)
    left = lanes.side("left")
    marking = np.flatnonzero(road.tags()[700] == LINE)
    x1, y1, x2, y2 = left.raw_px
    assert y1 == 960
    assert marking[0] - 2 < x1 + (x2 - x1) * (700 - y1) / (y2 - y1) < marking[-1] + 2
    drawn = np.interp(700, left.line_px[::-1, 1], left.line_px[::-1, 0])
    assert drawn == pytest.approx(marking[-1] + 0.5, abs=1)
    x1, y1, x2, y2 = left.smoothed_px
    assert x1 + (x2 - x1) * (700 - y1) / (y2 - y1) == pytest.approx(drawn, abs=1)
    assert (left.line_px[:, 1] > 479).all()


@pytest.mark.parametrize(("hold_s", "frames"), [(CFG.hold_s, 10), (0.1, 2)])
def test_a_boundary_without_measurements_is_held_then_lost_then_found_again(hold_s, frames):
    road, cfg = Road(), CFG.model_copy(update={"hold_s": hold_s})
    state, _ = look(road, cfg=cfg)
    blank = np.full_like(road.tags(), ROAD)
    statuses = []
    for index in range(1, frames + 4):
        state, lanes = look(road, blank, state, index, cfg)
        statuses.append(lanes.side("left").status)
    assert statuses == ["held"] * frames + ["lost"] * 3
    assert lanes.side("left").offset_m is None
    _, lanes = look(road, None, state, frames + 4, cfg)
    assert lanes.side("left").status == "measured"


def test_a_frame_without_tags_holds_boundaries_or_has_a_reason():
    road = Road()
    surface = assumed_surface(road.camera, road.ego_T_camera)
    inputs = (surface, Absent(Reason("drivable", "no_depth_no_segmentation")), None)
    state, _ = look(road)
    _, held = step(CFG, state, scene_of(road.camera, road.ego_T_camera, stamp_ns=1_000_000_000 + STEP_NS), *inputs)
    assert [b.status for b in held.boundaries] == ["held", "held"]
    _, absent = step(CFG, LanesState(), scene_of(road.camera, road.ego_T_camera), *inputs)
    assert absent == Absent(Reason("lanes", "no_segmentation"))


def moved(dx_m):
    """The motion straight ahead by odometry."""
    last_T_this = np.eye(4)
    last_T_this[0, 3] = dx_m
    return Odometry("tracked", np.eye(4), last_T_this, covariance=tuple(np.diag([1e-6] * 6).ravel()))


def test_the_kerb_is_not_the_lane_boundary_where_its_line_is_missing():
    """The known line stays known by odometry, and by the other line; a kerb beyond it is another boundary."""
    road = Road(left_m=1.8, right_m=-4.2)
    tags = road.tags()
    x, y, _ = np.moveaxis(road.ground()[1], -1, 0)
    marked = np.where((y < -1.8) & (y > -1.95) & (x < 150), LINE, tags).astype(np.uint8)
    state, index = None, 0
    for index in range(5):
        state, lanes = look(road, marked, state, index, motion=moved(0.5) if index else None)
    assert lanes.side("right").offset_m == pytest.approx(-1.8, abs=0.03)
    for index in range(5, 65):
        state, lanes = look(road, tags, state, index, motion=moved(0.5))
        assert lanes.side("right").status in ("held", "lost")
        assert lanes.side("left").status == "measured"
    state, lanes = look(road, marked, state, index + 1, motion=moved(0.5))
    assert lanes.side("right").offset_m == pytest.approx(-1.8, abs=0.03)
    assert lanes.lane_changes == 0


def test_a_jump_outside_the_gate_is_rejected():
    """If the line disappears for one frame and a farther line is the closest, the boundary is held."""
    road, farther = Road(left_m=1.8), Road(left_m=4.0)
    state, _ = look(road)
    for index in range(1, 5):
        state, _ = look(road, None, state, index)
    _, lanes = look(road, farther.tags(), state, 5)
    left = lanes.side("left")
    assert left.status == "held"
    assert left.offset_m == pytest.approx(1.8, abs=0.05)
    assert left.raw_offset_m == pytest.approx(4.0, abs=0.1)


def test_a_dash_too_short_for_a_hough_line_is_measured():
    road = Road(width=1280, height=960)
    tags = road.tags()
    x = road.ground()[1][..., 0]
    dashed = tags.copy()
    dashed[(tags == LINE) & ((x < 8.0) | (x > 10.0))] = ROAD
    state, _ = look(road)
    _, lanes = look(road, dashed, state, 1)
    assert lanes.side("left").status == "measured"
    assert lanes.side("left").offset_m == pytest.approx(1.8, abs=0.05)


def test_a_far_fragment_is_not_a_boundary():
    road = Road(width=1280, height=960)
    tags = road.tags()
    x, y, _ = np.moveaxis(road.ground()[1], -1, 0)
    tags[(tags == LINE)] = ROAD
    tags[(np.abs(y - 0.9) < 0.15) & (x > 16) & (x < 60)] = LINE
    _, lanes = look(road, tags)
    assert lanes.side("left").status == "lost"


def course_frame(data_dir, number):
    tags = np.loadtxt(data_dir / "course_frames" / "segmentation" / f"{number}.dat", delimiter=",").astype(np.uint8)
    return Road(width=1280, height=960, height_m=1.5), tags


def test_public_lane_of_course_frame_1(data_dir):
    expected = json.loads((data_dir / "course_frames" / "expected.json").read_text())["1"]
    road, tags = course_frame(data_dir, 1)
    _, lanes = look(road, tags)
    right, left = expected["final_lanes_px"]
    for boundary, (x1, y1, x2, y2) in ((lanes.side("left"), left), (lanes.side("right"), right)):
        bx1, by1, bx2, by2 = boundary.raw_px
        slope = (bx2 - bx1) / (by2 - by1)
        assert bx1 + slope * (y1 - by1) == pytest.approx(x1, abs=expected["lane_tolerance_px"])
        assert bx1 + slope * (y2 - by1) == pytest.approx(x2, abs=expected["lane_tolerance_px"])


@pytest.mark.parametrize("number", [0, 1, 2])
def test_neither_pole_nor_bonnet_bounds_the_lane(data_dir, number):
    """Beside the drawn boundaries, the ground is road inside, and sidewalk outside on the right."""
    raw = cv2.imread(str(data_dir / "carla_raw_tags" / "CameraSeg" / f"{number}.png"), cv2.IMREAD_UNCHANGED)
    tags = np.ascontiguousarray(raw[..., 2])
    _, lanes = look(Road(width=800, height=600, height_m=1.5), tags)
    left, right = lanes.boundaries
    assert (left.status, right.status) == ("measured", "measured")
    for boundary, outward in ((left, -1), (right, 1)):
        visible = boundary.line_px[(boundary.line_px[:, 1] < 510) & (boundary.line_px[:, 1] > 340)]
        assert len(visible) >= 5
        columns, rows = np.rint(visible).astype(int).T
        beyond = [tags[r, np.clip(c + outward * np.arange(-3, 4), 0, 799)] for c, r in zip(columns, rows, strict=True)]
        borders = [bool(np.isin(strip, (LINE, SIDEWALK)).any() and (strip == ROAD).any()) for strip in beyond]
        assert np.mean(borders) > 0.7
    assert right.outside == "sidewalk"
