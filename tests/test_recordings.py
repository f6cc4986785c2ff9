"""Convert and replay real data sets, and compare the tables with known values."""

import json
import re
from functools import cache

import numpy as np
import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli import convert, report
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.output.tables import sidecar_path


@pytest.fixture(scope="module")
def replayed(data_dir, tmp_path_factory):
    """Return metrics and objects of a data set; each is converted and replayed once."""
    folder = tmp_path_factory.mktemp("recordings")

    @cache
    def run(name, *arguments):
        source, target = folder / f"{name}.mcap", folder / f"{name}.out.mcap"
        if not source.exists():
            assert convert.main([str(data_dir / name), str(source), "--quiet"]) == 0
        assert replay_main([str(source), str(target), "--force", "--quiet", *arguments]) == 0
        return pl.read_parquet(sidecar_path(target, "metrics")), pl.read_parquet(sidecar_path(target, "objects"))

    return run


FRAMES = {
    "carla_frame": 1, "carla_raw_tags": 3, "course_frames": 2, "course_odometry": 16,
    "course_stereo": 1,
}  # fmt: skip


@pytest.mark.parametrize(("name", "frames"), FRAMES.items(), ids=FRAMES)
def test_every_set_converts_and_replays(replayed, name, frames):
    assert replayed(name)[0].height == frames


def test_course_frames_keep_the_known_detections(replayed, data_dir):
    metrics, objects = replayed("course_frames")
    expected = json.loads((data_dir / "course_frames" / "expected.json").read_text())
    for frame in (0, 1):
        rows = objects.filter(pl.col("frame") == frame)
        assert rows["class_ratio"].to_list() == pytest.approx(expected[str(frame)]["segmentation_ratio"], abs=0.001)
        assert [k for k, kept in enumerate(rows["kept"]) if kept] == expected[str(frame)]["kept"]
    assert set(metrics["surface_source"]) == {"assumed"}
    assert set(objects["distance_source"].drop_nulls()) == {"ground"}


def test_carla_frame_height_and_kept_boxes(replayed, data_dir):
    metrics, objects = replayed("carla_frame")
    expected = json.loads((data_dir / "carla_frame" / "expected.json").read_text())
    assert metrics["camera_height_m"][0] == pytest.approx(expected["depth_camera_height_m"], abs=0.02)
    assert objects.height == 71
    assert objects["class_ratio"].null_count() == expected["boxes_outside_image"]
    assert 10 <= objects["kept"].sum() <= 14


def test_sidewalks_are_drivable_only_by_setting(replayed):
    default, _ = replayed("carla_frame")
    wide, _ = replayed("carla_frame", "--set", 'surface.classes=["road", "road_line", "sidewalk"]')
    assert wide["drivable_ratio"][0] > default["drivable_ratio"][0] + 0.02


def test_carla_rgbd_height_and_pitch(replayed):
    metrics, _ = replayed("carla_rgbd", "--frames", "30")
    assert (metrics["camera_height_m"] - 2.0).abs().le(0.01).sum() >= 29
    assert abs(metrics["camera_pitch_deg"].median()) < 0.02
    assert set(metrics["surface_source"]) == {"lower_image"}
    assert metrics["lane_left_status"].null_count() == 30
    assert metrics["reason_codes"].explode().unique().sort().to_list() == [
        "lanes.no_segmentation",
        "objects.no_detections",
        "stereo.no_right_image",
        "surface.no_segmentation_lower_image",
    ]


def test_the_pixel_origin_shifts_the_pitch_by_a_tenth_of_a_degree(data_dir, tmp_path, replayed):
    """With pixel_origin "centre" the pitch of the same frames is larger by 0.11 degrees."""
    part = ("--frames", "8", "--only", "surface")
    right, _ = replayed("carla_rgbd", *part)
    dump = tmp_path / "dump"
    dump.mkdir()
    for folder in ("rgb", "depth"):
        (dump / folder).symlink_to(data_dir / "carla_rgbd" / folder)
    calibration = json.loads((data_dir / "carla_rgbd" / "calibration.json").read_text())
    (dump / "calibration.json").write_text(json.dumps(calibration | {"pixel_origin": "centre"}))
    assert convert.main([str(dump), str(tmp_path / "a.mcap"), "--quiet"]) == 0
    assert replay_main([str(tmp_path / "a.mcap"), str(tmp_path / "b.mcap"), "--quiet", *part]) == 0
    wrong = pl.read_parquet(tmp_path / "b.metrics.parquet")
    shift = wrong["camera_pitch_deg"].median() - right["camera_pitch_deg"].median()
    assert shift == pytest.approx(0.11, abs=0.01)


def test_the_steps_of_kitti_from_one_camera_of_known_height(data_dir, tmp_path, capsys):
    """The camera is pitched down by about one degree, which is not in the calibration."""
    folder = data_dir / "kitti_odometry"
    assert convert.main([str(folder), str(tmp_path / "in.mcap"), "--quiet"]) == 0
    options = ("--quiet", "--results-only", "--only", "surface,odometry")
    assert replay_main([str(tmp_path / "in.mcap"), str(tmp_path / "out.mcap"), *options]) == 0
    assert report.main([str(tmp_path / "out.metrics.parquet")]) == 0
    ((ate_m, percent),) = re.findall(r"trajectory: ATE (.*) m, .*, KITTI t_err (.*) %, r_err", capsys.readouterr().out)
    assert float(ate_m) < 0.2
    assert float(percent) < 2.0
    metrics = pl.read_parquet(tmp_path / "out.metrics.parquet")[1:]
    places = np.loadtxt(folder / "poses.txt")[:, 3::4]
    true_m, step_m = np.linalg.norm(np.diff(places, axis=0), axis=1), metrics["step_m"].to_numpy()
    off = np.abs(step_m - true_m)
    print(f"\nKITTI: {np.median(off / true_m):.2%} median, path {step_m.sum() / true_m.sum():.4f}")
    assert np.isfinite(step_m).mean() >= 0.95
    assert np.median(off / true_m) <= 0.02
    assert step_m.sum() == pytest.approx(true_m.sum(), rel=0.02)
    within = [float(np.mean(off <= sigmas * metrics["step_std_m"].to_numpy())) for sigmas in (1, 2, 3)]
    assert within[0] >= 0.5
    assert within[1] >= 0.9
    assert within[2] >= 0.98
    assert set(metrics["surface_source"]) == {"estimated"}
    assert metrics["camera_pitch_deg"].median() == pytest.approx(1.07, abs=0.15)


def test_a_log_without_images_is_refused(data_dir, tmp_path, capsys):
    source = data_dir / "mcap" / "example_logs.mcap"
    assert replay_main([str(source), str(tmp_path / "out.mcap")]) == 1
    assert "nothing to replay" in capsys.readouterr().err
    assert list(log.read(log.summarise(source)))
    assert list(tmp_path.iterdir()) == []
