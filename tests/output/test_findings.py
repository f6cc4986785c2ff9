"""Findings of wrong inputs, of hand-made evidence, and of odometry against poses; none of right ones."""

import json
from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream import log
from roadperc_stream.chain.step import State, step
from roadperc_stream.cli import check, info, replay, report
from roadperc_stream.config import load_config
from roadperc_stream.geometry.rotations import quaternion, rotation_from_rpy
from roadperc_stream.metrics.evidence import evidence_of, road_depth, rough_ratio, searched_depths
from roadperc_stream.model import Reason
from roadperc_stream.model.finding import Evidence, Finding, decoded_findings, encoded_findings
from roadperc_stream.output import encoding
from roadperc_stream.output.findings import Contradictions
from roadperc_stream.output.pose_evidence import PoseEvidence
from roadperc_stream.output.spread import Spread
from roadperc_stream.output.tables import read_footer, sidecar_path
from roadperc_stream.tools.readers.depth_files import carla_metres
from tests import logs, replaying
from tests.chain.test_road_pitch import CAMERA, still
from tests.eval.tables import outcome, row
from tests.resume.test_kills import interrupt, same

CFG = load_config()
SMALL = replace(logs.SMALL, width=192, height=144)
DEPTH_M = SMALL.depth_m()
WITHOUT_TRANSFORM = tuple(role for role in logs.ALL if role != "tf")


def exchanged(depth_m):
    """CARLA's 24-bit depth of a (H, W) depth, read with red and blue exchanged."""
    code = np.nan_to_num(depth_m / 1000, nan=1.0).clip(0, 1) * (2**24 - 1)
    blue_green_red = np.stack([code.astype(np.uint32) >> shift & 255 for shift in (16, 8, 0)], axis=-1)
    return carla_metres(np.ascontiguousarray(blue_green_red[..., ::-1].astype(np.uint8)))


def items(*, depth=None, narrow=1.0, frames=6, roles=logs.ALL):
    """A drive; ``depth`` changes its depth images, ``narrow`` multiplies the focal length of its calibration."""
    camera = replace(SMALL.camera, fx=SMALL.camera.fx * narrow, fy=SMALL.camera.fy * narrow)
    for item in logs.items(frames, SMALL, roles):
        if item.role == "calibration":
            yield replace(item, data=encoding.encode_calibration(item.stamp_ns, camera))
        elif item.role == "depth" and depth is not None:
            yield replace(item, data=depth(item.stamp_ns))
        else:
            yield item


def of_depth(depth_m, **options):
    return lambda stamp_ns: encoding.encode_depth(stamp_ns, "camera", depth_m, **options)


WRONG = {
    "camera_height": {"depth": of_depth(DEPTH_M * 1.2, as_float=True)},
    "camera_height lane_width": {"narrow": np.sqrt(3)},
    "lane_width": {"narrow": np.sqrt(3), "roles": WITHOUT_TRANSFORM},
    "lane_width ": {"narrow": 2.5, "roles": WITHOUT_TRANSFORM},
    "depth_rough": {"depth": of_depth(exchanged(DEPTH_M))},
    "road_depth": {"depth": of_depth(DEPTH_M * 1000, as_float=True)},
    "undecodable": {"depth": lambda stamp_ns: of_depth(DEPTH_M)(stamp_ns)[:-100]},
}


@pytest.mark.parametrize("codes", WRONG)
def test_a_wrong_input_is_a_finding(tmp_path, codes):
    source = logs.write(tmp_path / "in.mcap", items(**WRONG[codes]))
    found = replaying.replay(source, tmp_path / "out.mcap", CFG).findings
    assert {finding.code for finding in found} == set(codes.split())


def test_both_heights_are_named(tmp_path):
    source = logs.write(tmp_path / "in.mcap", items(**WRONG["camera_height"]))
    (found,) = replaying.replay(source, tmp_path / "out.mcap", CFG).findings
    assert "1.68 m" in found.text
    assert "1.4 m" in found.text


@pytest.mark.parametrize("roles", [logs.ALL, WITHOUT_TRANSFORM, ("calibration", "image", "segmentation")])
def test_a_right_input_has_no_finding(tmp_path, roles):
    source = logs.write(tmp_path / "in.mcap", items(roles=roles))
    assert replaying.replay(source, tmp_path / "out.mcap", CFG).findings == ()
    assert read_footer(tmp_path / "out.metrics.parquet").facts["findings"] == "[]"


def test_a_finding_is_in_every_output(tmp_path, capsys):
    source, target = logs.write(tmp_path / "in.mcap", items(**WRONG["camera_height"])), tmp_path / "out.mcap"
    assert "note: camera_height: " in outcome(replay.main, capsys, source, target)[1]
    stored = read_footer(sidecar_path(target, "metrics")).facts["findings"]
    (record,) = (dict(item.values) for item in log.summarise(target).metadata if item.name == "roadperc")
    assert record["findings"] == stored
    assert "finding camera_height: " in outcome(info.main, capsys, target)[1]
    out = outcome(report.main, capsys, target, "--json", tmp_path / "report.json")[1]
    assert out.startswith("finding camera_height: ")
    assert json.loads((tmp_path / "report.json").read_text())["findings"]["camera_height"]["runs"] == 1
    code, out, _ = outcome(check.main, capsys, target)
    assert code == 1
    assert "camera_height" in out


def test_a_finding_does_not_depend_on_threads_and_interruptions(tmp_path):
    source = logs.write(tmp_path / "in.mcap", items(**WRONG["camera_height"], frames=14))
    cfg = load_config(None, ["sync.max_wait_s=0.1"])
    expected, resumed = tmp_path / "whole.mcap", tmp_path / "resumed.mcap"
    summary = replaying.replay(source, expected, cfg, threads=3)
    interrupt(source, resumed, 12, cfg)
    assert replaying.replay(source, resumed, cfg, checkpoint_every_s=0.2, resume=True).findings == summary.findings
    assert same(resumed, expected)
    assert len({read_footer(sidecar_path(path, "metrics")).facts["findings"] for path in (expected, resumed)}) == 1
    again = replaying.replay(source, resumed, cfg, checkpoint_every_s=0.2, resume=True)
    assert (again.is_new, again.findings) == (False, summary.findings)


@pytest.mark.parametrize("text", ["", "[" * 10**5, "[1]", '[{"code": 1}]', "\udcff"])
def test_a_stored_text_that_is_no_list_of_findings_is_empty(text):
    assert decoded_findings(text) == ()


def test_stored_findings_are_read_again():
    findings = (Finding("a", "ä\n"), Finding("b", ""))
    assert decoded_findings(encoded_findings(findings)) == findings


@pytest.mark.parametrize(("baseline_m", "is_found"), [(0.54, False), (540.0, True), (0.00054, True)])
def test_a_baseline_of_another_unit_leaves_no_road_in_the_searched_disparities(baseline_m, is_found):
    frame = SMALL.frame(right_camera=replace(SMALL.camera, baseline_m=baseline_m))
    share, ratio = road_depth(SMALL.camera, SMALL.ego_T_camera, DEPTH_M, searched_depths(CFG, frame))
    counter = Contradictions()
    counter.add(row(0), Evidence(road_known_ratio=share, road_depth_ratio=ratio))
    assert {found.code for found in counter.findings()} == ({"road_depth"} if is_found else set())


def test_a_lower_image_without_depth_is_a_finding(tmp_path):
    source = logs.write(tmp_path / "in.mcap", items(depth=of_depth(np.full_like(DEPTH_M, np.nan))))
    (found,) = replaying.replay(source, tmp_path / "out.mcap", CFG).findings
    assert found.code == "road_depth"


def test_depth_in_the_wrong_byte_order_is_rough_and_depth_with_noise_is_not():
    noisy_m = DEPTH_M * np.random.default_rng(1).normal(1, 0.05, DEPTH_M.shape).astype(np.float32)
    swapped_m = (np.nan_to_num(DEPTH_M * 1000).clip(0, 65535).astype(np.uint16).byteswap() / 1000).astype(np.float32)
    assert rough_ratio(noisy_m) < 0.1
    assert rough_ratio(swapped_m) > 0.5
    assert rough_ratio(np.full_like(DEPTH_M, 3.0)) is None


@pytest.mark.parametrize(("narrow", "is_found"), [(1.0, False), (0.7, True), (0.5, True)])
def test_a_wrong_field_of_view_moves_the_horizon_of_stills(narrow, is_found):
    camera = replace(CAMERA, fx=CAMERA.fx * narrow, fy=CAMERA.fy * narrow)
    counter = Contradictions()
    for number in range(3):
        frame = still(6.0 + 0.1 * number, assumed=camera)
        counter.add(row(number), evidence_of(CFG, frame, step(CFG, State(), frame)[1]))
    assert [found.code for found in counter.findings()] == ["camera_pitch"] * is_found


def test_heights_that_scatter_and_few_widths_are_no_finding():
    counter = Contradictions()
    for frame, height_m in enumerate((1.2, 1.9, 2.3, 1.5)):
        measured = {"camera_height_m": height_m, "surface_source": "depth"}
        lane = dict.fromkeys(("lane_left_status", "lane_right_status"), "measured") if frame < 2 else {}
        counter.add(row(frame, **measured, **lane, lane_width_m=7.0), Evidence(mounting_m=1.4))
    assert counter.findings() == ()


@pytest.mark.parametrize(
    ("height_m", "rejected_m", "is_found"), [(1.4, 9.7, False), (7.0, 16.9, True), (0.8, 1.9, True)]
)
def test_rejected_lanes_count_if_their_width_fits_a_wrong_scale(height_m, rejected_m, is_found):
    counter = Contradictions()
    for frame in range(5):
        reasons = (Reason("lanes", "lane_width", ("left", rejected_m, 2.0, 7.0)),)
        counter.add(row(frame, camera_height_m=height_m, surface_source="depth", reasons=reasons), Evidence())
    assert (counter.findings() != ()) == is_found


def test_values_of_a_long_replay_are_bounded_and_even():
    kept = Spread[int]()
    for value in range(100_000):
        kept.add(value)
    assert len(kept.values) <= 512
    assert len({later - earlier for earlier, later in zip(kept.values, kept.values[1:], strict=False)}) == 1


def drive(frames=200, late=0, scale=1.0, side=1.0, noise_m=0.0, speed_mps=8.0):
    """Rows at 20 Hz of a drive with bends. The poses turn ``late`` frames later, to the ``side`` 1 or -1."""
    time_s, rng = np.arange(-50, frames + 50) / 20, np.random.default_rng(1)
    yaw = 0.6 * np.sin(0.7 * time_s) * np.sin(0.23 * time_s) + 0.2 * np.sin(1.9 * time_s) if speed_mps else 0 * time_s
    way = np.stack((np.cos(yaw), np.sin(yaw)), axis=-1).cumsum(axis=0) * speed_mps / 20
    for k in range(frames):
        own, true = k + 50, k + 50 - late
        x, y, z, w = quaternion(rotation_from_rpy(0, 0, yaw[own] + rng.normal(0, 0.0005)))
        a, b, c, d = quaternion(rotation_from_rpy(0, 0, side * yaw[true]))
        position = way[true] + rng.normal(0, noise_m, 2)
        yield row(
            k,
            odometry_status="tracked" if k else "first",
            step_m=speed_mps / 20 if k else None,
            step_std_m=0.001 if k else None,
            **dict(zip(("odom_x_m", "odom_y_m", "odom_z_m"), (*way[own] * scale, 0.0), strict=True)),
            **dict(zip(("odom_qx", "odom_qy", "odom_qz", "odom_qw"), (x, y, z, w), strict=True)),
            **dict(zip(("true_x_m", "true_y_m", "true_z_m"), (position[0], side * position[1], 0.0), strict=True)),
            **dict(zip(("true_qx", "true_qy", "true_qz", "true_qw"), (a, b, c, d), strict=True)),
        )


def codes_of(rows):
    poses = PoseEvidence()
    for item in rows:
        poses.add(item)
    return {found.code: found.text for found in poses.findings() if found is not None}


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"scale": 1.08}, "odometry_scale"),
        ({"scale": 0.93, "noise_m": 0.05}, "odometry_scale"),
        ({"late": 1}, "pose_delay"),
        ({"late": -3}, "pose_delay"),
        ({"side": -1.0}, "pose_mirrored"),
    ],
)
def test_odometry_that_contradicts_the_poses_is_a_finding(changes, code):
    assert set(codes_of(drive(**changes))) == {code}


def test_the_delay_is_named_in_seconds():
    text = codes_of(drive(late=3))["pose_delay"]
    assert "0.15" in text
    assert "after" in text


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"scale": 1.04},
        {"noise_m": 0.1},
        {"frames": 20, "scale": 1.5},
        {"frames": 25, "late": 3},
        {"speed_mps": 0.0, "noise_m": 0.05},
        {"speed_mps": 0.5, "noise_m": 0.2},
    ],
)
def test_right_short_standing_and_noisy_drives_are_no_finding(changes):
    assert codes_of(drive(**changes)) == {}


@pytest.mark.parametrize("frames", [1, 2, 5, 9, 10, 11])
def test_turns_in_a_few_frames_are_no_finding(frames):
    assert codes_of([*drive(10 * frames)][::10]) == {}
