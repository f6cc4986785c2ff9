"""The odometry on recordings and on rendered drives, against what is known of them."""

import json

import cv2
import numpy as np
import pytest

from roadperc_stream.config import OdometryConfig
from roadperc_stream.geometry import EGO_R_OPTICAL, Camera, inverse, level_mounting, rigid
from roadperc_stream.semantics import CARLA_FROM_0_9_14
from roadperc_stream.stages import odometry
from roadperc_stream.stages.odometry import OdometryState
from roadperc_stream.stages.surface import assumed_surface
from roadperc_stream.tools import render_scene
from roadperc_stream.tools.carla_dump.carla_poses import load_poses
from roadperc_stream.tools.carla_dump.depth_files import carla_metres
from tests.stages.odometry.trajectories import aligned_errors_m, angle_deg, distances_m, relative_errors

CFG = OdometryConfig()
SATURATED_M = np.float32(65.535)
"""Where 16-bit depth in millimetres ends, as the converted log has it."""
MOVABLE = CARLA_FROM_0_9_14.lookup(("vehicle", "pedestrian"))


def calibrated(folder):
    known = json.loads((folder / "calibration.json").read_text())
    K = np.array(known["K"])
    size = known["width"], known["height"]
    return Camera("front", *size, K[0, 0], K[1, 1], K[0, 2] - 0.5, K[1, 2] - 0.5), known.get("mounting")


def pictures(folder):
    """Grey, depth and movable mask of every frame; None where there is none."""
    for path in sorted((folder / "rgb").iterdir()):
        depth, tags = (folder / sensor / f"{path.stem}.png" for sensor in ("depth", "segmentation"))
        yield (
            cv2.imread(str(path), cv2.IMREAD_GRAYSCALE),
            np.minimum(carla_metres(cv2.imread(str(depth))), SATURATED_M) if depth.exists() else None,
            cv2.LUT(cv2.imread(str(tags))[..., 2], MOVABLE).view(bool) if tags.exists() else None,
        )


def follow(frames, camera, ego_T_camera, cfg=CFG, depth=True, tags=True, road=None, rate_hz=20):
    state, results = OdometryState(), []
    for k, (grey, depth_m, movable) in enumerate(frames):
        state, out = odometry.step(
            cfg,
            state,
            camera,
            ego_T_camera,
            grey,
            depth_m if depth else None,
            movable if tags else None,
            road,
            np.random.default_rng((0, k)),
            round(1e9 * (1 + k / rate_hz)),
        )
        results.append(out)
    return results


def poses(results):
    return np.array([out.odom_T_ego for out in results])


@pytest.fixture(scope="module")
def rgbd(data_dir):
    folder = data_dir / "carla_rgbd"
    return calibrated(folder)[0], list(pictures(folder))


def test_carla_rgbd_steps_and_chained_steps(rgbd):
    camera, frames = rgbd
    results = follow(frames, camera, level_mounting(2.0))
    steps_m = np.array([np.linalg.norm(out.step[:3, 3]) for out in results[1:]])
    assert len(steps_m) == 89
    assert ((steps_m > 0.185) & (steps_m < 0.315)).all()
    errors = []
    for i in range(0, 85, 5):
        _, direct = follow([frames[i], frames[i + 5]], camera, level_mounting(2.0), rate_hz=4)
        chained = inverse(results[i].odom_T_ego) @ results[i + 5].odom_T_ego
        shift_m = np.linalg.norm(direct.step[:3, 3] - chained[:3, 3])
        errors.append(shift_m / np.linalg.norm(direct.step[:3, 3]))
    print(f"\nsteps {steps_m.min():.3f} to {steps_m.max():.3f} m; five chained {max(errors):.2%} off the direct ones")
    assert max(errors) < 0.01


def test_carla_rgbd_there_and_back(rgbd):
    camera, frames = rgbd
    results = follow(frames + frames[-2::-1], camera, level_mounting(2.0))
    miss_m = np.linalg.norm(results[-1].odom_T_ego[:3, 3])
    print(f"\nthere and back: {miss_m:.3f} m of {distances_m(poses(results))[-1]:.1f} m")
    assert miss_m < 0.20


def test_course_odometry_turns_little_and_goes_ahead(data_dir):
    """The camera sits ahead of the rear axle, about which the car turns: there the steps point straight ahead."""
    folder = data_dir / "course_odometry"
    camera, frames = calibrated(folder)[0], list(pictures(folder))
    axle_T_camera = rigid(EGO_R_OPTICAL, np.array([2.0, 0.0, 1.5]))
    results = follow(frames, camera, axle_T_camera, road=assumed_surface(camera, axle_T_camera))
    for out in results[1:]:
        ahead, left, up = out.step[:3, 3]
        assert angle_deg(out.step[:3, :3]) < 3
        assert np.rad2deg(np.arctan2(np.hypot(left, up), ahead)) < 10


@pytest.fixture(scope="module")
def course_steps(data_dir):
    """The steps of the course's frames with nothing but the images known."""
    folder = data_dir / "course_odometry"
    camera, frames = calibrated(folder)[0], list(pictures(folder))
    results = follow(frames, camera, level_mounting(1.5))
    assert all(out.status == "tracked" and out.up_to_scale for out in results[1:])
    return [out.step for out in results[1:]]


def test_course_odometry_without_any_scale_turns_little(course_steps):
    assert max(angle_deg(step[:3, :3]) for step in course_steps) < 3


@pytest.mark.xfail(strict=True, reason="the last two steps, in a turn, point 11.5 and 16 degrees aside of the camera")
def test_course_odometry_without_any_scale_goes_ahead(course_steps):
    assert max(np.rad2deg(np.arctan2(np.hypot(*step[1:3, 3]), step[0, 3])) for step in course_steps) < 10


def rendered(folder, *options):
    assert render_scene.main([str(folder), *options]) == 0
    camera, mounting = calibrated(folder)
    ego_T_camera = rigid(EGO_R_OPTICAL, np.array([mounting["rgb"][axis] for axis in "xyz"]))
    true = load_poses(folder / "poses.json")
    return camera, ego_T_camera, np.array([inverse(true[0]) @ true[k] for k in sorted(true)])


def like_stereo(frames, fx_baseline, seed=0):
    """Depth with disparities off by 0.35 px, alike within a few pixels, and holes."""
    rng = np.random.default_rng(seed)
    for grey, depth_m, movable in frames:
        noise = cv2.GaussianBlur(rng.normal(0, 1, depth_m.shape).astype(np.float32), (0, 0), 2)
        disparity = fx_baseline / depth_m + 0.35 * noise / noise.std()
        spoiled = np.where(disparity > 1, fx_baseline / np.maximum(disparity, 1), np.nan).astype(np.float32)
        spoiled[rng.random(spoiled.shape) < 0.15] = np.nan
        yield grey, spoiled, movable


@pytest.mark.accuracy
def test_town(tmp_path):
    camera, ego_T_camera, true = rendered(tmp_path, "--seconds", "20")
    stereo = like_stereo(pictures(tmp_path), 0.5 * camera.fx)
    for name, limit, frames in (("depth", 0.01, pictures(tmp_path)), ("like stereo", 0.02, stereo)):
        results = follow(frames, camera, ego_T_camera)
        shift, turn = relative_errors(poses(results), true, (25, 50, 100))
        print(f"\ntown, {name}: {shift:.3%} of the distance, {turn:.3f} deg/100 m")
        assert {out.status for out in results[1:]} == {"tracked"}
        assert shift < limit
        assert turn < 0.5
    for name, road in (("no depth", None), ("no depth, road", assumed_surface(camera, ego_T_camera))):
        results = follow(pictures(tmp_path), camera, ego_T_camera, depth=False, road=road)
        errors_m = aligned_errors_m(poses(results), true)
        share = np.sqrt(np.mean(errors_m**2)) / distances_m(true)[-1]
        print(f"town, {name}: {share:.3%} of the length after alignment")
        assert share < 0.02


@pytest.mark.accuracy
def test_standing_still(tmp_path):
    options = ("--static", "--rgb-noise", "2", "--depth-noise", "0.01", "--seconds", "5")
    camera, ego_T_camera, _ = rendered(tmp_path, *options)
    for depth in (True, False):
        for tags in (True, False):
            results = follow(pictures(tmp_path), camera, ego_T_camera, depth=depth, tags=tags)
            stray_m = np.linalg.norm(poses(results)[:, :3, 3], axis=1).max()
            print(f"\nstanding, depth {depth}, tags {tags}: strays {1000 * stray_m:.2f} mm")
            assert stray_m < 0.02


def test_short_town(tmp_path):
    camera, ego_T_camera, true = rendered(tmp_path, "--seconds", "1.5", "--size", "640x480")
    frames = list(pictures(tmp_path))
    shift, turn = relative_errors(poses(follow(frames, camera, ego_T_camera)), true, (5, 10))
    assert shift < 0.01
    assert turn < 2.0
    mono = poses(follow(frames, camera, ego_T_camera, depth=False))
    assert np.sqrt(np.mean(aligned_errors_m(mono, true) ** 2)) < 0.02 * distances_m(true)[-1]


def test_short_standing_still(tmp_path):
    camera, ego_T_camera, _ = rendered(tmp_path, "--static", "--rgb-noise", "2", "--seconds", "1", "--size", "640x480")
    results = follow(pictures(tmp_path), camera, ego_T_camera, tags=False)
    assert np.linalg.norm(poses(results)[:, :3, 3], axis=1).max() < 0.02
