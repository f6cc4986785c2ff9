import json
import math
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli import info, replay
from roadperc_stream.cli.convert import main
from roadperc_stream.geometry import Camera
from roadperc_stream.input.decoding import context_of_channel, decode
from roadperc_stream.model import Box
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.tools.readers.frame_stamps import EPOCH_NS
from tests.tools.dump_writer import (
    CALIBRATION,
    HEIGHT,
    TAGS,
    WIDTH,
    camera_pixels,
    carla_codes,
    depth_m,
    document,
    jpeg,
    plain_dump,
    red,
)
from tests.tools.dump_writer import png as write_png

ROLE_OF_TOPIC = {role.topic: role for role in ROLES.values()}


def convert(dump: Path, *options: str) -> Path:
    out = dump.parent / f"{dump.name}.mcap"
    assert main([str(dump), str(out), "--quiet", *options]) == 0
    return out


def printed_by(capsys, dump: Path, out: Path, *options: str) -> str:
    """Return the stdout of a conversion."""
    assert main([str(dump), str(out), *options]) == 0
    return capsys.readouterr().out


def failure(capsys, *arguments: object) -> str:
    """Return the line of a stated error."""
    assert main([str(a) for a in arguments]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def payloads(path: Path) -> dict[str, list]:
    """Return decoded messages by role, with stamps in nanoseconds since the epoch of dumps."""
    found: dict[str, list] = {}
    for message in log.read(log.summarise(path)):
        role = ROLE_OF_TOPIC[message.channel.topic]
        context = context_of_channel(message.channel, "auto")
        schema, encoding = message.channel.schema_name, message.channel.message_encoding
        decoded = decode(role.kind, schema, encoding, message.data, message.log_time_ns, context)
        assert decoded.stamp_ns == message.log_time_ns == message.publish_time_ns
        found.setdefault(role.name, []).append((message.log_time_ns - EPOCH_NS, message.sequence, decoded.payload))
    return found


@pytest.fixture
def dump(tmp_path):
    return plain_dump(tmp_path / "dump")


def test_a_dump_becomes_a_log(dump):
    found = payloads(convert(dump))
    assert set(found) == {"image", "calibration", "depth", "segmentation"}
    assert [(t, s) for t, s, _ in found["image"]] == [(0, 0), (50_000_000, 1), (100_000_000, 2)]
    ((_, _, camera),) = found["calibration"]
    assert camera == Camera("camera_front", WIDTH, HEIGHT, 8.0, 8.0, 7.5, 5.5)
    for number, (_, _, image) in enumerate(found["image"]):
        np.testing.assert_array_equal(image.bgr, camera_pixels(number))
    _, _, depth = found["depth"][0]
    np.testing.assert_allclose(depth.depth_m, np.minimum(depth_m(), 65.535), atol=6e-4)
    _, _, tags = found["segmentation"][0]
    assert tags.table.name == "carla-from-0.9.14"
    np.testing.assert_array_equal(tags.tags, TAGS)


def test_images_pass_through_byte_for_byte(tmp_path):
    dump = tmp_path / "dump"
    first = jpeg(dump / "rgb" / "1.png", camera_pixels(1))
    second = write_png(dump / "rgb" / "2.jpg", camera_pixels(2))
    out = convert(dump, "--fov", "90")
    data = [m.data for m in log.read(log.summarise(out), topics=["/camera/front/image"])]
    assert first.read_bytes() in data[0]
    assert b"jpeg" in data[0]
    assert second.read_bytes() in data[1]
    assert b"png" in data[1]


def test_calibration_comes_before_everything_and_channels_follow_the_table(dump):
    document(dump / "calibration.json", {**CALIBRATION, "rgb_height_m": 1.7, "depth_height_m": 1.5})
    document(dump / "detections.json", {"0": [{"label": "Car", "box_px": [1, 2, 3, 4], "score": 0.5}]})
    out = convert(dump)
    topics = [m.channel.topic for m in log.read(log.summarise(out))]
    assert topics[:2] == ["/camera/front/calibration", "/tf"]
    order = [role.topic for role in ROLES.values()]
    assert topics[2:6] == sorted(set(topics) - set(topics[:2]), key=order.index)
    by_id = sorted({m.channel.source_id: m.channel.topic for m in log.read(log.summarise(out))}.items())
    assert [topic for _, topic in by_id] == sorted((topic for _, topic in by_id), key=order.index)
    edges = {e.child: e.parent_T_child[:3, 3].tolist() for e in payloads(out)["tf"][0][2]}
    assert edges == {"camera_front": [0, 0, 1.7], "camera_depth": [0, 0, 1.5]}
    assert payloads(out)["depth"][0][2].frame_id == "camera_depth"


def test_unreadable_frames_are_reported_and_counted_as_missing(dump, capsys):
    (dump / "rgb" / "000001.png").write_bytes(b"")
    damaged = bytearray((dump / "depth" / "000002.png").read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (dump / "depth" / "000002.png").write_bytes(damaged)
    found = payloads(convert(dump))
    warnings = capsys.readouterr().err
    assert "000001.png: empty file" in warnings
    assert "000002.png: png is damaged" in warnings
    assert [s for _, s, _ in found["image"]] == [0, 2]
    assert [s for _, s, _ in found["depth"]] == [0, 1]
    assert [s for _, s, _ in found["segmentation"]] == [0, 1, 2]


def test_depth_as_float(dump):
    _, _, depth = payloads(convert(dump, "--depth", "float"))["depth"][0]
    np.testing.assert_allclose(depth.depth_m, depth_m(), atol=5e-5)
    assert depth.limit_m == math.inf


def test_rates_and_stamp_files(dump):
    document(dump / "calibration.json", {**CALIBRATION, "rate_hz": 10})
    assert [t for t, _, _ in payloads(convert(dump))["image"]] == [0, 100_000_000, 200_000_000]
    found = payloads(convert(dump, "--rate", "40", "--force"))
    assert [t for t, _, _ in found["image"]] == [0, 25_000_000, 50_000_000]
    (dump / "timestamps.txt").write_text("000000 1.5\n000001 1.6\n000002 1.8\n")
    found = payloads(convert(dump, "--force"))
    assert [t for t, _, _ in found["image"]] == [1_500_000_000, 1_600_000_000, 1_800_000_000]


TUM = ("1305031102.933", "1305031102.983", "1305031103.033", "1305031103.083")


def tum_dump(folder, behind_s=(0.004, 0.004, 0.004, 0.004)):
    """Write images, and depth a little after each image, with TUM's file names."""
    for seed, (name, late_s) in enumerate(zip(TUM, behind_s, strict=True)):
        write_png(folder / "rgb" / f"{name}.png", camera_pixels(seed))
        write_png(folder / "depth" / f"{float(name) + late_s:.3f}.png", carla_codes(depth_m()))
    document(folder / "calibration.json", CALIBRATION)
    return folder


def test_names_that_are_stamps_are_read_as_stamps(tmp_path, capsys):
    out = tmp_path / "dump.mcap"
    assert "stamps in the names of the files, " in printed_by(capsys, tum_dump(tmp_path / "dump"), out)
    found = payloads(out)
    stamps_ns = [round(float(name) * 1000) * 1_000_000 for name in TUM]
    assert [t + EPOCH_NS for t, _, _ in found["image"]] == stamps_ns
    assert [t + EPOCH_NS for t, _, _ in found["depth"]] == [stamp_ns + 4_000_000 for stamp_ns in stamps_ns]
    assert replay.main([str(out), str(tmp_path / "result.mcap"), "--quiet"]) == 0
    rows = pl.read_parquet(tmp_path / "result.metrics.parquet")
    assert rows["stamp_ns"].to_list() == stamps_ns
    assert rows["sync_skew_ms"].to_list() == [4.0] * 4


def test_unpaired_stamps_in_names_are_reported_by_converter_and_replay(tmp_path, capsys):
    """Each image is a frame; the messages name the setting that pairs the others, and it does."""
    dump, out = tum_dump(tmp_path / "dump", (0.012,) * 4), tmp_path / "dump.mcap"
    printed = printed_by(capsys, dump, out)
    assert f"{dump}: 4 frames\n" in printed
    assert ", 20 Hz in the mean" in printed
    assert re.search(r"^ *image +rgb +4 +0 ", printed, re.MULTILINE)
    assert re.search(r"^ *depth +depth +4 +4 ", printed, re.MULTILINE)
    assert (
        " note: depth: 4 of 4 images have no file within sync.tolerance_s (0.01 s), the nearest are 0.012 s apart; "
        "pass --set sync.tolerance_s=SECONDS to the replay to pair them\n"
    ) in printed
    result = str(tmp_path / "result.mcap")
    assert replay.main([str(out), result]) == 0
    printed = capsys.readouterr().out
    (note,) = [line for line in printed.splitlines() if "sync.tolerance_s" in line]
    assert note == (
        "note: /camera/front/depth: in no frame; the nearest message is 0.012 s from one, sync.tolerance_s is 0.01"
    )
    assert replay.main([str(out), result, "--force", "--set", "sync.tolerance_s=0.012"]) == 0
    assert "no frame" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("names", "stamps_us"),
    [
        (("12.80", "12.95", "13.00", "13.25"), (12_800_000, 12_950_000, 13_000_000, 13_250_000)),
        (("9.95", "10", "10.05"), (9_950_000, 10_000_000, 10_050_000)),
        (("52.610000", "52.660000"), (52_610_000, 52_660_000)),
        (("1700000000.123456", "1700000000.173456"), (1_700_000_000_123_456, 1_700_000_000_173_456)),
    ],
    ids=["hundredths", "a whole second", "microseconds", "Unix time"],
)
@pytest.mark.parametrize("where", ["rgb/{}.png", "{}.png", "rgb_{}.png"])
def test_names_in_decimal_seconds_are_stamps(tmp_path, where, names, stamps_us):
    levels = [50 * k for k in range(len(names))]
    for name, level in zip(names, levels, strict=True):
        write_png(tmp_path / "dump" / where.format(name), np.full((48, 64, 3), level, np.uint8))
    found = payloads(convert(tmp_path / "dump", "--fov", "90", "--height", "1.4"))["image"]
    assert [image.grey[0, 0] for *_, image in found] == levels
    epoch_ns = EPOCH_NS if stamps_us[0] > 1e15 else 0
    assert [t + epoch_ns for t, *_ in found] == [1000 * us for us in stamps_us]


def test_disparity_needs_a_baseline_to_become_depth(dump, capsys):
    for number in range(3):
        write_png(dump / "depth" / f"{number:06d}.png", np.full((HEIGHT, WIDTH), 2 * 256, np.uint16))
    stated = "disparity needs the baseline; add baseline_m to calibration.json"
    assert stated in failure(capsys, dump, dump.parent / "out.mcap", "--depth-coding", "disparity")
    (dump / "calibration.json").write_text(json.dumps({**CALIBRATION, "baseline_m": 0.5}))
    _, _, depth = payloads(convert(dump, "--depth-coding", "disparity"))["depth"][0]
    np.testing.assert_allclose(depth.depth_m, WIDTH / 2 * 0.5 / 2, atol=6e-4)  # fx is half the width at 90 degrees


def test_left_alone_becomes_the_front_camera(tmp_path, capsys):
    dump = tmp_path / "dump"
    write_png(dump / "left.png", camera_pixels(1))
    write_png(dump / "right.png", camera_pixels(2))
    document(dump / "calibration.json", {"fov_deg": 90, "baseline_m": 0.25})
    out = dump.parent / "out.mcap"
    assert "the left camera is the front camera" in printed_by(capsys, dump, out)
    found = payloads(out)
    assert set(found) == {"image", "calibration", "right", "right_calibration", "tf"}
    assert found["right_calibration"][0][2].baseline_m == 0.25


def test_detections_and_poses_without_an_image_are_left_out(dump, capsys):
    document(dump / "detections.json", {"1": [{"label": "Car", "box_px": [1, 2, 3, 4], "score": 0.5}], "9": []})
    pose = {"location": {"x": 1, "y": 2, "z": 0}, "rotation": {"pitch": 0, "yaw": 90, "roll": 0}}
    document(dump / "poses.json", {"000002": pose, "000009": pose})
    out = dump.parent / "out.mcap"
    printed = printed_by(capsys, dump, out)
    assert "detections: 1 of 2 frames have no image" in printed
    assert "poses: 1 of 2 frames have no image" in printed
    found = payloads(out)
    ((_, sequence, detections),) = found["detections"]
    assert sequence == 1
    assert detections[0].box_px == Box(1, 2, 3, 4)
    ((_, _, pose_edge),) = found["truth_pose"]
    assert (pose_edge.parent, pose_edge.child) == ("odom", "ego")
    np.testing.assert_allclose(pose_edge.parent_T_child[:2, :3], [[0, 1, 0], [-1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(pose_edge.parent_T_child[:3, 3], [1, -2, 0])


def test_a_role_option_inside_the_dump_or_from_here(dump, monkeypatch):
    write_png(dump / "other" / "0.png", carla_codes(depth_m() * 2))
    found = payloads(convert(dump, "--role", "depth=other"))
    assert len(found["depth"]) == 1
    monkeypatch.chdir(dump.parent)
    assert len(payloads(convert(dump, "--role", "depth=dump/depth", "--force"))["depth"]) == 3


def test_an_existing_log_is_kept_unless_forced(dump, capsys):
    out = convert(dump)
    before = out.stat()
    assert "--force" in failure(capsys, dump, out)
    assert out.stat() == before
    convert(dump, "--force")


def spoil_calibration(content: object):
    return lambda dump: document(dump / "calibration.json", content)


SPOILERS = {
    "truncated json": (lambda d: (d / "calibration.json").write_text('{"width": 16,'), ["calibration.json: not JSON"]),
    "no calibration": (lambda d: (d / "calibration.json").unlink(), ["camera_front", "--fov"]),
    "no version": (spoil_calibration({**CALIBRATION, "carla_tags": None}), ["segmentation", "--carla", "2 fence"]),
}


def test_a_file_of_another_size_counts_as_missing(dump, tmp_path, capsys):
    target = tmp_path / "in.mcap"
    write_png(dump / "rgb" / "000001.png", camera_pixels()[:-2])
    assert main([str(dump), str(target), "--quiet"]) == 0
    printed = capsys.readouterr().err
    assert printed.startswith("warning: counted as missing: ")
    assert "000001.png: image is 16x10, expected 16x12" in printed
    assert len(list(log.read(log.summarise(target), topics=[ROLES["image"].topic]))) == 2


@pytest.mark.parametrize("name", SPOILERS)
def test_an_error_is_one_line_and_leaves_no_log(dump, capsys, name):
    spoil, words = SPOILERS[name]
    spoil(dump)
    out = dump.parent / "out" / "in.mcap"
    message = failure(capsys, dump, out, "--quiet")
    assert all(word in message for word in words), message
    assert not out.parent.exists() or not list(out.parent.iterdir())


def lidar_dump(folder: Path, **mounting: dict[str, float]) -> Path:
    dump = plain_dump(folder)
    document(dump / "calibration.json", {**CALIBRATION, "mounting": {"rgb": {"x": 1.5, "z": 1.4}, **mounting}})
    for number in (0, 1, 2, 7):
        points = np.array([[10.0 + number, 2.0, -2.4, 0.5]], "<f4")
        (dump / "velodyne").mkdir(exist_ok=True)
        (dump / "velodyne" / f"{number:06d}.bin").write_bytes(points.tobytes())
    return dump


def test_a_lidar_becomes_points_with_its_mounting(tmp_path, capsys):
    """The lidar is turned right by 90 degrees (CARLA's yaw), 0.5 m to the right."""
    dump = lidar_dump(tmp_path / "dump", lidar={"x": 0.0, "y": 0.5, "z": 2.4, "yaw": 90.0})
    (dump / "velodyne" / "000001.bin").write_bytes(b"cut off")
    out = convert(dump)
    assert "velodyne/000001.bin: 7 bytes, expected points of 16 bytes" in capsys.readouterr().err
    found = payloads(out)
    clouds = {sequence: cloud for _, sequence, cloud in found["lidar"]}
    assert sorted(clouds) == [0, 2], "one file is damaged, one has no image"
    assert clouds[2].frame_id == "lidar"
    np.testing.assert_allclose(clouds[2].points_m, [(12.0, 2.0, -2.4)], atol=1e-6)
    ((_, _, edges),) = found["tf"]
    (ego_T_lidar,) = [edge.parent_T_child for edge in edges if (edge.parent, edge.child) == ("ego", "lidar")]
    in_ego = ego_T_lidar @ (12.0, 2.0, -2.4, 1.0)
    np.testing.assert_allclose(in_ego[:3], (2.0, -12.5, 0.0), atol=1e-6)


@pytest.mark.parametrize("content", [b"cut off", b""])
def test_an_unreadable_lidar_is_left_out_unless_chosen(tmp_path, capsys, content):
    dump = lidar_dump(tmp_path / "dump", lidar={"x": 0.0, "y": 0.0, "z": 2.4})
    for path in (dump / "velodyne").iterdir():
        path.write_bytes(content)
    out = tmp_path / "out.mcap"
    assert main([str(dump), str(out)]) == 0
    printed = capsys.readouterr()
    assert "note: velodyne is left out: none of 3 files can be read; " in printed.out
    assert "velodyne/000000.bin" in printed.out
    assert not printed.err
    found = payloads(out)
    assert "lidar" not in found
    assert [edge.child for edge in found["tf"][0][2]] == ["camera_front"]
    printed = failure(capsys, dump, tmp_path / "other.mcap", "--quiet", "--role", "lidar=velodyne")
    assert "velodyne" in printed
    assert "can be read" in printed


K = [[8.0, 0.0, 8.0], [0.0, 8.0, 6.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("folder", "printed", "cx", "words"),
    [
        ("rgb", {}, 7.5, "the first pixel's corner, as CARLA has it"),
        ("image_2", {}, 8.0, "the first pixel's centre, as KITTI has it"),
        ("image_2", {"pixel_origin": "corner"}, 7.5, "the first pixel's corner, as calibration.json says"),
        ("rgb", {"pixel_origin": "centre"}, 8.0, "the first pixel's centre, as calibration.json says"),
    ],
)
def test_the_pixel_origin_follows_the_format_and_is_printed(tmp_path, capsys, folder, printed, cx, words):
    dump, out = tmp_path / "dump", tmp_path / "in.mcap"
    write_png(dump / folder / "0000000001.png", camera_pixels())
    document(dump / "calibration.json", {"width": WIDTH, "height": HEIGHT, "K": K, **printed})
    role = () if folder == "rgb" else ("--role", f"image={folder}")
    assert words in printed_by(capsys, dump, out, *role)
    camera = payloads(out)["calibration"][0][2]
    assert (camera.cx, camera.cy) == (cx, cx - 2.0)
    assert info.main([str(out)]) == 0
    assert f"converted with a K that counts pixels from {words}" in capsys.readouterr().out


def test_converting_twice_gives_the_same_bytes(dump, tmp_path):
    first = convert(dump).read_bytes()
    other = tmp_path / "elsewhere" / "renamed"
    other.parent.mkdir()
    dump.rename(other)
    assert convert(other).read_bytes() == first


def test_truth_travels_beside_noisy_input(dump):
    write_png(dump / "truth" / "segmentation" / "000000.png", red(np.flip(TAGS, 1)))
    write_png(dump / "truth" / "depth" / "000000.png", carla_codes(depth_m() / 2))
    side = {"offset_m": 1.7, "heading": 0.0, "curvature_per_m": 0.0}
    document(dump / "truth.json", {"lanes": {"0": {"left": side}}})
    found = payloads(convert(dump))
    np.testing.assert_array_equal(found["truth_segmentation"][0][2].tags, np.flip(TAGS, 1))
    assert found["truth_depth"][0][2].depth_m.max() == np.float32(65.535)
    assert found["truth_lanes"][0][2].side("left").offset_m == 1.7


def test_frames_missing_in_a_sensor_stay_missing_and_are_counted(dump, capsys):
    (dump / "depth" / "000001.png").unlink()
    out = dump.parent / "out.mcap"
    assert main([str(dump), str(out)]) == 0
    row = next(line.split() for line in capsys.readouterr().out.splitlines() if line.split()[:1] == ["depth"])
    assert row[1:4] == ["depth", "2", "1"]
    assert [s for _, s, _ in payloads(out)["depth"]] == [0, 2]


def test_partly_paired_stamps_in_names_are_counted(tmp_path, capsys):
    dump = tum_dump(tmp_path / "dump", (0.004, 0.011, 0.016, 0.004))
    printed = printed_by(capsys, dump, tmp_path / "dump.mcap")
    assert re.search(r"^ *depth +depth +4 +2 ", printed, re.MULTILINE)
    assert (
        "depth: 2 of 4 images have no file within sync.tolerance_s (0.01 s), the nearest are 0.011 to 0.016 s"
        in printed
    )


@pytest.mark.parametrize("names", [("1.0001", "1.0002"), ("1.9", "1.10", "1.1")], ids=["too close", "equal"])
def test_decimal_names_that_may_be_frame_numbers_are_refused(tmp_path, capsys, names):
    for name in names:
        write_png(tmp_path / "dump" / "rgb" / f"{name}.png", np.zeros((48, 64, 3), np.uint8))
    assert f"{names[-1]}.png" in failure(capsys, tmp_path / "dump", tmp_path / "dump.mcap", "--fov", "90")


def test_a_rate_where_names_are_stamps_is_refused(tmp_path, capsys):
    assert main([str(tum_dump(tmp_path / "dump")), str(tmp_path / "out.mcap"), "--rate", "10"]) == 1
    assert "--rate 10: the names of the files are stamps" in capsys.readouterr().err


def test_an_unused_document_is_named(dump, capsys):
    document(dump / "metadata.json", {"timestamps": [1.0, 2.0, 3.0]})
    assert "metadata.json is not used: known documents are calibration.json, " in printed_by(
        capsys, dump, dump.parent / "out.mcap"
    )


def test_kitti_raw_keeps_its_own_dates(tmp_path):
    dump = tmp_path / "dump"
    write_png(dump / "image_02" / "data" / "0000000000.png", camera_pixels())
    (dump / "image_02" / "timestamps.txt").write_text("2011-09-26 13:02:25.964389445\n")
    ((stamp_ns, _, _),) = payloads(convert(dump, "--fov", "90"))["image"]
    assert stamp_ns + EPOCH_NS == 1317042145964389445


def test_steps_of_frame_numbers_are_noted(tmp_path, capsys):
    dump = plain_dump(tmp_path / "dump", frames=(142917, 142921, 142925))
    out = tmp_path / "out.mcap"
    assert "frame numbers have steps of 4: frames are 0.2 s apart at 20 Hz" in printed_by(capsys, dump, out)
    assert [t for t, _, _ in payloads(out)["image"]] == [0, 200_000_000, 400_000_000]


def test_lossy_input_is_converted_with_a_warning(dump, capsys):
    for number in range(3):
        write_png(
            dump / "depth" / f"{number:06d}.png", np.arange(WIDTH * HEIGHT, dtype=np.uint8).reshape(HEIGHT, WIDTH)
        )
        (dump / "segmentation" / f"{number:06d}.png").unlink()
        jpeg(dump / "segmentation" / f"{number:06d}.jpg", red(TAGS))
    convert(dump, "--allow-lossy-tags", "--grey-depth", "logarithmic")
    warnings = capsys.readouterr().err
    assert "logarithmic grey" in warnings
    assert "--allow-lossy-tags" in warnings


def test_the_same_left_images_are_not_stored_twice(dump):
    for number in range(3):
        write_png(dump / "left" / f"{number}.png", camera_pixels(number))
    assert "left" not in payloads(convert(dump))
    write_png(dump / "left" / "0.png", camera_pixels(9))
    found = payloads(convert(dump, "--force"))
    assert len(found["left"]) == 3
    assert found["left"][0][2].frame_id == found["left_calibration"][0][2].frame_id == "camera_left"


def test_depth_alone_is_enough(tmp_path):
    dump = tmp_path / "dump"
    write_png(dump / "depth" / "7.png", carla_codes(depth_m()))
    found = payloads(convert(dump, "--fov", "90"))
    assert set(found) == {"calibration", "depth"}
    assert found["depth"][0][2].frame_id == found["calibration"][0][2].frame_id == "camera_front"


def test_labels_of_yolo_are_detections_and_an_image_without_a_file_has_none(tmp_path):
    for number in (1, 2):
        write_png(tmp_path / "yolo" / "images" / f"{number}.png", camera_pixels(number))
    (tmp_path / "yolo" / "labels").mkdir()
    (tmp_path / "yolo" / "labels" / "1.txt").write_text("1 0.5 0.5 0.5 0.5\n")
    (tmp_path / "yolo" / "data.yaml").write_text("names: [person, car]\n")
    first, second = payloads(convert(tmp_path / "yolo", "--fov", "60"))["detections"]
    assert [(d.label, d.box_px) for d in first[2]] == [("car", Box(4, 3, 12, 9))]
    assert second[2] == ()


def test_the_plan_is_printed_before_writing(dump, capsys):
    document(dump / "detections.json", {"0": [{"label": "Car", "box_px": [1, 2, 3, 4], "score": 0.5}] * 2})
    write_png(dump / "sonar" / "0.png", camera_pixels())
    printed = printed_by(capsys, dump, dump.parent / "no" / "out.mcap")
    for words in ("png RGB 8 bit", "carla 24 bit", "raw in red", "2 boxes", "20 Hz", "carla-from-0.9.14", "sonar/"):
        assert words in printed
    last = printed.splitlines()[-1]
    assert "messages" in last
    assert "out.mcap" in last


def test_an_output_that_cannot_be_written_is_named(dump, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert "in.mcap" in failure(capsys, dump, tmp_path / "file" / "in.mcap", "--quiet")
    assert "is a folder" in failure(capsys, dump, tmp_path, "--quiet", "--force")


def test_only_a_log_is_written_over(dump, tmp_path, capsys):
    table = tmp_path / "in.metrics.parquet"
    table.write_bytes(b"a table")
    assert "expected a name that ends in .mcap" in failure(capsys, dump, table, "--quiet", "--force")
    assert table.read_bytes() == b"a table"


@pytest.mark.parametrize("make", [lambda _: None, lambda path: path.mkdir(), lambda path: path.write_text("")])
def test_a_path_without_a_dump(tmp_path, capsys, make):
    make(tmp_path / "dump")
    assert "dump" in failure(capsys, tmp_path / "dump", tmp_path / "out.mcap")


def test_a_role_path_that_does_not_exist_is_a_stated_error(dump, capsys):
    message = failure(capsys, dump, dump.parent / "out.mcap", "--role", "depth=nowhere")
    assert "--role depth=nowhere" in message


def test_the_log_states_how_it_was_made_without_data_of_the_machine(dump):
    (record,) = log.summarise(convert(dump)).metadata
    values = dict(record.values)
    assert values["encoding.depth"] == "carla 24 bit"
    assert values["tag_table"] == "carla-from-0.9.14"
    assert str(dump.parent) not in json.dumps(values)


SETS = {
    "carla_frame": {"image": 1, "calibration": 1, "depth": 1, "segmentation": 1, "detections": 1, "tf": 1},
    "carla_raw_tags": {"image": 3, "calibration": 1, "segmentation": 3},
    "course_frames": {"image": 2, "calibration": 1, "segmentation": 2, "detections": 2},
    "course_stereo": {"image": 1, "calibration": 1, "right": 1, "right_calibration": 1, "tf": 1},
    "course_odometry": {"image": 16, "calibration": 1},
}


@pytest.fixture(scope="module")
def real_logs(data_dir, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for name in SETS:
        assert main([str(data_dir / name), str(folder / f"{name}.mcap"), "--quiet"]) == 0
    return folder


@pytest.mark.parametrize("name", SETS)
def test_every_recording_converts(real_logs, name):
    found = payloads(real_logs / f"{name}.mcap")
    assert {role: len(messages) for role, messages in found.items()} == SETS[name]


def test_course_frames_have_their_road_pixels(real_logs):
    _, _, tags = payloads(real_logs / "course_frames.mcap")["segmentation"][0]
    assert np.count_nonzero(tags.tags == 7) == 411193
    assert tags.table.name_of(7) == "road"


def test_course_stereo_is_rectified_along_rows(real_logs):
    found = payloads(real_logs / "course_stereo.mcap")
    right = found["right_calibration"][0][2]
    assert right.baseline_m == pytest.approx(0.5)
    assert (right.fx, right.fy, right.cx, right.cy) == (640, 480, 639.5, 479.5)


def test_carla_frame_keeps_both_mountings_and_boxes_outside(real_logs):
    found = payloads(real_logs / "carla_frame.mcap")
    heights = {edge.child: edge.parent_T_child[2, 3] for edge in found["tf"][0][2]}
    assert heights == {"camera_front": 1.7, "camera_depth": 1.5}
    boxes = [d.box_px.rounded(1024, 768) for d in found["detections"][0][2]]
    outside = sum(x1 <= x0 or y1 <= y0 for x0, y0, x1, y1 in boxes)
    assert (len(boxes), outside) == (71, 17)


def test_a_lidar_without_mounting_is_noted(tmp_path, capsys):
    dump = lidar_dump(tmp_path / "dump")
    printed = printed_by(capsys, dump, tmp_path / "out.mcap")
    assert "the mounting of the lidar is unknown" in printed
    assert "lidar: 1 of 4 frames have no image: left out" in printed
    assert "KITTI velodyne, right-handed" in printed


def test_a_lidar_without_frames_of_the_cameras_is_left_out(tmp_path, capsys):
    dump = lidar_dump(tmp_path / "dump")
    for number in (0, 1, 2):
        (dump / "velodyne" / f"{number:06d}.bin").unlink()
    assert "note: velodyne is left out: none of its 1 frames has an image" in printed_by(
        capsys, dump, tmp_path / "out.mcap"
    )


def test_a_field_of_view_has_no_pixel_origin(tmp_path, capsys):
    write_png(tmp_path / "dump" / "rgb" / "1.png", camera_pixels())
    assert main([str(tmp_path / "dump"), str(tmp_path / "in.mcap"), "--fov", "90"]) == 0
    assert "pixel origin" not in capsys.readouterr().out
