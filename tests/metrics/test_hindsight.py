"""Drives of 1 m a frame over a known road, with claims that are exact or wrong by a known amount."""

import numpy as np
import pytest

from roadperc_stream.geometry.rotations import quaternion, rotation_from_rpy
from roadperc_stream.metrics.hindsight import (
    CLAIMS,
    frame_hindsight,
    object_hindsight,
    objects_in_frames,
)

FRAMES = 40
OFFSET_M = {"left": 1.75, "right": -1.75}
SIDE = 9
"""Claims of one side."""


def _rows(yaws=None, **changed):
    """The rows of a drive ahead, or of one with a yaw in each frame."""
    yaws = np.zeros(FRAMES) if yaws is None else yaws
    steps = np.stack([np.cos(yaws), np.sin(yaws)], axis=1)
    places = np.concatenate([np.zeros((1, 2)), np.cumsum(steps[:-1], axis=0)])
    turns = np.array([quaternion(rotation_from_rpy(0, 0, yaw)) for yaw in yaws])
    rows = {
        "frame": np.arange(FRAMES),
        "stamp_ns": np.arange(FRAMES) * 100_000_000,
        "segment": np.zeros(FRAMES, int),
        "lane_change": np.full(FRAMES, "none"),
        "lane_changes": np.zeros(FRAMES),
        "odometry_status": np.array(["first", *["tracked"] * (FRAMES - 1)]),
        "surface_source": np.full(FRAMES, "depth", "<U9"),
        "step_m": np.array([np.nan, *[1.0] * (FRAMES - 1)]),
        "step_std_m": np.full(FRAMES, 0.01),
        "turn_std_deg": np.full(FRAMES, 0.01),
        "lane_left_status": np.full(FRAMES, "measured"),
        "lane_right_status": np.full(FRAMES, "measured"),
        **dict(zip(("odom_x_m", "odom_y_m"), places.T, strict=True)),
        "odom_z_m": np.zeros(FRAMES),
        **dict(zip(("odom_qx", "odom_qy", "odom_qz", "odom_qw"), turns.T, strict=True)),
    }
    return rows | changed


def _claims():
    """Exact claims of a straight road: both boundaries, and a level surface."""
    claims = np.zeros((FRAMES, CLAIMS))
    for place, offset_m in enumerate(OFFSET_M.values()):
        claims[:, SIDE * place] = offset_m
        claims[:, SIDE * place + 3] = 0.01**2
    return claims


def _lane(rows, claims, side="left"):
    return frame_hindsight(rows, claims)[f"lane_{side}_hindsight_m"]


def test_exact_claims_have_no_error_and_the_last_frames_no_answer():
    found = frame_hindsight(_rows(), _claims())
    for name in ("lane_left_hindsight_m", "lane_right_hindsight_m", "surface_height_hindsight_m"):
        np.testing.assert_allclose(found[name][:33], 0, atol=1e-12)
        assert np.isnan(found[name][33:]).all()
    np.testing.assert_allclose(found["step_hindsight_m"][3:35], 0, atol=1e-8)
    assert found["lane_left_hindsight_frame"][0] == 7  # the place 10 m ahead is 3 m ahead there


@pytest.mark.parametrize(("side", "place"), [("left", 0), ("right", SIDE)])
def test_a_wrong_heading_is_seen_from_nearby(side, place):
    claims = _claims()
    claims[5, place + 1] = 0.05
    error_m = _lane(_rows(), claims, side)
    assert error_m[5] == pytest.approx(0.5)
    assert np.count_nonzero(np.abs(error_m[:33]) > 0.2) == 1


def test_a_bend_is_no_error():
    """The car follows a circle of 50 m, and the boundary is a circle around the same centre."""
    yaws = (np.arange(FRAMES) - 0.5) / 50
    claims = _claims()
    claims[:, 1] = -0.5 / 50  # the steps are chords
    claims[:, 2] = 1 / (50 - OFFSET_M["left"])
    assert np.nanmax(np.abs(_lane(_rows(yaws), claims))) < 0.05


@pytest.mark.parametrize(
    "changed",
    [
        {"lane_changes": (np.arange(FRAMES) >= 10).astype(float)},
        {"lane_change": np.where(np.arange(FRAMES) == 10, "left", "none")},
        {"odometry_status": np.where(np.arange(FRAMES) == 10, "lost", "tracked")},
        {"segment": (np.arange(FRAMES) >= 10).astype(int)},
        {"odom_x_m": np.where(np.arange(FRAMES) == 10, np.nan, np.arange(FRAMES))},
    ],
)
def test_what_breaks_the_way_to_the_place_leaves_no_answer(changed):
    error_m = _lane(_rows(**changed), _claims())
    assert np.isnan(error_m[9]) or "lane_change" in changed
    assert np.isnan(error_m[10]) or "lane_changes" in changed or "segment" in changed
    assert np.isfinite(error_m[[0, 20]]).all()


def test_only_measured_boundaries_judge_and_held_ones_are_judged():
    held = np.where(np.arange(FRAMES) < 20, "held", "measured")
    error_m = _lane(_rows(lane_left_status=held), _claims())
    assert np.isnan(error_m[:6]).all()  # the car is there before the boundary is measured
    assert np.isfinite(error_m[8:33]).all()


def test_another_line_after_a_loss_is_no_error_but_a_wrong_line_is():
    status = np.where(np.arange(FRAMES) == 10, "lost", "measured")
    claims = _claims()
    claims[:10, 0] = OFFSET_M["left"] + 3.5
    claims[10, :SIDE] = np.nan
    assert np.isnan(_lane(_rows(lane_left_status=status), claims)[4:10]).all()
    claims[:10, 0] = OFFSET_M["left"] + 1.0
    np.testing.assert_allclose(_lane(_rows(lane_left_status=status), claims)[4:10], 1.0)


def test_the_deviation_covers_claim_later_measurement_and_turns():
    rows, claims = _rows(turn_std_deg=np.full(FRAMES, 1.0)), _claims()
    claims[:, 3 + 3] = 0.02**2  # variance of the heading
    found = frame_hindsight(rows, claims)["lane_left_hindsight_std_m"]
    way_m = np.arange(9, 2, -1)
    expected = 2 * 0.01**2 + (0.02 * 10) ** 2 + (0.02 * 3) ** 2 + np.radians(1.0) ** 2 * (way_m**2).sum()
    assert found[5] == pytest.approx(np.sqrt(expected))


def test_a_road_that_was_claimed_too_high_is_found_lower():
    claims = _claims()
    claims[5, 2 * SIDE] = 0.3
    claims[6, 2 * SIDE :] = np.nan
    found = frame_hindsight(_rows(), claims)["surface_height_hindsight_m"]
    assert found[5] == pytest.approx(0.3)
    assert np.isnan(found[6])


def _track(distance_m, track="a", **more):
    count = len(distance_m)
    rows = {
        "frame": np.arange(count),
        "stamp_ns": np.arange(count) * 100_000_000,
        "track_id": np.full(count, track),
        "kept": np.ones(count, bool),
        "distance_m": distance_m,
        "distance_std_m": np.full(count, 0.2),
        "closing_speed_mps": np.full(count, 5.0),
        "closing_speed_std_mps": np.full(count, 0.3),
        "time_to_impact_s": np.asarray(distance_m) / 5,
        "time_to_impact_std_s": np.full(count, 0.1),
    }
    return rows | more


def test_a_wrong_distance_speed_and_time_are_seen_in_the_track():
    true_m = 40 - 0.5 * np.arange(40)
    claimed = true_m.copy()
    claimed[20] += 4
    speed_mps = np.where(np.arange(40) == 15, 7.0, 5.0)
    found = object_hindsight(_track(claimed, closing_speed_mps=speed_mps, time_to_impact_s=true_m / speed_mps))
    assert found["object_distance_hindsight_m"][20] == pytest.approx(4, abs=0.01)
    assert found["closing_speed_hindsight_mps"][15] == pytest.approx(2, abs=0.05)
    assert found["time_to_impact_hindsight_s"][15] == pytest.approx(true_m[15] / 7 - true_m[15] / 5, abs=0.1)
    assert np.nanmedian(np.abs(found["object_distance_hindsight_m"])) < 0.01
    assert np.isnan(found["object_distance_hindsight_m"][30:]).all()


def test_a_short_track_and_one_that_becomes_another_object_have_no_answer():
    assert np.isnan(object_hindsight(_track(40 - np.arange(8.0)))["object_distance_hindsight_m"]).all()
    jumps = np.where(np.arange(60) % 2, 20.0, 60.0)
    assert np.isnan(object_hindsight(_track(jumps))["object_distance_hindsight_m"]).all()


def test_frames_have_the_mean_error_of_their_objects_and_that_of_the_most_urgent():
    far, near = _track(np.full(40, 50.0), "far", frame=np.arange(40)), _track(np.full(40, 20.0), "near")
    rows = {name: np.concatenate([far[name], near[name]]) for name in far}
    found = {
        "object_distance_hindsight_m": np.concatenate([np.full(40, 1.0), np.full(40, -3.0)]),
        "time_to_impact_hindsight_s": np.concatenate([np.full(40, 0.5), np.full(40, 0.1)]),
    }
    by_frame = objects_in_frames(_rows(), rows, found)
    np.testing.assert_allclose(by_frame["object_distance_hindsight_m"][:30], 2.0)
    np.testing.assert_allclose(by_frame["time_to_impact_hindsight_s"][:30], 0.1)
    assert np.isnan(by_frame["object_distance_hindsight_m"][30:]).all(), "open tracks"
