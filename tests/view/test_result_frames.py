"""Frames, rows and stage times of a log are read; unreadable messages are left out and counted."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from roadperc_stream import log
from roadperc_stream.cli.view import main
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import LogError, TableError
from roadperc_stream.input.earlier_replay import is_result_of
from roadperc_stream.input.stream import Problems
from roadperc_stream.log import LogWriter, Message
from roadperc_stream.model import Absent, Boundary, Lanes
from roadperc_stream.output import encoding
from roadperc_stream.output.results import encode_metrics, result_channel
from roadperc_stream.output.tables import ROW_GROUP_ROWS, TableWriter
from roadperc_stream.schemas.columns import EXTRA_COLUMNS, FrameMetrics
from roadperc_stream.view.result_frames import ReplayTimes, TableTimes, read_frame, read_frames, read_rows
from roadperc_stream.view.video import write_video
from tests import logs
from tests.replaying import replay

FRAMES = 2 * ROW_GROUP_ROWS + 10


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A table of three row groups without lanes and with surface in even frames only."""
    path = tmp_path_factory.mktemp("times") / "out.metrics.parquet"
    with TableWriter(path, FrameMetrics, {}, EXTRA_COLUMNS) as writer:
        for frame in range(FRAMES):
            surface = {} if frame % 2 else {"surface_ms": 1.5}
            writer.append(FrameMetrics("log", frame, 10 * frame), total_ms=float(frame), **surface)
    return path


def test_stage_times_are_read_in_any_order(path):
    times = TableTimes(path)
    for frame in (0, 1, FRAMES - 1, 3, ROW_GROUP_ROWS, ROW_GROUP_ROWS - 1):
        surface = {} if frame % 2 else {"surface_ms": 1.5}
        assert times.of("log", frame) == {"total_ms": frame} | surface


def test_missing_frames_and_tables_have_no_times(path, tmp_path):
    for log_id, frame in (("another", 5), ("log", FRAMES), ("log", -1)):
        assert TableTimes(path).of(log_id, frame) == {}
    assert TableTimes(tmp_path / "out.metrics.parquet").of("log", 0) == {}
    with TableWriter(tmp_path / "out.metrics.parquet", FrameMetrics, {}, EXTRA_COLUMNS):
        pass
    assert TableTimes(tmp_path / "out.metrics.parquet").of("log", 0) == {}


@pytest.mark.parametrize("damage", ["cut", "text", "folder"])
def test_the_error_names_an_unreadable_table(path, tmp_path, damage):
    broken = tmp_path / "out.metrics.parquet"
    if damage == "folder":
        broken.mkdir()
    else:
        broken.write_bytes(path.read_bytes()[:-20] if damage == "cut" else b"frame,total_ms\n")
    with pytest.raises(TableError, match=r"out\.metrics\.parquet"):
        TableTimes(broken).of("log", 0)


def test_the_error_names_a_table_without_times(tmp_path):
    with TableWriter(tmp_path / "out.metrics.parquet", FrameMetrics, {}) as writer:
        writer.append(FrameMetrics("log", 0, 0))
    with pytest.raises(TableError, match="no column read_ms"):
        TableTimes(tmp_path / "out.metrics.parquet").of("log", 0)


def test_a_running_replay_returns_the_noted_times():
    times = ReplayTimes()
    times.note(FrameMetrics("log", 3, 0), {"total_ms": 7.0, "lanes_ms": 2.0})
    assert times.of("log", 3) == {"lanes_ms": 2.0, "total_ms": 7.0}
    assert times.of("log", 4) == times.of("another", 3) == {}


START = 1_600_000_000_000_000_000
STAMPS = [START + k * 50_000_000 for k in range(3)]
BAD = b"\xff\xfe"
PNG = cv2.imencode(".png", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()
LANES = Lanes((Boundary("left", "held"), Boundary("right", "lost")))
IMAGE, METRICS = "/camera/front/image", "/perception/metrics"
SCHEMAS = {
    IMAGE: "foxglove.CompressedImage",
    "/perception/lanes": "roadperc.Lanes",
    "/perception/drivable": "foxglove.CompressedImage",
    "/perception/overlay": "foxglove.CompressedImage",
    METRICS: "roadperc.FrameMetrics",
}


def channel(topic, name=""):
    found = result_channel(topic, name or SCHEMAS[topic])
    return replace(found, metadata=()) if topic == IMAGE else found


def contents(frame):
    stamp = STAMPS[frame]
    return {
        IMAGE: encoding.encode_image(stamp, "camera", "png", PNG),
        "/perception/lanes": encoding.encode_lanes(stamp, "camera", LANES),
        METRICS: encode_metrics("camera", FrameMetrics("log", frame, stamp, lane_left_status="held")),
    }


def write_log(path, bad=None, foreign=""):
    """Write three frames; ``bad`` replaces messages of the second one."""
    with LogWriter(path) as writer:
        for frame, stamp in enumerate(STAMPS):
            messages = contents(frame) | ((bad or {}) if frame == 1 else {})
            for topic in sorted(messages, key=list(SCHEMAS).index):
                known = channel(topic, "sensor_msgs/msg/Image" if topic == foreign else "")
                writer.write(Message(known, stamp, stamp, frame, messages[topic]))
    return path


def frames(path):
    problems = Problems()
    return list(read_frames(log.summarise(path), problems)), problems


NO_IMAGE = encoding.encode_image(STAMPS[1], "camera", "png", b"no png")


@pytest.mark.parametrize(
    ("topic", "data", "there"),
    [
        ("/perception/lanes", BAD, lambda seen: not isinstance(seen.lanes, Absent)),
        (IMAGE, BAD, lambda seen: seen is not None),
        (IMAGE, NO_IMAGE, lambda seen: seen is not None),
        ("/perception/drivable", NO_IMAGE, lambda seen: isinstance(seen.drivable, Absent)),
    ],
    ids=["lanes", "image", "pixels", "mask"],
)
def test_an_unreadable_message_counts_as_absent(tmp_path, topic, data, there):
    found, problems = frames(write_log(tmp_path / "out.mcap", {topic: data}))
    assert [there(seen) for _, seen in found] == [True, topic == "/perception/drivable", True]
    assert problems.counts == {topic: 1}
    assert problems.first[topic].startswith(f"{topic}: message at {STAMPS[1]} ns: ")


def test_a_frame_with_an_unreadable_row_is_left_out(tmp_path):
    row = encode_metrics("camera", FrameMetrics("log", 1, STAMPS[1], lane_left_offset_m=np.inf))
    path = write_log(tmp_path / "out.mcap", {METRICS: row})
    found, problems = frames(path)
    assert [row.frame for row, _ in found] == [0, 2]
    assert [row.frame for _, row in read_rows(log.summarise(path), Problems())] == [0, 2]
    assert "metrics: a number is not finite" in problems.first[METRICS]


def test_results_with_another_schema_are_ignored(tmp_path):
    found, problems = frames(write_log(tmp_path / "lanes.mcap", foreign="/perception/lanes"))
    assert [isinstance(seen.lanes, Absent) for _, seen in found] == [True] * 3
    assert not list(read_rows(log.summarise(write_log(tmp_path / "rows.mcap", foreign=METRICS)), problems))
    assert not problems.counts


def test_rows_of_a_version_with_other_columns_are_ignored():
    known = channel(METRICS)
    assert is_result_of(known, METRICS)
    assert not is_result_of(replace(known, schema_data=known.schema_data[:-1]), METRICS)


def test_an_unreadable_message_is_absent_in_a_frame_and_reported_by_a_video(tmp_path, capsys):
    source, problems = write_log(tmp_path / "out.mcap", {"/perception/lanes": BAD}), Problems()
    assert isinstance(read_frame(source, STAMPS[1], problems).lanes, Absent)
    assert list(problems.counts) == ["/perception/lanes"]
    assert main([str(source), "--video", str(tmp_path / "video.mp4")]) == 0
    out = capsys.readouterr().out
    assert "note: /perception/lanes: message at" in out
    assert "warning: 1 message on /perception/lanes could not be read, not shown" in out
    assert "(3 pictures at 20 Hz, of 3 frames)" in out


def test_an_unreadable_overlay_repeats_the_previous_picture(tmp_path):
    good = encoding.encode_image(STAMPS[0], "camera", "png", PNG)
    path = tmp_path / "out.mcap"
    with LogWriter(path) as writer:
        for frame, content in enumerate((good, BAD, good)):
            stamp = STAMPS[frame]
            row = contents(frame)[METRICS]
            writer.write(Message(channel(METRICS), stamp, stamp, frame, row))
            writer.write(Message(channel("/perception/overlay"), stamp, stamp, frame, content))
    video = write_video(path, tmp_path / "video.mp4")
    assert video.pictures == 3
    assert video.problems.counts == {"/perception/overlay": 1}


def test_a_video_of_unreadable_rows_says_why_it_fails(tmp_path):
    path = tmp_path / "out.mcap"
    with LogWriter(path) as writer:
        writer.write(Message(channel(METRICS), START, START, 0, BAD))
    with pytest.raises(
        LogError, match=r"no results for a video; /perception/metrics: message at \d+ ns: 2 bytes are not a"
    ):
        write_video(path, tmp_path / "video.mp4")


def test_the_image_is_from_the_camera_of_the_replay(tmp_path):
    """Topics of other cameras may come first, and the topic name need not contain the word camera."""
    source, target = tmp_path / "in.mcap", tmp_path / "out.mcap"
    of_front = [item for item in logs.items(frames=2) if item.role in ("calibration", "image")]
    black = cv2.imencode(".png", np.zeros((240, 320, 3), np.uint8))[1].tobytes()
    items = []
    for item in of_front:
        if item.role == "image":
            side = encoding.encode_image(item.stamp_ns, "side", "png", black)
            items += [logs.Item("image", item.stamp_ns, side, "/a"), replace(item, topic="/b")]
        else:
            items.append(item)
    logs.write(source, items)
    replay(source, target, ReplayConfig(), overrides={"image": "/b"})
    seen = [frame for _, frame in read_frames(log.summarise(target), Problems())]
    assert [frame.image_bgr.max() > 0 for frame in seen] == [True, True]
    stamp_ns = next(item.stamp_ns for item in items if item.topic == "/b")
    assert read_frame(target, stamp_ns, Problems()).image_bgr.max() > 0
