"""Odometry over frames with known motion."""

import pickle
from functools import cache
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.chain.stages.odometry.features import tracking_frame
from roadperc_stream.chain.stages.odometry.followed import FollowedFrame
from roadperc_stream.chain.stages.odometry.search import MIN_VISIBLE_SHARE, guesses
from roadperc_stream.chain.stages.surface.road import assumed_surface
from roadperc_stream.geometry import inverse, project, transform
from roadperc_stream.model import Absent, Reason
from tests.chain.stages.odometry.street import CAMERA, CFG, EGO_T_CAMERA, STEP_NS, Shot, drive, photograph, pose, run
from tests.chain.stages.odometry.trajectories import angle_deg, distances_m, relative_errors
from tests.chain.test_chain import same
from tests.scenes import scene_of

POSES = drive(12)
ROAD = assumed_surface(CAMERA, EGO_T_CAMERA)


@cache
def photographed():
    return [photograph(p) for p in POSES]


def noisy(shot, seed, std=2.0):
    noise = np.random.default_rng(seed).normal(0, std, shot.grey.shape)
    return Shot(np.clip(np.rint(shot.grey + noise), 0, 255).astype(np.uint8), shot.depth_m)


def poses(results):
    return np.array([out.odom_T_ego for out in results])


def statuses(results):
    return [out.status for out in results]


@pytest.mark.parametrize(
    ("features", "matcher"),
    [("klt", "brute_force"), ("orb", "brute_force"), ("sift", "brute_force"), ("sift", "flann")],
)
def test_known_motion_with_depth(features, matcher):
    shots = photographed() if features == "klt" else photographed()[:8]
    states, results = run(shots, CFG.model_copy(update={"features": features, "matcher": matcher}))
    assert statuses(results) == ["first"] + ["tracked"] * (len(shots) - 1)
    shift, turn = relative_errors(poses(results), np.array(POSES[: len(shots)]), (2.0,), every=1)
    assert shift < 0.01
    assert turn < 2.0
    for before, out in pairwise(results):
        np.testing.assert_allclose(before.odom_T_ego @ out.step, out.odom_T_ego, atol=1e-9)
        assert (out.since_ns is None, out.up_to_scale) == (False, False)
    sizes = [len(pickle.dumps(state)) for state in states]
    assert max(sizes) < 1.5 * min(sizes)


def test_the_covariance_of_a_step_at_full_size_covers_its_error():
    _, results = run(photographed()[:3], CFG.model_copy(update={"min_rows": 480}))
    covariance = np.array(results[1].covariance).reshape(6, 6)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-15)
    assert np.linalg.eigvalsh(covariance).min() > 0
    error = np.linalg.norm((inverse(POSES[1]) @ results[1].odom_T_ego)[:3, 3])
    assert error < 5 * np.sqrt(np.trace(covariance[:3, :3])) + 0.002


def test_standing_still_does_not_drift_while_a_car_passes():
    shots = []
    for k in range(10):
        shot = noisy(photographed()[0], k)
        grey, depth_m = shot.grey.copy(), shot.depth_m.copy()
        columns = slice(50 * k, 50 * k + 160)
        grey[220:330, columns] = photographed()[5].grey[120:230, 100:260]
        depth_m[220:330, columns] = 6.0
        shots.append(Shot(grey, depth_m))
    for depth in (True, False):
        _, results = run(shots, depth=depth)
        assert statuses(results[1:]) == ["tracked"] * 9
        assert np.linalg.norm(poses(results)[:, :3, 3], axis=1).max() < 0.005
        assert max(angle_deg(p[:3, :3]) for p in poses(results)) < 0.02


def test_the_pose_after_a_long_stop_is_still_a_rotation():
    """The rounding error of one frame must not be doubled by the next one."""
    drive = [*photographed()[:6], *photographed()[5:6] * 80]
    R = run(drive)[1][-1].odom_T_ego[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=2e-14)


def test_a_missing_frame_is_lost_but_its_motion_is_not():
    states, results = run([*photographed()[:3], None, *photographed()[4:8]])
    assert statuses(results) == ["first", "tracked", "tracked", "lost", "tracked", "tracked", "tracked", "tracked"]
    np.testing.assert_array_equal(results[3].odom_T_ego, results[2].odom_T_ego)
    assert results[3].step is None
    assert results[3].reason == Reason("odometry", "no_image")
    assert results[4].since_ns == 1_000_000_000 + 2 * STEP_NS
    assert np.linalg.norm((inverse(POSES[7]) @ results[7].odom_T_ego)[:3, 3]) < 0.02
    assert states[3] is states[2]


def test_another_place_is_lost_and_then_tracked():
    elsewhere = [Shot(s.grey[::-1].copy(), s.depth_m) for s in (photograph(pose(20.0, yaw=1.0)),)]
    there = [photograph(pose(20.0, 1.0) @ p) for p in drive(4)]
    _, results = run([*photographed()[:4], *elsewhere, *there])
    assert statuses(results)[4:6] == ["lost", "lost"]
    assert statuses(results)[6:] == ["tracked"] * 3
    np.testing.assert_array_equal(results[5].odom_T_ego, results[3].odom_T_ego)
    driven = inverse(results[5].odom_T_ego) @ results[-1].odom_T_ego
    assert np.linalg.norm((inverse(drive(4)[-1]) @ driven)[:3, 3]) < 0.02


def test_orb_matches_a_large_turn_that_optical_flow_loses():
    steady = drive(2, step_m=1.0)
    turned = [pose(1.0, yaw=0.6) @ p for p in steady]
    _, results = run(
        [photographed()[0], *map(photograph, turned)], CFG.model_copy(update={"max_turn_rate_dps": 1000.0})
    )
    assert statuses(results) == ["first", "tracked", "tracked"]
    assert [out.reason for out in results[1:]] == [Reason("odometry", "matched_by_orb"), None]
    for out, true in zip(results[1:], (turned[0], steady[1]), strict=True):
        assert np.linalg.norm((inverse(true) @ out.step)[:3, 3]) < 0.01
        assert len(out.covariance) == 36


@pytest.mark.parametrize(
    ("limit", "reason"),
    [
        ({"max_speed_mps": 5.0}, "impossible_motion"),
        ({"max_turn_rate_dps": 5.0}, "impossible_motion"),
        ({"min_inliers": 390}, "too_few_inliers"),
    ],
)
def test_an_impossible_motion_is_lost(limit, reason):
    _, results = run(photographed()[:2], CFG.model_copy(update=limit))
    assert statuses(results) == ["first", "lost"]
    assert results[1].reason == Reason("odometry", reason)


def test_a_speed_that_no_car_reaches_in_time_is_lost_and_the_motion_goes_on():
    """The images of two frames are exchanged: one seems 0.8 m ahead, the other 0.8 m back, at steps of 0.4 m."""
    order = [0, 1, 2, 3, 5, 4, 6, 7]
    _, results = run([photographed()[k] for k in order])
    assert statuses(results) == ["first"] + ["tracked"] * 3 + ["lost"] * 2 + ["tracked"] * 2
    assert {out.reason.code for out in results[4:6]} == {"impossible_acceleration"}
    assert np.linalg.norm((inverse(POSES[7]) @ results[7].odom_T_ego)[:3, 3]) < 0.02


@pytest.mark.parametrize("depth", [True, False])
def test_the_scale_is_right_before_a_stop_and_after_it(depth):
    """The car brakes with 8 m/s2 from 8 m/s, stands, and drives off with 6 m/s2."""
    speeds = np.concatenate((np.full(4, 8.0), np.arange(7.6, 0.0, -0.4), np.zeros(8), np.arange(0.3, 4.8, 0.3)))
    at_m = np.concatenate(([0.0], np.cumsum(speeds * STEP_NS / 1e9)))
    shots = [noisy(photograph(pose(x)), k, std=1.0) for k, x in enumerate(at_m)]
    _, results = run(shots, depth=depth, road=ROAD)
    steps_m = np.array([np.linalg.norm(out.step[:3, 3]) for out in results[1:]])
    stands = speeds == 0
    assert steps_m[stands][1:].max() < 0.002
    assert all(out.covariance for out in results[1:])
    np.testing.assert_allclose(steps_m[-5:].sum(), np.diff(at_m)[-5:].sum(), rtol=0.05)
    assert abs(results[-1].odom_T_ego[0, 3] - at_m[-1]) < 0.03 * at_m[-1]


def test_a_step_of_unknown_length_has_no_pose_until_the_road_shows_lengths_again():
    plain = [Shot(np.where(np.arange(480)[:, None] < 240, s.grey, np.uint8(90)), s.depth_m) for s in photographed()[:3]]
    _, results = run([*plain, *photographed()[3:]], depth=False, road=ROAD)
    unknown = [out for out in results if not out.has_pose]
    assert unknown == results[1:4]
    assert {str(out.reason) for out in unknown} == {str(Reason("odometry", "scale_unknown"))}
    assert all(out.covariance for out in unknown)  # that of the turn is known
    driven_m = distances_m(poses(results[3:]))[-1]
    assert driven_m == pytest.approx(distances_m(np.array(POSES[3:]))[-1], rel=0.02)


IMAGES = st.one_of(
    st.tuples(st.just("street"), st.integers(0, 11)),
    st.tuples(st.just("noise"), st.integers(0, 3)),
    st.tuples(st.just("zoom"), st.integers(-6, 12)),
    st.tuples(st.just("plain"), st.just(0)),
)


def image(kind, number):
    if kind == "street":
        return photographed()[number].grey
    if kind == "plain":
        return np.zeros(CAMERA.size, np.uint8)
    if kind == "noise":
        return np.random.default_rng(number).integers(0, 256, CAMERA.size, np.uint8)
    zoom = cv2.getRotationMatrix2D((CAMERA.cx, CAMERA.cy), 0.0, 1.1**number)
    return cv2.warpAffine(photographed()[0].grey, zoom, CAMERA.size[::-1], borderMode=cv2.BORDER_REFLECT)


@settings(max_examples=10)
@given(
    st.lists(IMAGES, min_size=3, max_size=6),
    st.sampled_from([(True, None), (False, ROAD), (False, None)]),
    st.sampled_from([0.5, 5.0, 70.0]),
)
def test_whatever_the_images_show_the_car_drives_no_farther_than_its_greatest_speed(images, source, most_mps):
    depth, road = source
    shots = [Shot(image(*each), photographed()[0].depth_m) for each in images]
    _, results = run(shots, CFG.model_copy(update={"max_speed_mps": most_mps}), depth=depth, road=road)
    for k, out in enumerate(results):
        assert np.linalg.norm(out.odom_T_ego[:3, 3]) <= most_mps * k * STEP_NS / 1e9 + 1e-9


def test_without_depth_the_shape_of_the_path_is_right():
    _, results = run(photographed(), depth=False)
    assert statuses(results) == ["first"] + ["tracked"] * 11
    assert all(out.up_to_scale for out in results[1:])
    assert np.linalg.norm(results[1].step[:3, 3]) == pytest.approx(1.0, abs=0.05)
    scaled = poses(results)
    scaled[:, :3, 3] *= distances_m(np.array(POSES))[-1] / distances_m(scaled)[-1]
    shift, turn = relative_errors(scaled, np.array(POSES), (2.0, 4.0), every=1)
    assert shift < 0.05
    assert turn < 5.0


def test_the_road_gives_the_scale():
    _, results = run(photographed(), depth=False, road=ROAD)
    assert not any(out.up_to_scale for out in results)
    assert distances_m(poses(results))[-1] == pytest.approx(distances_m(np.array(POSES))[-1], rel=0.02)
    step, covariance = results[-1].step, np.reshape(results[-1].covariance, (6, 6))
    assert np.sqrt(covariance[0, 0]) > 0.02 * np.linalg.norm(step[:3, 3])  # the mounting's height


def test_the_scale_is_kept_while_depth_is_missing():
    blind = [Shot(s.grey, np.full_like(s.depth_m, np.nan)) if 3 <= k < 9 else s for k, s in enumerate(photographed())]
    _, results = run(blind)
    assert statuses(results) == ["first"] + ["tracked"] * 11
    assert not any(out.up_to_scale for out in results)
    assert np.linalg.norm((inverse(POSES[-1]) @ results[-1].odom_T_ego)[:3, 3]) < 0.1


def test_depth_with_holes_and_noise_that_grows():
    rng = np.random.default_rng(3)
    shots = []
    for shot in photographed():
        disparity = 160.0 / shot.depth_m + rng.normal(0, 0.3, shot.depth_m.shape)
        depth_m = (160.0 / np.maximum(disparity, 0.5)).astype(np.float32)
        depth_m[rng.random(depth_m.shape) < 0.2] = np.nan
        shots.append(Shot(shot.grey, depth_m))
    _, results = run(shots)
    assert relative_errors(poses(results), np.array(POSES), (4.0,), every=1)[0] < 0.02


def test_features_on_movable_objects_are_not_used():
    movable = np.zeros(CAMERA.size, bool)
    movable[:, 320:] = True
    states, results = run(photographed()[:3], movable=movable)
    assert states[0].keyframe.landmarks.features.px[:, 0].max() < 160
    assert statuses(results) == ["first", "tracked", "tracked"]


def test_no_image_is_absent_and_a_blank_image_is_skipped():
    assert isinstance(run([None])[1][0], Absent)
    blank = Shot(np.full(CAMERA.size, 90, np.uint8), photographed()[0].depth_m)
    for depth in (True, False):
        for features in ("klt", "orb", "sift"):
            _, results = run([blank, *photographed()[:2]], CFG.model_copy(update={"features": features}), depth=depth)
            assert statuses(results) == ["lost", "first", "tracked"]


@pytest.mark.parametrize(
    ("features", "matcher", "depth"),
    [("klt", "brute_force", True), ("klt", "brute_force", False), ("orb", "flann", False), ("sift", "flann", True)],
)
def test_a_second_run_and_a_resumed_run_give_equal_results(features, matcher, depth):
    cfg = CFG.model_copy(update={"features": features, "matcher": matcher})
    states, results = run(photographed()[:4], cfg, depth=depth)
    _, again = run(photographed()[:3], cfg, depth=depth)
    _, resumed = run(photographed()[2:4], cfg, pickle.loads(pickle.dumps(states[1])), first=2, depth=depth)
    assert same(tuple(results[:3]), tuple(again))
    assert same(tuple(results[2:]), tuple(resumed))


@pytest.mark.parametrize("missed", [0, 1])
def test_the_search_for_features_begins_where_a_steady_motion_predicts_them(missed):
    """The motion is steady, so the next two poses are known."""
    states, _ = run(photographed()[:4])
    state, frame = states[-1], 4 + missed
    stamp_ns = 1_000_000_000 + frame * STEP_NS
    scene = scene_of(CAMERA, EGO_T_CAMERA, depth_m=photographed()[frame].depth_m, stamp_ns=stamp_ns)
    view = tracking_frame(CFG, scene, photographed()[frame].grey, None)
    this = FollowedFrame(CFG, view, state.keyframe, state.last, state.odom_T_ego, state.pitch)
    (first, near, share), (second, anywhere, twice) = guesses(this)
    camera_T_key = inverse(POSES[frame] @ EGO_T_CAMERA) @ state.keyframe.odom_T_camera
    expected = project(view.camera, transform(camera_T_key, state.keyframe.landmarks.points_m))
    known = np.isfinite(near).all(axis=1)
    assert known.sum() > 50
    assert np.median(np.linalg.norm(near[known] - expected[known], axis=1)) < 1.0
    np.testing.assert_array_equal(first[known], near[known])
    np.testing.assert_array_equal(second, state.last.found_px)
    assert np.isnan(anywhere).all()
    np.testing.assert_allclose(state.last.velocity[[0, 1, 2]], [0.4 / 0.05, 0.0, 0.0], atol=0.2)
    np.testing.assert_allclose(state.last.velocity[[3, 4, 5]], [0.0, 0.0, 0.01 / 0.05], atol=0.02)
    assert (share, twice) == (MIN_VISIBLE_SHARE, 2 * MIN_VISIBLE_SHARE)
