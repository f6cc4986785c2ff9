"""The camera's pitch and the scale of steps without depth: from the motion, the road's image and vanishing points."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages.odometry import camera_pitch as cp
from roadperc_stream.chain.stages.odometry.ego_motion import Estimate, _levelled
from roadperc_stream.chain.stages.odometry.epipolar import motion_from_rays
from roadperc_stream.chain.stages.odometry.keyframes import counted_from_here
from roadperc_stream.chain.stages.odometry.motion import Motion
from roadperc_stream.chain.stages.odometry.road_image import road_motion, road_view
from roadperc_stream.chain.stages.surface.road import assumed_surface
from roadperc_stream.geometry.ground import tilted_ground
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.model import Reason
from tests.chain.stages.odometry.street import CAMERA, CFG, EGO_T_CAMERA, Shot, drive, photograph, pose, run
from tests.chain.stages.odometry.trajectories import distances_m

WRONG = np.deg2rad(1.5)
"""Pitch of the camera beyond its mounting, nose down."""
DOWN = EGO_T_CAMERA @ g.rigid(g.EGO_R_OPTICAL.T @ rotation_from_rpy(0, WRONG, 0) @ g.EGO_R_OPTICAL, np.zeros(3))
ROAD = assumed_surface(CAMERA, EGO_T_CAMERA)
POSES = drive(14, turn=0.005)


@pytest.fixture(scope="module")
def shots():
    return [photograph(p, ego_T_camera=DOWN) for p in POSES]


def lengths_m(results):
    return np.array([np.linalg.norm(out.step[:3, 3]) for out in results[1:]])


def test_measurements_are_fused_by_variance_and_an_outlier_counts_less():
    fused = cp.updated(cp.CameraPitch(0.0, 4e-4), (0.01, 1e-4))
    assert fused == cp.CameraPitch(pytest.approx(0.008), pytest.approx(0.8e-4), measured=True)
    pitch = cp.CameraPitch(0.0, 1e-4)
    near, far = (cp.updated(pitch, (value, 1e-4)) for value in (0.03, 0.3))
    assert near.offset == pytest.approx(0.015)
    assert 0 < far.offset < near.offset
    assert far.variance > near.variance
    assert cp.updated(pitch, None) is pitch


def test_the_pitch_turns_with_the_camera_and_its_variance_grows_with_distance():
    start = cp.CameraPitch(0.01, 1e-5)
    after = cp.predicted(CFG, start, g.rigid(rotation_from_rpy(0, 0.004, 0.1), np.array([0.5, 0, 0])), 0.1)
    assert after.offset == pytest.approx(0.014, abs=1e-4)
    farther = cp.predicted(CFG, start, g.rigid(np.eye(3), np.array([5.0, 0, 0])), 0.1)
    assert start.variance < after.variance < farther.variance
    assert cp.predicted(CFG, start, g.rigid(np.eye(3), np.array([1e3, 0, 0])), 50.0) == cp.begun(CFG)


def test_the_mountings_pitch_is_the_mean_over_the_driven_distance():
    pitch = cp.CameraPitch(0.01, 1e-4)
    assert cp.averaged(pitch, 1.0) is pitch
    for offset, variance in ((0.01, 1e-4), (0.02, 2e-4), (0.03, 1e-4)):
        pitch = cp.averaged(replace(pitch, offset=offset, variance=variance, measured=True), 2.0)
    assert pitch.mounting == pytest.approx(0.02)
    assert pitch.weight == pytest.approx(5e4)


@pytest.mark.parametrize("steps", [1, 100])
def test_the_variance_does_not_depend_on_the_frame_rate(steps):
    pitch = cp.CameraPitch(0.01, 1e-5, measured=True)
    for _ in range(steps):
        pitch = cp.predicted(CFG, pitch, g.rigid(np.eye(3), np.array([10 / steps, 0, 0])), 1 / steps)
    expected = 1e-5 + np.deg2rad(0.15) ** 2 * 10 + np.deg2rad(0.06) ** 2
    assert (pitch.offset, pitch.variance) == (pytest.approx(0.01), pytest.approx(expected))


def test_the_pitch_is_reset_after_a_long_loss_and_not_after_a_frame():
    known = cp.CameraPitch(0.02, 1e-5, measured=True)
    after = cp.after_loss(CFG, known, 0.1)
    assert after.offset == known.offset
    assert known.variance < after.variance < 3e-5
    assert cp.after_loss(CFG, known, 60.0) == cp.begun(CFG)


def motion_of(this_T_key_ego, std=1e-4):
    """The camera's motion from one of the ego frame, with random pulls of 100 features."""
    this_T_key = g.inverse(EGO_T_CAMERA) @ this_T_key_ego @ EGO_T_CAMERA
    pulls = np.random.default_rng(0).normal(0, std, (100, 6))
    return Motion(this_T_key, np.ones(100, bool), np.zeros((100, 3)), pulls, scaled=True)


PX = np.random.default_rng(1).uniform((0, 0), (640, 480), (100, 2)).astype(np.float32)


@pytest.mark.parametrize("ahead", [1.0, -1.0])
def test_the_direction_of_motion_shows_the_pitch_forwards_and_backwards(ahead):
    """A camera that looks down by more than its mounting seems to climb."""
    climbing = np.array([np.cos(WRONG), 0.0, np.sin(WRONG)]) * ahead
    elevation, variance = cp.expansion(motion_of(g.inverse(g.rigid(np.eye(3), climbing))), EGO_T_CAMERA, PX, 640)
    assert elevation == pytest.approx(WRONG)
    assert np.deg2rad(0.3) ** 2 < variance < np.deg2rad(0.4) ** 2


def test_the_direction_is_rejected_in_a_tight_bend_if_it_is_uncertain_and_at_rest():
    ahead = np.array([0.5, 0.0, 0.0])
    wide, tight = (g.inverse(g.rigid(rotation_from_rpy(0, 0, turn), ahead)) for turn in (0.02, 0.03))
    assert cp.expansion(motion_of(wide), EGO_T_CAMERA, PX, 640) is not None
    for rejected in (motion_of(tight), motion_of(wide, std=0.01), motion_of(np.eye(4))):
        assert cp.expansion(rejected, EGO_T_CAMERA, PX, 640) is None


def test_the_tilted_ground_keeps_the_cameras_height_and_has_the_pitch():
    plane = g.transform_plane(g.inverse(EGO_T_CAMERA), tilted_ground(EGO_T_CAMERA, WRONG))
    assert plane.offset_m == pytest.approx(EGO_T_CAMERA[2, 3])
    assert g.camera_pitch_roll(plane) == pytest.approx((WRONG, 0.0))
    assert tilted_ground(EGO_T_CAMERA, 0.0) == g.Plane((0.0, 0.0, 1.0), 0.0)


def road_between(first, second, tried_m=(0.0, 3.0), believed=0.0, grey=None):
    """The motion by the road's image between two poses of the camera DOWN, with known rotation and direction."""
    this_T_key = g.inverse(second @ DOWN) @ first @ DOWN
    t = this_T_key[:3, 3] / np.linalg.norm(this_T_key[:3, 3])
    plane = g.transform_plane(g.inverse(EGO_T_CAMERA), tilted_ground(EGO_T_CAMERA, believed))
    view = road_view(CAMERA, EGO_T_CAMERA, plane, photograph(first, ego_T_camera=DOWN).grey)
    this = photograph(second, ego_T_camera=DOWN).grey if grey is None else grey
    return road_motion(view, this, None, (this_T_key[:3, :3], t), tried_m, is_expected=True, parallax_px=0.0)


def test_the_roads_image_gives_length_and_pitch():
    right = road_between(pose(0), pose(0.5, yaw=0.01), believed=WRONG)
    true_m = np.linalg.norm((g.inverse(pose(0) @ DOWN) @ pose(0.5, yaw=0.01) @ DOWN)[:3, 3])
    assert right.length_m == pytest.approx(true_m, rel=0.01)
    assert abs(right.pitch) < np.deg2rad(0.3)
    low = road_between(pose(0), pose(0.5, yaw=0.01), believed=WRONG - np.deg2rad(0.3))
    assert low.length_m > right.length_m
    assert low.pitch > right.pitch
    assert low.length_m + low.metres_per_pitch * np.deg2rad(0.3) == pytest.approx(right.length_m, rel=0.01)


def test_the_road_gives_no_length_without_texture_or_if_no_length_fits():
    flat = np.full(CAMERA.size, 90, np.uint8)
    other = np.random.default_rng(0).integers(0, 255, CAMERA.size).astype(np.uint8)
    assert road_between(pose(0), pose(0.5), grey=flat, believed=WRONG) is None
    assert road_between(pose(0), pose(0.5), grey=other, believed=WRONG) is None
    assert road_between(pose(0), pose(0.5), tried_m=(1.0, 2.0), believed=WRONG) is None
    up = g.Plane.of(np.array([0.0, -1.0, 2.0]), 1.4)
    assert road_view(CAMERA, EGO_T_CAMERA, up, np.zeros(CAMERA.size, np.uint8)) is None


def test_parts_of_the_road_that_disagree_enlarge_the_variance_of_the_length():
    right, farther = (photograph(pose(x), ego_T_camera=DOWN).grey for x in (0.5, 0.8))
    mixed = right.copy()
    mixed[:, 320:] = farther[:, 320:]
    whole = road_between(pose(0), pose(0.5), grey=right, believed=WRONG)
    found = road_between(pose(0), pose(0.5), grey=mixed, believed=WRONG)
    assert found is None or found.variance > (2 * np.sqrt(whole.variance) + 0.02) ** 2


def test_the_road_ahead_follows_the_bend_and_has_no_movable_objects():
    def view(movable=None, bend_per_m=0.0):
        plane = g.transform_plane(g.inverse(EGO_T_CAMERA), g.Plane((0.0, 0.0, 1.0), 0.0))
        return road_view(CAMERA, EGO_T_CAMERA, plane, np.zeros(CAMERA.size, np.uint8), movable, bend_per_m)

    assert abs(np.median(view().rays[:, 0])) < 0.02
    assert np.median(view(bend_per_m=0.1).rays[:, 0]) < -0.1
    farthest_m = 1.4 / view(bend_per_m=0.1).rays[:, 1].min()
    assert farthest_m == pytest.approx(8.0, rel=0.05)
    car = np.zeros(CAMERA.size, np.uint8)
    car[:, 320:] = 1
    assert view(car).rays[:, 0].max() < 0.01


def test_a_wrong_pitch_of_the_mounting_is_corrected(shots):
    states, results = run(shots, depth=False, road=ROAD)
    true_m = np.diff(distances_m(np.array([p @ DOWN for p in POSES])))
    assert [out.up_to_scale for out in results[1:]] == [False] * 13
    assert np.median(np.abs(lengths_m(results) / true_m - 1)) < 0.02
    assert lengths_m(results).sum() == pytest.approx(true_m.sum(), rel=0.03)
    pitch = states[-1].pitch
    assert abs(pitch.offset - WRONG) < 2 * np.sqrt(pitch.variance) < np.deg2rad(0.5)
    assert abs(results[-1].odom_T_ego[2, 3]) < 0.2 * np.sin(WRONG) * lengths_m(results).sum()


def test_the_pose_stays_level_after_a_new_origin(shots):
    states, _ = run(shots[:6], depth=False, road=ROAD)
    _, results = run(shots[6:], state=counted_from_here(states[-1]), first=6, depth=False, road=ROAD)
    assert abs(results[-1].odom_T_ego[2, 3]) < 0.2 * np.sin(WRONG) * 8 * 0.4


def test_the_pose_of_a_long_drive_is_still_a_rotation(shots):
    """The error of one frame must not be doubled by the next one."""
    keyframe, pitch = run(shots[:3], depth=False, road=ROAD)[0][-1].keyframe, cp.CameraPitch(WRONG, 1e-5, measured=True)
    step = g.rigid(rotation_from_rpy(0.001, 0.002, 0.03), np.array([0.5, 0.0, 0.0]))
    for _ in range(200):
        odom_T_ego = keyframe.odom_T_camera @ g.inverse(EGO_T_CAMERA) @ step
        odom_T_ego, keyframe, pitch = _levelled(Estimate(None, None, odom_T_ego, pitch, 0), keyframe, 0.5)
    np.testing.assert_allclose(odom_T_ego[:3, :3] @ odom_T_ego[:3, :3].T, np.eye(3), atol=1e-9)


def test_a_fixed_pitch_is_not_corrected(shots):
    states, results = run(shots[:6], CFG.model_copy(update={"pitch_std_deg": 0.0}), depth=False, road=ROAD)
    assert (states[-1].pitch.offset, states[-1].pitch.variance, states[-1].pitch.measured) == (0.0, 0.0, False)
    assert np.median(lengths_m(results)) > 1.05 * 0.4


def blind(shot):
    """The shot with a road without texture."""
    grey = shot.grey.copy()
    grey[240:] = 90
    return Shot(grey, shot.depth_m)


def test_on_a_road_without_texture_points_carry_the_scale_with_growing_variance(shots):
    _, results = run([*shots[:6], *map(blind, shots[6:9])], depth=False, road=ROAD)
    carried = results[6:]
    assert [str(out.reason) for out in carried[:3]] == [str(Reason("odometry", "scale_by_points"))] * 3
    assert not any(out.up_to_scale for out in carried[:3])
    assert lengths_m(results)[5:8] == pytest.approx([0.4] * 3, rel=0.05)
    stds = [np.sqrt(np.reshape(out.covariance, (6, 6))[0, 0]) for out in results[3:9]]
    assert stds[5] > stds[3] > stds[2]

    _, results = run(list(map(blind, shots[:3])), depth=False, road=ROAD)
    assert [out.up_to_scale for out in results[1:]] == [True] * 2
    assert {str(out.reason) for out in results[1:]} == {str(Reason("odometry", "scale_unknown"))}


def test_the_pulls_of_a_motion_by_rays_are_its_scatter():
    rng = np.random.default_rng(2)
    X = g.unproject(CAMERA, rng.uniform((40, 40), (600, 440), (200, 2)), rng.uniform(4, 40, 200))
    this_T_key = g.rigid(rotation_from_rpy(0, 0.01, 0), np.array([0.03, 0.01, -0.6]))
    unknown, key_px, found = np.full_like(X, np.nan), g.project(CAMERA, X).astype(np.float32), []
    for _ in range(40):
        px = g.project(CAMERA, g.transform(this_T_key, X)) + rng.normal(0, 0.2, (200, 2))
        found.append(motion_from_rays(CAMERA, key_px, px.astype(np.float32), unknown, 0.6))
    sideways = np.std([m.this_T_key[:2, 3] for m in found], axis=0)
    claimed = np.sqrt(np.mean([np.diag(m.influence.T @ m.influence)[:2] for m in found], axis=0))
    assert ((sideways / claimed > 0.6) & (sideways / claimed < 1.6)).all()


_SUBPIXEL_BITS = 6


def picture(stripes_px):
    """White polygons on grey."""
    image = np.full(CAMERA.size, 90, np.uint8)
    for corners in stripes_px:
        fixed = np.rint(np.array(corners) * 2**_SUBPIXEL_BITS).astype(np.int32)
        cv2.fillConvexPoly(image, fixed, 220, cv2.LINE_AA, _SUBPIXEL_BITS)
    return cv2.GaussianBlur(image, (0, 0), 0.8)


def stripe(start, end, end_width=1.0):
    """Corners of a stripe, eight pixels wide at its start and ``end_width`` times that at its end."""
    start, end = np.array(start, float), np.array(end, float)
    half = np.array([4.0, 0.0]) if abs(end[1] - start[1]) > 1 else np.array([0.0, 4.0])
    return start - half, start + half, end + end_width * half, end - end_width * half


def stripes_to(point, sides=(-300, -200, -100, -40, 60, 140, 220, 310)):
    """Markings from the image's lower edge towards a point, without reaching it."""
    bottom = [np.array([320.0 + side, 470.0]) for side in sides]
    return [stripe(start, start + 0.7 * (np.array(point) - start), 0.3) for start in bottom]


def random_stripes():
    rng = np.random.default_rng(3)
    for start, angle in zip(rng.uniform((60, 60), (560, 400), (24, 2)), rng.uniform(0.3, 2.8, 24), strict=True):
        yield stripe(start, start + 140 * np.array([np.cos(angle), np.sin(angle)]))


def point_at(elevation_deg, bearing=0.0):
    """The pixel of a direction with an elevation above the horizon."""
    return g.project(CAMERA, np.array([bearing, -np.tan(np.deg2rad(elevation_deg)), 1.0]))


@pytest.mark.parametrize(("elevation_deg", "bearing"), [(-2.0, 0.0), (0.0, 0.2), (3.0, 0.2)])
def test_the_vanishing_point_is_on_the_horizon(elevation_deg, bearing):
    image = picture(stripes_to(point_at(elevation_deg, bearing)))
    pitch, variance = cp.pitch_by_lines(CAMERA, EGO_T_CAMERA, image, None)
    assert np.rad2deg(pitch) == pytest.approx(elevation_deg, abs=0.2)
    assert cp.LINES_STD**2 <= variance < (2 * cp.LINES_STD) ** 2


@pytest.mark.parametrize(
    "segments",
    [
        pytest.param([], id="no lines"),
        pytest.param(stripes_to(point_at(0.0), (-200, 200)), id="two lines"),
        pytest.param(stripes_to(point_at(15.0)), id="a point high above the horizon"),
        pytest.param([stripe((20, y), (620, y)) for y in range(260, 460, 25)], id="lines across the view"),
        pytest.param([stripe((x, 470), (x + 150, 300)) for x in range(10, 450, 50)], id="parallel in the image"),
        pytest.param(list(random_stripes()), id="random lines"),
    ],
)
def test_lines_without_a_common_point_near_the_horizon_are_rejected(segments):
    assert cp.pitch_by_lines(CAMERA, EGO_T_CAMERA, picture(segments), None) is None


def test_lines_on_movable_objects_do_not_count():
    image = picture(stripes_to(point_at(2.0)))
    assert cp.pitch_by_lines(CAMERA, EGO_T_CAMERA, image, np.zeros(CAMERA.size, np.uint8)) is not None
    assert cp.pitch_by_lines(CAMERA, EGO_T_CAMERA, image, np.ones(CAMERA.size, np.uint8)) is None


def test_the_first_frame_uses_the_lines_but_they_are_not_sufficient_alone():
    shot = Shot(picture(stripes_to(point_at(2.0))), np.full(CAMERA.size, 10.0, np.float32))
    (state,), _ = run([shot], depth=False)
    assert 0.8 * 2.0 < np.rad2deg(state.pitch.offset) < 2.2
    assert state.pitch.variance < cp.LINES_STD**2
    assert not state.pitch.measured
    (with_depth,), _ = run([shot])
    assert with_depth.pitch.offset == 0.0
    (fixed,), _ = run([shot], CFG.model_copy(update={"pitch_std_deg": 0.0}), depth=False)
    assert fixed.pitch.offset == 0.0
