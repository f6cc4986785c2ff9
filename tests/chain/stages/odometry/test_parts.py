"""Functions of odometry against known answers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages.odometry import epipolar
from roadperc_stream.chain.stages.odometry.alignment import aligned
from roadperc_stream.chain.stages.odometry.epipolar import motion_from_rays
from roadperc_stream.chain.stages.odometry.features import FRONTENDS, MAX_POINTS, spread, tracking_frame
from roadperc_stream.chain.stages.odometry.keyframes import (
    local_planes_from_depth,
    make_keyframe,
    slope_of_plane,
    stretch,
)
from roadperc_stream.chain.stages.odometry.motion import (
    linearise,
    motion_from_points,
    moved,
    scatter,
    step_covariance,
)
from roadperc_stream.geometry.rotations import rotation_from_rpy
from tests.chain.stages.odometry.street import CAMERA, CFG, EGO_T_CAMERA, photograph, pose
from tests.scenes import scene_of

small = st.floats(-0.05, 0.05)
motions = st.builds(
    lambda rx, ry, rz, x, y, z: g.rigid(Rotation.from_rotvec((rx, ry, rz)).as_matrix(), np.array([x, y, z])),
    *[small] * 3,
    *[st.floats(-0.2, 0.2)] * 2,
    st.floats(-1.0, -0.3),
)


def cloud(count=200, seed=0):
    """(N, 3) visible points in the camera frame."""
    rng = np.random.default_rng(seed)
    px = rng.uniform((40, 40), (600, 440), (count, 2))
    return g.unproject(CAMERA, px, rng.uniform(4, 40, count))


def pixels_of(this_T_key, X):
    return g.project(CAMERA, g.transform(this_T_key, X)).astype(np.float32)


@settings(max_examples=15)
@given(this_T_key=motions)
def test_points_give_the_motion_despite_outliers_and_incomplete_pixels(this_T_key):
    X = cloud()
    px = pixels_of(this_T_key, X)
    px[::5] += 15
    px[1::5, 1] = np.nan
    motion = motion_from_points(CAMERA, X, px)
    np.testing.assert_allclose(motion.this_T_key, this_T_key, atol=1e-4)
    np.testing.assert_array_equal(motion.inliers, np.arange(len(X)) % 5 > 1)


@settings(max_examples=15)
@given(this_T_key=motions)
def test_rays_give_rotation_direction_and_length(this_T_key):
    X = cloud()
    px, known = pixels_of(this_T_key, X), X.copy()
    known[30:] = np.nan
    motion = motion_from_rays(CAMERA, pixels_of(np.eye(4), X), px, known, 1.0)
    np.testing.assert_allclose(motion.this_T_key, this_T_key, atol=2e-3)
    assert motion.scaled
    filled = np.isfinite(motion.points_m[30:, 0])
    assert filled.sum() > 50
    np.testing.assert_allclose(motion.points_m[30:][filled] / X[30:][filled], 1.0, atol=0.2)


def test_without_known_points_a_motion_has_the_fallback_length_and_a_turn_has_none():
    X = cloud()
    ahead, turn = moved(np.array([0.05, 0.0, -0.6, 0.0, 0.02, 0.0])), moved(np.array([0, 0, 0, 0.01, -0.03, 0.005]))
    motion, turned = (
        motion_from_rays(CAMERA, pixels_of(np.eye(4), X), pixels_of(T, X), np.full_like(X, np.nan), 3.0)
        for T in (ahead, turn)
    )
    assert not motion.scaled
    assert np.linalg.norm(motion.this_T_key[:3, 3]) == pytest.approx(3.0)
    np.testing.assert_allclose(turned.this_T_key, turn, atol=1e-5)
    assert turned.influence is None


def test_a_camera_that_finds_only_far_features_again_does_not_stand_still():
    ahead, X = moved(np.array([0.0, 0.0, -3.0, 0.0, 0.0, 0.0])), cloud(100)
    X[:20] *= 100
    px = pixels_of(ahead, X)
    px[20:] = np.nan
    lengths = [
        np.linalg.norm(motion_from_rays(CAMERA, pixels_of(np.eye(4), X), found, X, 1.0).this_T_key[:3, 3])
        for found in (px, pixels_of(np.eye(4), X))
    ]
    assert lengths[0] > 0.5
    assert lengths[1] == 0.0


def off_by(px, Z=5.0):
    """Residuals and derivatives of a point on the optical axis that is found ``px`` to the right of it."""
    return linearise(CAMERA, np.array([(0.0, 0.0, Z)]), np.array([(CAMERA.cx + px, CAMERA.cy)]), np.eye(4))


def test_residuals_are_in_standard_deviations_and_large_ones_count_less_or_not_at_all():
    std_px = 0.5 * CAMERA.height / 960
    (near, J, _), (far, J_far, _), (lost, _, agrees) = (off_by(k * std_px) for k in (1.0, 3.0, 4.1))
    np.testing.assert_allclose(near, (1.0, 0.0))
    np.testing.assert_allclose(far, (3.0 / np.sqrt(2.0), 0.0))
    np.testing.assert_allclose(J_far[0], J[0] / np.sqrt(2.0))
    assert (lost.any(), agrees.tolist()) == (False, [False])
    for Z in (0.1, 0.0, -5.0):
        assert not any(part.any() for part in off_by(0.0, Z))


def test_derivatives_are_those_of_differences():
    X, T = cloud(50), moved(np.array((0.1, 0.2, 0.5, 0.02, -0.03, 0.01)))
    px = g.project(CAMERA, g.transform(T, X))
    J = linearise(CAMERA, X, px, T)[1]
    for k, step in enumerate(1e-6 * np.eye(6)):
        after, before = (linearise(CAMERA, X, px, moved(sign * step) @ T)[0] for sign in (1, -1))
        np.testing.assert_allclose(-(after - before) / 2e-6, J[:, k], rtol=1e-5, atol=1e-4)


def test_the_depths_error_counts_by_the_pixel_shift_that_it_causes(monkeypatch):
    monkeypatch.setattr("roadperc_stream.chain.stages.odometry.motion._DEPTH_STD_PER_M", 0.01)
    X, ahead = np.array([(3.0, 0.0, 10.0)]), moved(np.array((0.0, 0.0, -2.0, 0.0, 0.0, 0.0)))
    px = g.project(CAMERA, g.transform(ahead, X)) + np.array((3.0, 0.0))
    shift_px = CAMERA.fx * abs(3.3 / 9.0 - 2.7 / 7.0) / 2  # for one standard deviation, a metre, to either side
    (off, _), _, _ = linearise(CAMERA, X, px, ahead)
    assert off == pytest.approx(3.0 / np.hypot(0.5 * CAMERA.height / 960, shift_px), rel=0.02)


def seen(this_T_key, X, seed, noise_px=0.3, outliers=0.2):
    """(N, 2) noisy pixels of points after a motion."""
    rng = np.random.default_rng(seed)
    px = pixels_of(this_T_key, X) + rng.normal(0, noise_px, (len(X), 2))
    px += 4 * rng.standard_normal(px.shape) * (rng.random((len(X), 1)) < outliers)
    return px.astype(np.float32)


def test_a_sample_of_a_wrong_direction_loses_to_the_expected_motion(monkeypatch):
    monkeypatch.setattr(epipolar, "_by_sampling", lambda *_: (np.eye(3), np.array([1.0, 0.0, 0.0])))
    ahead, X = moved(np.array([0.0, 0.0, -0.6, 0.0, 0.0, 0.0])), cloud()
    key_px, px, unknown = pixels_of(np.eye(4), X), seen(ahead, X, 0), np.full_like(X, np.nan)
    wrong, right = (motion_from_rays(CAMERA, key_px, px, unknown, 1.0, expected) for expected in (None, ahead))
    assert wrong.this_T_key[2, 3] > -0.5
    np.testing.assert_allclose(right.this_T_key[:3, 3], (0.0, 0.0, -1.0), atol=0.05)


@pytest.mark.parametrize("seed", range(10))
def test_a_car_that_is_expected_to_drive_ahead_may_reverse(seed):
    ahead, X = moved(np.array([0.0, 0.0, -0.6, 0.0, 0.0, 0.0])), cloud()
    px = seen(g.inverse(ahead), X, seed)
    back = motion_from_rays(CAMERA, pixels_of(np.eye(4), X), px, np.full_like(X, np.nan), 1.0, ahead)
    assert back.this_T_key[2, 3] > 0.9


def test_too_few_features_give_no_covariance():
    pulls, px = np.ones((7, 6)), np.zeros((7, 2), np.float32)
    assert scatter(pulls[:6], px[:6], CAMERA.width) is None
    assert scatter(pulls, px, CAMERA.width) is not None
    assert step_covariance(px[:6], CAMERA.width, pulls[:6], 0 * pulls[:6], np.eye(4), 0.0) == ()


def test_the_covariance_is_the_scatter():
    this_T_key, X = moved(np.array([0.05, 0.0, -0.5, 0.0, 0.02, 0.0])), cloud()
    rng, px, errors, variances = np.random.default_rng(1), pixels_of(this_T_key, X), [], []
    for _ in range(100):
        noisy = px + rng.normal(0, 0.2, px.shape).astype(np.float32)
        motion = motion_from_points(CAMERA, X, noisy)
        error = motion.this_T_key @ g.inverse(this_T_key)
        errors.append(np.concatenate((error[:3, 3], Rotation.from_matrix(error[:3, :3]).as_rotvec())))
        variances.append(np.diag(scatter(motion.influence, px, CAMERA.width)))
    ratio = np.std(errors, axis=0) / np.sqrt(np.mean(variances, axis=0))
    assert ((ratio > 0.6) & (ratio < 1.5)).all()


def spread_px(count=400, seed=3):
    return np.random.default_rng(seed).uniform((0, 0), CAMERA.size[::-1], (count, 2)).astype(np.float32)


def test_the_scatter_of_independent_features_is_twice_the_sum_of_their_variances():
    """Once over features and once over cells, so it is cautious for independent errors."""
    rng, px = np.random.default_rng(0), spread_px()
    pulls = [rng.normal(0, 0.01, (400, 6)) for _ in range(50)]
    variance = np.mean([np.diag(scatter(pull, px, CAMERA.width)) for pull in pulls], axis=0)
    np.testing.assert_allclose(variance, 2 * 400 * 0.01**2, rtol=0.1)


def test_features_that_err_together_scatter_more_than_their_sum():
    px, rng = spread_px(), np.random.default_rng(1)
    per_cell = rng.normal(0, 0.01, (8, 8, 6))
    column, row = (px // (CAMERA.width / 8)).astype(int).T
    together = np.diag(scatter(per_cell[row, column], px, CAMERA.width))
    alone = np.diag(scatter(rng.permutation(per_cell[row, column]), px, CAMERA.width))
    assert (together > 2 * alone).all()


def test_equal_pulls_on_both_poses_cancel_in_the_covariance_of_the_step():
    """Only the systematic share of the step remains."""
    px, pulls = spread_px(), np.random.default_rng(2).normal(0, 0.01, (400, 6))
    step = g.rigid(rotation_from_rpy(0.0, 0.01, 0.02), np.array([0.5, 0.02, 0.0]))
    last = pulls @ g.adjoint(step).T
    shared = np.reshape(step_covariance(px, CAMERA.width, pulls, last, step, 0.0), (6, 6))
    assert np.sqrt(np.trace(shared)) == pytest.approx(0.001 * np.linalg.norm(step[:3, 3]), rel=1e-6)
    apart = np.reshape(step_covariance(px, CAMERA.width, pulls, np.zeros_like(last), step, 0.0), (6, 6))
    assert np.trace(apart) > 1e3 * np.trace(shared)
    longer = np.reshape(step_covariance(px, CAMERA.width, pulls, last, step, 0.04), (6, 6))
    along = g.inverse(step)[:3, 3] / np.linalg.norm(step[:3, 3])
    assert along @ (longer - shared)[:3, :3] @ along == pytest.approx(0.04)
    assert step_covariance(px, CAMERA.width, None, last, step, 0.0) == ()
    assert step_covariance(px, CAMERA.width, pulls, None, step, 0.0) == ()


@pytest.mark.parametrize("points", [0, 5])
def test_too_few_points_give_no_motion(points):
    X = cloud(points)
    assert motion_from_points(CAMERA, X, pixels_of(np.eye(4), X)) is None
    assert motion_from_rays(CAMERA, pixels_of(np.eye(4), X), pixels_of(np.eye(4), X), X, 1.0) is None


@settings(max_examples=10)
@given(nx=st.floats(-0.3, 0.3), nz=st.floats(-0.3, 0.3), shrink=st.sampled_from([1, 2]))
def test_local_planes_of_a_plane_are_exact(nx, nz, shrink):
    plane = g.Plane.of(np.array([nx, -1.0, nz - 1.0]), 12.0)
    rows, columns = np.indices(CAMERA.size, dtype=float)
    depth_m = g.intersect_plane(CAMERA, np.stack((columns, rows), axis=-1), plane)[..., 2].astype(np.float32)
    px = np.random.default_rng(0).uniform(20, 200, (30, 2))
    full = px * shrink + (shrink - 1) / 2
    expected = 1 / g.intersect_plane(CAMERA, full, plane)[:, 2]
    inverse_depth, slope = local_planes_from_depth(depth_m, px, shrink)
    # Up to 100 m: farther points are not used, and near the horizon some neighbours of a pixel lie beyond it.
    fine = np.isfinite(expected) & (expected > 1e-2)
    np.testing.assert_allclose(inverse_depth[fine], expected[fine], rtol=1e-4)
    np.testing.assert_allclose(slope[fine], np.tile(slope_of_plane(CAMERA, plane) * shrink, (fine.sum(), 1)), atol=1e-5)


def test_local_planes_do_not_mix_both_sides_of_an_edge_and_are_unknown_in_holes():
    depth_m = np.full((60, 60), 5.0, np.float32)
    depth_m[:, 30:] = 20.0
    depth_m[:20] = np.nan
    inverse_depth, slope = local_planes_from_depth(depth_m, np.array([[29.0, 40.0], [30.0, 40.0], [10.0, 10.0]]), 1)
    np.testing.assert_allclose(1 / inverse_depth, [5.0, 20.0, np.nan], rtol=1e-6)
    np.testing.assert_allclose(slope[:2], 0.0, atol=1e-7)


def test_a_patch_seen_from_half_the_distance_is_twice_as_large():
    px = np.array([[CAMERA.cx, CAMERA.cy]])
    half = moved(np.array([0.0, 0.0, -5.0, 0.0, 0.0, 0.0]))
    got = stretch(CAMERA, px, np.array([10.0]), np.zeros((1, 2)), half)
    np.testing.assert_allclose(got[0], 2 * np.eye(2), atol=1e-9)


def test_points_are_spread_over_the_image():
    rng = np.random.default_rng(0)
    px = np.concatenate((rng.uniform(0, 100, (5000, 2)), rng.uniform(0, (640, 480), (300, 2)))).astype(np.float32)
    chosen = spread(px, rng.random(len(px)).astype(np.float32), CAMERA.size)
    assert (px[chosen] < 100).all(axis=1).mean() < 0.2
    assert len(set(chosen.tolist())) == len(chosen) <= MAX_POINTS


@pytest.mark.parametrize("size", [(376, 1242), (480, 1920), (480, 640)])
def test_points_reach_every_edge_of_an_image_of_any_shape(size):
    rows, columns = np.indices(size)[:, ::4, ::4].reshape(2, -1)
    px = np.stack((columns, rows), axis=-1).astype(np.float32)
    chosen = px[spread(px, np.random.default_rng(0).random(len(px)).astype(np.float32), size)]
    assert 0.9 * MAX_POINTS <= len(chosen) <= MAX_POINTS
    for axis, length in ((0, size[1]), (1, size[0])):
        share = np.histogram(chosen[:, axis], bins=8, range=(0, length))[0] / len(chosen)
        assert share.min() > 0.07


@pytest.mark.parametrize("features", ["klt", "orb", "sift"])
def test_a_shifted_image_is_matched_to_sub_pixels(features):
    cfg = CFG.model_copy(update={"features": features})
    before, after = photograph(pose(0)).grey, photograph(pose(0, yaw=0.02)).grey
    front = FRONTENDS[features]
    found, strength = front.detect(before, np.ones_like(before))
    found = found.take(spread(found.px, strength, before.shape))
    px = front.match(cfg, before, found, found.px, after)
    turn = EGO_T_CAMERA[:3, :3].T @ rotation_from_rpy(0, 0, -0.02) @ EGO_T_CAMERA[:3, :3]
    about_lens = g.rays(CAMERA, found.px.astype(float)) @ turn.T
    kept = np.isfinite(px[:, 0])
    assert kept.sum() > 80
    far = kept & (found.px[:, 1] < 250)
    # The lens is 1.5 m ahead of the axis and moves 3 cm sideways, which shifts far points by less than 2 px.
    assert np.median(np.abs(px - g.project(CAMERA, about_lens))[far]) < 1.5


@pytest.mark.parametrize(
    ("rows", "columns", "shrink"),
    [(480, 640, 2), (960, 1280, 4), (478, 640, 1), (481, 640, 1), (480, 641, 1), (482, 642, 2), (240, 640, 1)],
)
def test_an_image_is_halved_while_its_size_is_even_and_enough_rows_remain(rows, columns, shrink):
    camera = replace(CAMERA, width=columns, height=rows)
    frame = tracking_frame(CFG, scene_of(camera, EGO_T_CAMERA), np.zeros((rows, columns), np.uint8), None)
    assert frame.shrink == shrink
    assert frame.grey.shape == frame.camera.size == (rows // shrink, columns // shrink)


@pytest.mark.parametrize("shrink", [1, 2, 4])
def test_pixels_of_the_tracked_image_are_converted_to_the_frame(shrink):
    camera = g.Camera("front", 640, 240 * shrink, 300.0, 310.0, 333.0, 111.0)
    frame = tracking_frame(CFG, scene_of(camera, EGO_T_CAMERA), np.zeros(camera.size, np.uint8), None)
    X = np.array([[1.0, -0.5, 7.0], [-2.0, 0.4, 20.0]])
    assert frame.shrink == shrink
    np.testing.assert_allclose(frame.whole(g.project(frame.camera, X)), g.project(camera, X), rtol=1e-6)


def test_movable_objects_are_avoided_with_a_margin():
    """20 px of 960 rows are 5 of 240, so a margin of two pixels surrounds each object."""
    tags = np.full((480, 640), 7, np.uint8)
    tags[200:210, 300:320] = 10  # a vehicle
    frame = tracking_frame(CFG, scene_of(CAMERA, EGO_T_CAMERA, tags=tags), np.zeros((480, 640), np.uint8), None)
    rows, columns = np.nonzero(frame.movable)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (98, 106, 148, 161)
    px = np.float32([[148, 98], [161.4, 106.4], [147, 100], [162, 100], [150, 97], [150, 107], [np.nan, 100]])
    np.testing.assert_array_equal(frame.on_movable(px), [True, True, False, False, False, False, False])
    without_tags = tracking_frame(CFG, scene_of(CAMERA, EGO_T_CAMERA), np.zeros((480, 640), np.uint8), None)
    assert not without_tags.on_movable(px).any()


def test_landmarks_have_the_depths_points_and_are_not_aligned_outside_the_image():
    shot = photograph(pose(0))
    frame = tracking_frame(CFG, scene_of(CAMERA, EGO_T_CAMERA, depth_m=shot.depth_m), shot.grey, None)
    keyframe = make_keyframe(CFG, frame, EGO_T_CAMERA)
    landmarks = keyframe.landmarks
    assert (landmarks.source, landmarks.metric) == ("depth", True)
    heights = g.transform(EGO_T_CAMERA, landmarks.points_m)
    on_plane = [np.abs(heights[:, 2]), np.abs(heights[:, 1] - 7), np.abs(heights[:, 1] + 6), np.abs(heights[:, 0] - 45)]
    assert np.quantile(np.min(on_plane, axis=0), 0.95) < 0.01
    behind = g.rigid(np.eye(3), np.array([0.0, 0.0, -1e3]))
    px, predicted_px = aligned(keyframe, frame, behind)
    assert px.shape == landmarks.features.px.shape
    assert len(px) > 20
    assert np.isnan(px).all()
    assert np.isnan(predicted_px).all()


@pytest.mark.parametrize("features", ["klt", "orb", "sift"])
def test_images_too_small_for_a_feature_have_none(features):
    cfg = CFG.model_copy(update={"features": features})
    for shape in ((1, 1), (1, 400), (400, 1), (2, 2)):
        grey = np.zeros(shape, np.uint8)
        found, strength = FRONTENDS[features].detect(grey, np.ones_like(grey))
        assert (found.px.shape, strength.shape) == ((0, 2), (0,))
        assert FRONTENDS[features].match(cfg, grey, found, found.px, grey).shape == (0, 2)
