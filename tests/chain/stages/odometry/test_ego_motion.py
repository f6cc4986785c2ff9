"""Odometry over frames with known motion."""

import pickle
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from roadperc_stream.chain.stages.surface.road import assumed_surface
from roadperc_stream.geometry import inverse
from roadperc_stream.model import Absent, Reason
from tests.chain.stages.odometry.street import CAMERA, CFG, EGO_T_CAMERA, STEP_NS, Shot, drive, photograph, pose, run
from tests.chain.stages.odometry.trajectories import angle_deg, distances_m, relative_errors
from tests.chain.test_chain import same

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
