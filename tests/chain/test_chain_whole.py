"""The whole chain on the sample's frames: repeated and resumed runs, missing inputs, states, and failing depth."""

import pickle
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from roadperc_stream import geometry as g
from roadperc_stream.chain.encoding import decode, encode
from roadperc_stream.chain.step import State
from roadperc_stream.config import load_config
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.metrics.lanes import lane_errors
from roadperc_stream.model import Absent, DepthImage, PointCloud, Reason
from roadperc_stream.system.threads import one_thread
from roadperc_stream.system.time import TimeRange
from tests.chain.test_chain import same
from tests.steps import step

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
CFG = load_config(None, ("surface.model=spline",))
FRAMES = 6
EGO_T_LIDAR = g.rigid(rotation_from_rpy(0.02, -0.05, 0.3), np.array([0.0, 0.1, 2.4]))


@pytest.fixture(scope="module")
def frames():
    log_in = open_input(ReplaySource(SAMPLE, time_range=TimeRange(frames=FRAMES)), CFG)
    return [with_lidar(sample.frame) for sample in log_in.samples()]


def with_lidar(frame):
    """The frame with an additional lidar, whose points are a few of the depth camera's."""
    depth_m = frame.depth_image.depth_m[::6, ::2]
    v, u = 6 * np.indices(depth_m.shape)[0], 2 * np.indices(depth_m.shape)[1]
    near = depth_m < 60
    pixels = np.stack((u, v), axis=-1)[near].astype(float)
    lidar_T_camera = g.inverse(EGO_T_LIDAR) @ frame.ego_T_camera
    points_m = g.transform(lidar_T_camera, g.unproject(frame.camera, pixels, depth_m[near])).astype(np.float32)
    return replace(frame, points=PointCloud("lidar", lambda: points_m), ego_T_lidar=EGO_T_LIDAR)


@pytest.fixture(scope="module")
def lidar_frames(frames):
    """The same frames with a lidar, but without depth and right image."""
    return [replace(frame, depth_image=None, right=None) for frame in frames]


def run(frames, state=None):
    results = []
    state = state or State()
    with one_thread():
        for frame in frames:
            state, result = step(CFG, state, frame)
            results.append(result)
    return state, tuple(results)


@pytest.fixture(scope="module")
def whole(frames):
    return run(frames)[1]


@pytest.fixture(scope="module")
def lidar_results(lidar_frames):
    return run(lidar_frames)[1]


def test_every_stage_has_a_result(whole):
    last = whole[-1]
    assert not [reason for result in whole for reason in result.reasons()]
    assert last.odometry.status == "tracked"
    assert last.surface.height_grid is not None
    assert any(item.closing_speed_mps is not None for item in last.objects.objects)
    assert {-1, 0, 100} == set(last.occupancy.cells.ravel().tolist())


@pytest.mark.parametrize(("log", "results"), [("frames", "whole"), ("lidar_frames", "lidar_results")])
def test_a_second_run_and_a_run_from_a_pickled_state_have_equal_results(log, results, request):
    frames, expected = request.getfixturevalue(log), request.getfixturevalue(results)
    state, first = run(frames[:3])
    assert same(first, expected[:3])
    assert same(run(frames[3:], pickle.loads(pickle.dumps(state)))[1], expected[3:])


ABSENT_WITHOUT = {
    "image": {"odometry": "no_image", "stereo": "no_left_image"},
    "right": {"stereo": "no_right_image"},
    "right_camera": {"stereo": "no_right_calibration"},
    "segmentation": {"lanes": "no_segmentation"},
    "detections": {"objects": "no_detections"},
}


@pytest.mark.parametrize(
    "missing", ["image", "right", "right_camera", "depth_image", "segmentation", "detections", "points"]
)
def test_any_input_may_be_missing(frames, whole, missing):
    _, results = run([replace(frame, **{missing: None}) for frame in frames[:2]])
    if missing == "points":
        assert same(results, whole[:2]), "a lidar is not used if there is depth"
        return
    reasons = {reason for result in results for reason in result.reasons()}
    assert reasons or missing == "depth_image", "stereo replaces the depth, which the source reports"
    last = results[-1]
    for stage, code in ABSENT_WITHOUT.get(missing, {}).items():
        assert getattr(last, stage) == Absent(Reason(stage, code))
    assert last.surface.source == {"depth_image": "stereo", "segmentation": "lower_image"}.get(missing, "depth")
    assert missing == "image" or last.odometry.status == "tracked"


def assert_alike(last, with_sensor, offset_m):
    """Assert that road, lane and near objects agree with those of the depth sensor, and that odometry is metric."""
    assert last.surface.camera_height_m == pytest.approx(with_sensor.surface.camera_height_m, abs=0.05)
    for side in ("left", "right"):
        assert last.lanes.side(side).offset_m == pytest.approx(with_sensor.lanes.side(side).offset_m, abs=offset_m)
    near = [item for item in with_sensor.objects.objects if item.kept and (item.distance_m or 99) < 15]
    for item in near:
        (same_one,) = [other for other in last.objects.objects if other.detection == item.detection]
        assert same_one.distance_m == pytest.approx(item.distance_m, rel=0.1)
    assert not last.odometry.up_to_scale


def test_two_cameras_and_tags_are_enough_for_everything(frames, whole):
    """Without a depth sensor, stereo gives the plane, the lane on the ground, distances and metric odometry."""
    _, results = run([replace(frame, depth_image=None) for frame in frames])
    assert_alike(results[-1], whole[-1], offset_m=0.1)


@pytest.mark.parametrize("missing", ["image", "segmentation", "detections", "points"])
def test_any_input_beside_a_lidar_may_be_missing(lidar_frames, missing):
    _, results = run([replace(frame, **{missing: None}) for frame in lidar_frames[:2]])
    expected = {"segmentation": ["lower_image"] * 2, "points": ["assumed", "estimated"]}
    assert [result.surface.source for result in results] == expected.get(missing, ["lidar"] * 2)


def test_a_lidar_that_misses_the_road_gives_an_assumed_then_an_estimated_plane(lidar_frames):
    _, results = run([replace(frame, points=high_points(frame.points)) for frame in lidar_frames[:3]])
    assert [result.surface.source for result in results] == ["assumed", "estimated", "estimated"]
    codes = [[reason.code for reason in result.reasons() if reason.code.startswith("plane")] for result in results]
    assert codes == [["plane_assumed"], ["plane_estimated"], ["plane_estimated"]]


def high_points(points):
    """A lidar's points above a car's roof."""
    return PointCloud(points.frame_id, lambda: points.points_m[points.points_m[:, 2] > -0.5])


def test_one_camera_a_lidar_and_tags_are_enough_for_everything(lidar_results, whole):
    """A lidar's points give plane, height field, the lane on the ground, distances, and the scale of odometry."""
    last, with_sensor = lidar_results[-1], whole[-1]
    assert {str(reason) for result in lidar_results for reason in result.reasons()} == {"stereo: no right image"}
    assert last.surface.source == "lidar"
    assert last.surface.height_grid is not None
    assert_alike(last, with_sensor, offset_m=0.05)
    assert last.odometry.status == "tracked"
    assert last.odometry.odom_T_ego[0, 3] == pytest.approx(with_sensor.odometry.odom_T_ego[0, 3], rel=0.1)
    assert {-1, 0, 100} == set(last.occupancy.cells.ravel().tolist())


def faults(value, where):
    """Names of all parts of a value that are mutable, or that its bytes would not restore exactly."""
    if isinstance(value, tuple):
        return [name for k, item in enumerate(value) for name in faults(item, f"{where}[{k}]")]
    if isinstance(value, np.ndarray):
        return [where] if value.flags.writeable or not value.flags.c_contiguous else []
    if is_dataclass(value) and value.__dataclass_params__.frozen:
        return [name for f in fields(value) for name in faults(getattr(value, f.name), f"{where}.{f.name}")]
    return [] if type(value) in {type(None), bool, int, float, str} else [f"{where}: {type(value).__name__}"]


@pytest.mark.parametrize("settings", [(), ("odometry.features=sift",)])
def test_a_state_contains_immutable_plain_values(settings):
    cfg, state = load_config(None, settings), State()
    for sample in open_input(ReplaySource(SAMPLE, time_range=TimeRange(frames=3)), cfg).samples():
        state, _ = step(cfg, state, sample.frame)
        assert faults(state, "state") == []
    assert state.lanes.left.track.measured_ns == state.lanes.right.track.measured_ns == state.stamp_ns
    assert state.objects.tracks
    assert state.odometry.keyframe is not None


FAILS_FROM = 2


def failing(*settings):
    """Results and lane errors of a log whose depth has errors of 30 % from its third frame on."""
    cfg, state, found = load_config(None, ("objects.enabled=false", "stereo.method=off", *settings)), State(), []
    for sample in open_input(ReplaySource(SAMPLE, time_range=TimeRange(frames=FRAMES - 1)), cfg).samples():
        frame = sample.frame
        if sample.index >= FAILS_FROM:
            depth_m = frame.depth_image.depth_m
            noise = np.random.default_rng(sample.index).normal(1, 0.3, depth_m.shape).astype(np.float32)
            noisy = (depth_m * noise, np.inf)
            frame = replace(frame, depth_image=DepthImage(frame.depth_image.frame_id, lambda noisy=noisy: noisy))
        state, result = step(cfg, decode(encode(state), State), frame)
        found.append((result, lane_errors(result.lanes, sample.truth.lanes)))
    return found


@pytest.mark.parametrize(
    ("settings", "source", "code"),
    [((), "held", "plane_held"), (("odometry.enabled=false",), "assumed", "plane_assumed")],
)
def test_lanes_are_still_measured_if_depth_fails(settings, source, code):
    found = failing(*settings)
    sources = ["depth"] * FAILS_FROM + [source] * (len(found) - FAILS_FROM)
    assert [result.surface.source for result, _ in found] == sources
    for result, errors in found[FAILS_FROM:]:
        assert {result.lanes.side(side).status for side in ("left", "right")} == {"measured"}
        assert max(abs(errors.lane_left_error_m), abs(errors.lane_right_error_m)) < 0.3
        reasons = {(reason.source, reason.code) for reason in result.reasons()}
        assert ("surface", code) in reasons
        assert ("occupancy", "heights_unknown") in reasons
        assert isinstance(result.occupancy, Absent)
