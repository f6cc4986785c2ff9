"""Odometry on recorded frames and on rendered scenes, against their known motion."""

import json

import cv2
import numpy as np
import polars as pl
import pytest

from roadperc_stream import replay
from roadperc_stream.chain.stages.odometry import ego_motion
from roadperc_stream.chain.stages.odometry.keyframes import OdometryState
from roadperc_stream.chain.stages.surface.road import assumed_surface
from roadperc_stream.cli import convert, render
from roadperc_stream.config import OdometryConfig
from roadperc_stream.geometry import EGO_R_OPTICAL, Camera, inverse, mounting, rigid
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14 as TABLE
from roadperc_stream.tools.readers.depth_files import carla_metres
from tests.chain.stages.odometry.trajectories import angle_deg, distances_m
from tests.scenes import scene_of

CFG = OdometryConfig()
SATURATED_M = np.float32(65.535)
"""Largest depth of converted logs: 16 bits in millimetres."""


def calibrated(folder):
    known = json.loads((folder / "calibration.json").read_text())
    K = np.array(known["K"])
    size = known["width"], known["height"]
    return Camera("front", *size, K[0, 0], K[1, 1], K[0, 2] - 0.5, K[1, 2] - 0.5), known.get("mounting")


def pictures(folder):
    """Grey, depth and tags of every frame; None if the folder has no such image."""
    for path in sorted((folder / "rgb").iterdir()):
        depth, tags = (folder / sensor / f"{path.stem}.png" for sensor in ("depth", "segmentation"))
        yield (
            cv2.imread(str(path), cv2.IMREAD_GRAYSCALE),
            np.minimum(carla_metres(cv2.imread(str(depth))), SATURATED_M) if depth.exists() else None,
            np.ascontiguousarray(cv2.imread(str(tags))[..., 2]) if tags.exists() else None,
        )


def track(frames, camera, ego_T_camera, cfg=CFG, depth=True, tags=True, road=None, rate_hz=20):
    state, results = OdometryState(), []
    for k, (grey, depth_m, frame_tags) in enumerate(frames):
        scene = scene_of(
            camera,
            ego_T_camera,
            grey=grey,
            depth_m=depth_m if depth else None,
            tags=frame_tags if tags else None,
            table=TABLE,
            stamp_ns=round(1e9 * (1 + k / rate_hz)),
        )
        state, out = ego_motion.step(cfg, state, scene, road, np.random.default_rng((0, k)))
        results.append(out)
    return results


def poses(results):
    return np.array([out.odom_T_ego for out in results])


@pytest.mark.long
def test_carla_rgbd_steps_chained_steps_and_the_way_back(data_dir):
    folder = data_dir / "carla_rgbd"
    camera, frames = calibrated(folder)[0], list(pictures(folder))
    results = track(frames + frames[-2::-1], camera, mounting(z=2.0))
    miss_m = np.linalg.norm(results[-1].odom_T_ego[:3, 3])
    print(f"\nthere and back: {miss_m:.3f} m of {distances_m(poses(results))[-1]:.1f} m")
    assert miss_m < 0.20
    steps_m = np.array([np.linalg.norm(out.step[:3, 3]) for out in results[1 : len(frames)]])
    assert len(steps_m) == 89
    assert ((steps_m > 0.185) & (steps_m < 0.315)).all()
    errors = []
    for i in range(0, 85, 10):
        _, direct = track([frames[i], frames[i + 5]], camera, mounting(z=2.0), rate_hz=4)
        chained = inverse(results[i].odom_T_ego) @ results[i + 5].odom_T_ego
        shift_m = np.linalg.norm(direct.step[:3, 3] - chained[:3, 3])
        errors.append(shift_m / np.linalg.norm(direct.step[:3, 3]))
    print(f"\nsteps {steps_m.min():.3f} to {steps_m.max():.3f} m; five chained {max(errors):.2%} off the direct ones")
    assert max(errors) < 0.01


@pytest.mark.parametrize("scaled", [True, False])
def test_course_odometry_turns_little_and_goes_ahead(data_dir, scaled):
    """The car turns about its rear axle, so the steps of the axle, behind the camera, point straight ahead."""
    folder = data_dir / "course_odometry"
    camera, frames = calibrated(folder)[0], list(pictures(folder))
    axle_T_camera = rigid(EGO_R_OPTICAL, np.array([2.0, 0.0, 1.5]))
    road = assumed_surface(camera, axle_T_camera) if scaled else None
    for out in track(frames, camera, axle_T_camera, road=road)[1:]:
        ahead, left, up = out.step[:3, 3]
        assert (out.status, out.up_to_scale) == ("tracked", not scaled)
        assert angle_deg(out.step[:3, :3]) < 3
        assert not scaled or np.rad2deg(np.arctan2(np.hypot(left, up), ahead)) < 10


@pytest.mark.accuracy
def test_standing_still(tmp_path):
    options = ("--static", "--rgb-noise", "2", "--depth-noise", "0.01", "--seconds", "5")
    assert render.main([str(tmp_path), *options]) == 0
    camera, mounting = calibrated(tmp_path)
    ego_T_camera = rigid(EGO_R_OPTICAL, np.array([mounting["rgb"][axis] for axis in "xyz"]))
    for depth in (True, False):
        for tags in (True, False):
            results = track(pictures(tmp_path), camera, ego_T_camera, depth=depth, tags=tags)
            stray_m = np.linalg.norm(poses(results)[:, :3, 3], axis=1).max()
            print(f"\nstanding, depth {depth}, tags {tags}: strays {1000 * stray_m:.2f} mm")
            assert stray_m < 0.02


def stopping_drive(source, tmp_path):
    """The table of a replay with one camera."""
    assert convert.main([str(source), str(tmp_path / "in.mcap"), "--quiet"]) == 0
    replay(tmp_path / "in.mcap", tmp_path / "out.mcap", config={"objects": {"enabled": False}})
    table = pl.read_parquet(tmp_path / "out.metrics.parquet")
    assert set(table["odometry_status"]) == {"first", "tracked"}
    return table


def test_a_real_car_that_stops_stands_where_it_stopped(data_dir, tmp_path):
    table = stopping_drive(data_dir / "stop_and_go", tmp_path)
    seconds = (table["stamp_ns"][-1] - table["stamp_ns"][0]) / 1e9
    assert 10 < table["odom_x_m"][-1] < 10 * seconds
    standing = table.filter(pl.col("step_m") < 0.01)
    assert len(standing) >= 10
    assert standing["step_std_m"].null_count() == 0


def test_a_real_car_with_its_bonnet_in_view_keeps_its_scale(data_dir, tmp_path):
    """A dash cycle of 14.63 m takes 12.5 frames. The camera height in the calibration is a guess."""
    steps = stopping_drive(data_dir / "highway_second", tmp_path)["step_m", "step_std_m"][1:]
    known = steps.drop_nulls("step_m")
    assert len(known) >= 0.8 * len(steps)
    assert known["step_m"].median() == pytest.approx(14.63 / 12.5, rel=0.10)
    off_m = (known["step_m"] - 14.63 / 12.5).abs()
    assert (off_m > 3 * known["step_std_m"]).mean() <= 0.04


def test_small_images_at_two_hertz_give_hardly_any_scale(data_dir, tmp_path):
    """The two known steps follow a stand: the accelerating car squats, so they are 18 % too short."""
    source = data_dir / "carla_leaderboard" / "route_00"
    assert convert.main([str(source), str(tmp_path / "in.mcap"), "--quiet"]) == 0
    replay(tmp_path / "in.mcap", tmp_path / "out.mcap", config={"objects": {"enabled": False}})
    table = pl.read_parquet(tmp_path / "out.metrics.parquet")
    assert table["step_m"].is_not_null().mean() < 0.05
    assert (table["step_error_m"] <= 3 * table["step_std_m"]).drop_nulls().all()


@pytest.mark.accuracy
@pytest.mark.parametrize(
    "options",
    [
        "--lead-brakes --seconds 7 --rate 10 --seed 1",
        "--lead-brakes --seconds 7 --rate 10 --seed 4",
        "--stop-and-go --seconds 5.5 --rate 8 --seed 7",
    ],
)
def test_a_rendered_car_that_brakes_drives_as_far_as_it_should(tmp_path, options):
    small = "--scene straight --fov 70 --size 320x240 --without right --without depth"
    assert render.main([str(tmp_path / "dump"), *small.split(), *options.split()]) == 0
    table = stopping_drive(tmp_path / "dump", tmp_path)
    assert table.filter(pl.col("true_step_m") < 0.001)["step_m"].sum() < 0.005
    assert table["step_m"].sum() == pytest.approx(table["true_step_m"].sum(), rel=0.03)
    assert (table["step_error_m"] < 3 * table["step_std_m"] + 0.01).mean() > 0.95
