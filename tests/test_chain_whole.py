"""The chain's four properties with every stage at work, on the sample's frames."""

import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from roadperc_stream import log
from roadperc_stream.chain import ChainState, step
from roadperc_stream.config import load_config
from roadperc_stream.datatypes import Absent
from roadperc_stream.replay import one_thread
from roadperc_stream.roles import Problems
from roadperc_stream.survey import Cut, samples, survey_log
from roadperc_stream.sync import SyncCounts
from tests.test_chain import same

SAMPLE = Path(__file__).parents[1] / "logs" / "sample.mcap"
CFG = load_config(None, ("surface.model=spline",))
FRAMES = 6


@pytest.fixture(scope="module")
def frames():
    summary = log.summarise(SAMPLE)
    survey = survey_log(summary, CFG, {}, Cut(frames=FRAMES))
    return [sample.frame for sample in samples(summary, survey, CFG, SyncCounts(), Problems())]


def run(frames, state=None):
    results = []
    state = state or ChainState()
    with one_thread():
        for frame in frames:
            state, result = step(CFG, state, frame)
            results.append(result)
    return state, tuple(results)


@pytest.fixture(scope="module")
def whole(frames):
    return run(frames)[1]


def test_every_stage_gives_something(whole):
    last = whole[-1]
    assert not [reason for result in whole for reason in result.reasons()]
    assert last.odometry.status == "tracked"
    assert last.surface.height_grid is not None
    assert any(item.closing_speed_mps is not None for item in last.objects.objects)
    assert {-1, 0, 100} == set(last.occupancy.cells.ravel().tolist())


def test_replaying_twice_is_equal(frames, whole):
    assert same(run(frames)[1], whole)


def test_results_do_not_depend_on_later_frames(frames, whole):
    assert same(run(frames[:3])[1], whole[:3])


def test_a_pickled_state_goes_on_as_if_nothing_had_happened(frames, whole):
    state, _ = run(frames[:3])
    assert same(run(frames[3:], pickle.loads(pickle.dumps(state)))[1], whole[3:])


@pytest.mark.parametrize("missing", ["image", "right", "depth", "segmentation", "detections"])
def test_any_input_may_be_missing(frames, missing):
    _, results = run([replace(frame, **{missing: None}) for frame in frames[:3]])
    reasons = {reason for result in results for reason in result.reasons()}
    assert reasons or missing == "depth", "stereo stands in for the depth, and the source says so"
    last = results[-1]
    if missing == "image":
        assert last.odometry == Absent("no image")
        assert last.stereo == Absent("no left image")
    if missing == "right":
        assert last.stereo == Absent("no right image")
    if missing == "depth":
        assert last.surface.source == "stereo"
        assert last.odometry.status == "tracked"


def test_two_cameras_and_tags_are_enough_for_everything(frames, whole):
    """Without a depth sensor, stereo gives the plane, the lane on the ground, distances and metric odometry."""
    _, results = run([replace(frame, depth=None) for frame in frames])
    last, with_sensor = results[-1], whole[-1]
    assert last.surface.camera_height_m == pytest.approx(with_sensor.surface.camera_height_m, abs=0.05)
    for side in ("left", "right"):
        assert last.lanes.side(side).offset_m == pytest.approx(with_sensor.lanes.side(side).offset_m, abs=0.1)
    near = [item for item in with_sensor.objects.objects if item.kept and (item.distance_m or 99) < 15]
    for item in near:
        (same_one,) = [other for other in last.objects.objects if other.detection == item.detection]
        assert same_one.distance_m == pytest.approx(item.distance_m, rel=0.1)
    assert not last.odometry.up_to_scale
