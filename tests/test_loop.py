"""Whole replays: messages, tables, equal bytes, cuts, and errors."""

import re
import signal
import subprocess
import sys
import time
from dataclasses import replace

import polars as pl
import pyarrow.parquet as pq
import pytest

from roadperc_stream import log
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.config import load_config
from roadperc_stream.errors import ChannelError, LogError, TargetError
from roadperc_stream.log import Channel, Message
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.topics import RESULTS
from roadperc_stream.system.time import TimeRange
from tests import logs
from tests.analytic import STEP_NS
from tests.replaying import replay

CFG = load_config()


@pytest.fixture
def source(tmp_path):
    return logs.write(tmp_path / "in.mcap", logs.items())


def run(source, name="out", **options):
    target = source.with_name(f"{name}.mcap")
    summary = replay(source, target, options.pop("cfg", CFG), **options)
    return target, summary


def metrics(target):
    return pl.read_parquet(sidecar_path(target, "metrics"))


def by_topic(path):
    topics = {}
    for message in log.read(log.summarise(path)):
        topics.setdefault(message.channel.topic, []).append(message)
    return topics


def test_a_row_per_frame_with_every_stage(source):
    target, summary = run(source)
    table = metrics(target)
    assert (table.height, summary.frames) == (6, 6)
    assert table["camera_height_m"].to_list() == pytest.approx([1.4] * 6, abs=2e-3)
    assert set(table["lane_left_status"]) == {"measured"}
    assert table["lane_width_m"].to_list() == pytest.approx([3.7] * 6, abs=0.1)
    assert table["detections_kept"].to_list() == [0] * 6
    assert table["total_ms"].min() > 0
    assert set(table["odometry_status"]) <= {"first", "tracked", "lost"}
    assert table["stereo_valid_ratio"].null_count() == 6
    assert set(table["reason_codes"].explode()) == {"stereo.no_right_image"}
    assert table["log_id"].unique().to_list() == [summary.log_id]
    objects = pl.read_parquet(sidecar_path(target, "objects"))
    assert objects.height == 12
    assert set(objects["label"]) == {"Car", "Pedestrian"}


def test_every_result_topic_is_written_in_log_time_order(source):
    target, _ = run(source)
    topics = by_topic(target)
    for topic in set(RESULTS) - {"/perception/log", "/perception/stereo/depth"}:
        assert [m.log_time_ns for m in topics[topic]] == [logs.START_NS + k * STEP_NS for k in range(6)], topic
    times = [m.log_time_ns for m in log.read(log.summarise(target))]
    assert times == sorted(times)


def plain(message):
    return (
        message.channel.topic,
        message.channel.schema_data,
        message.log_time_ns,
        message.publish_time_ns,
        message.sequence,
        message.data,
    )


def test_every_input_message_is_kept_byte_for_byte(tmp_path):
    foreign = Channel("/lidar/raw", "blob", "My.Scan", "", b"")
    extra = [Message(foreign, logs.START_NS + k, logs.START_NS - k, 7 + k, bytes([k])) for k in range(3)]
    source = logs.write(tmp_path / "in.mcap", logs.items(), extra)
    target, _ = run(source)
    kept = [plain(m) for m in log.read(log.summarise(target)) if not m.channel.topic.startswith("/perception")]
    assert kept == [plain(m) for m in log.read(log.summarise(source))]


def test_attachments_metadata_and_channels_without_messages_are_kept(tmp_path):
    source = tmp_path / "in.mcap"
    with log.LogWriter(source, profile="ros2") as writer:
        writer.register(Channel("/silent", "x"))
        for k, item in enumerate(logs.items(2)):
            writer.write(Message(logs.channel(item.role), item.stamp_ns, item.stamp_ns, k, item.data))
        writer.attach(log.Attachment("notes.txt", "text/plain", b"hi", 5, 6))
        writer.describe(log.Metadata("car", (("name", "x"),)))
    target, _ = run(source)
    summary = log.summarise(target)
    assert summary.profile == "ros2"
    assert "/silent" in [c.topic for c in summary.channels]
    assert [a.name for a in summary.attachments] == ["notes.txt", "roadperc.toml", "roadperc.state"]
    assert [m.name for m in summary.metadata] == ["car", "roadperc"]


def test_the_same_bytes_twice_and_again_from_the_output(source):
    first, _ = run(source, "first")
    second, _ = run(source, "second")
    again, _ = run(first, "again")
    assert first.read_bytes() == second.read_bytes() == again.read_bytes()


def test_results_of_another_configuration_are_replaced(source):
    first, _ = run(source, "first")
    changed = load_config(None, ("lanes.model=line",))
    again, _ = run(first, "again", cfg=changed)
    direct, _ = run(source, "direct", cfg=changed)
    assert again.read_bytes() == direct.read_bytes() != first.read_bytes()


def test_the_log_carries_its_configuration(source):
    cfg = load_config(None, ("lanes.hold_s=0.7",))
    target, summary = run(source, cfg=cfg)
    (attachment,) = [a for a in log.summarise(target).attachments if a.name == "roadperc.toml"]
    path = source.with_name("c.toml")
    path.write_bytes(attachment.data)
    assert load_config(path) == cfg
    (record,) = [m for m in log.summarise(target).metadata if m.name == "roadperc"]
    assert dict(record.values)["digest"].startswith(summary.log_id)


def test_cuts_apply_to_the_copied_messages(source):
    target, summary = run(source, time_range=TimeRange(start_s=0.1, frames=2))
    assert summary.frames == 2
    topics = by_topic(target)
    for topic in ("/camera/front/image", "/camera/front/depth", "/perception/metrics"):
        assert [m.log_time_ns - logs.START_NS for m in topics[topic]] == [2 * STEP_NS, 3 * STEP_NS]
    assert metrics(target)["lane_left_status"].to_list() == ["measured", "measured"]
    target, summary = run(source, "end", time_range=TimeRange(end_s=0.1))
    assert summary.frames == 2


@pytest.mark.parametrize(
    "cut", [TimeRange(start_s=0.1), TimeRange(start_s=0.1, frames=2), TimeRange(end_s=0.2), TimeRange(0.1, 0.2)]
)
def test_a_cut_has_the_earlier_calibration_and_replays_to_itself(source, cut):
    target, _ = run(source, time_range=cut)
    again, _ = run(target, "again")
    assert again.read_bytes() == target.read_bytes()
    assert set(metrics(target)["camera_height_m"].round(2)) == {1.4}


def test_only_the_last_calibration_before_a_cut_is_carried(tmp_path):
    items = logs.items()
    repeated = [logs.Item("calibration", logs.START_NS + k * STEP_NS, items[0].data) for k in range(1, 4)]
    ordered = sorted([*items, *repeated], key=lambda item: item.stamp_ns)
    source = logs.write(tmp_path / "in.mcap", ordered)
    target, _ = run(source, time_range=TimeRange(start_s=0.12))
    carried = by_topic(target)["/camera/front/calibration"]
    assert [m.log_time_ns - logs.START_NS for m in carried] == [2 * STEP_NS, 3 * STEP_NS]
    assert run(target, "again")[0].read_bytes() == target.read_bytes()


def late(items, role, delay_ns):
    """The messages of a role arrive later, with the same stamps."""
    return sorted(((i.stamp_ns + delay_ns * (i.role == role), k, i) for k, i in enumerate(items)), key=lambda x: x[:2])


@pytest.mark.parametrize("cut", [TimeRange(frames=3), TimeRange(end_s=0.15), TimeRange(start_s=0.05, frames=3)])
def test_a_late_sensor_is_not_cut_off_its_frame(tmp_path, cut):
    source = tmp_path / "in.mcap"
    with log.LogWriter(source) as writer:
        for time, k, item in late(logs.items(12), "depth", 200_000_000):
            writer.write(Message(logs.channel(item.role), time, time, k, item.data))
    target, summary = run(source, time_range=cut)
    assert summary.frames == 3
    assert metrics(target)["missing"].to_list() == [[]] * 3
    assert run(target, "again")[0].read_bytes() == target.read_bytes()


def test_a_calibration_after_the_cut_is_not_used(tmp_path):
    items = logs.items()
    ordered = [*items[1:], logs.Item("calibration", logs.START_NS + 10 * STEP_NS, items[0].data)]
    source = logs.write(tmp_path / "in.mcap", ordered)
    assert run(source)[1].frames == 6
    with pytest.raises(ChannelError, match="no calibration"):
        run(source, "cut", time_range=TimeRange(frames=3))


def test_the_error_names_the_fault_of_a_calibration(tmp_path):
    items = logs.items()
    items[0] = logs.Item("calibration", logs.START_NS, b"\xff\xff")
    with pytest.raises(
        ChannelError, match=r"no calibration .*; /camera/front/calibration: .* are not a valid foxglove"
    ):
        run(logs.write(tmp_path / "in.mcap", items))


@pytest.mark.parametrize("table", ["out.metrics.parquet", "out.objects.parquet"])
def test_tables_are_not_overwritten_either(source, table):
    source.with_name(table).write_bytes(b"mine")
    with pytest.raises(TargetError, match="--force"):
        run(source)
    assert source.with_name(table).read_bytes() == b"mine"
    source.with_name(table).unlink()
    source.with_name(table).mkdir()
    with pytest.raises(TargetError, match="is a folder"):
        run(source, force=True)
    assert not source.with_name("out.mcap").exists()


@pytest.mark.parametrize("name", ["out.mcap", "out.objects.parquet"])
def test_a_file_that_another_replay_wrote_stays(source, name):
    def other(done, expected):
        if done == expected:
            source.with_name(name).write_bytes(b"theirs")

    with pytest.raises(TargetError, match=f"{name}: exists; pass --force"):
        run(source, progress=other)
    assert {path.name for path in source.parent.iterdir()} == {"in.mcap", name}
    assert source.with_name(name).read_bytes() == b"theirs"


@pytest.mark.parametrize("table", ["metrics", "objects"])
def test_a_full_disk_at_the_end_leaves_neither_log_nor_table(source, monkeypatch, table):
    closing = pq.ParquetWriter.close

    def close(writer):
        closing(writer)
        if f".{table}." in str(writer.where):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq.ParquetWriter, "close", close)
    with pytest.raises(TargetError, match=rf"out\.{table}\.parquet: No space left on device"):
        run(source)
    assert [path.name for path in source.parent.iterdir()] == ["in.mcap"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_leaves_no_file(tmp_path, number):
    source = logs.write(tmp_path / "in.mcap", logs.items(60, road=replace(logs.SMALL, width=160, height=120)))
    command = [sys.executable, "-c", "import sys; from roadperc_stream.cli.launch import replay; sys.exit(replay())"]
    process = subprocess.Popen([*command, str(source), str(tmp_path / "out.mcap")], stderr=subprocess.PIPE, text=True)
    while process.poll() is None and not list(tmp_path.glob(".out*")):
        time.sleep(0.01)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (1, "error: interrupted\n")
    assert [p.name for p in tmp_path.iterdir()] == ["in.mcap"]


def test_results_only(source):
    target, _ = run(source, results_only=True)
    assert {m.channel.topic for m in log.read(log.summarise(target))} <= set(RESULTS)


def test_a_dropped_sensor_is_named_in_its_frame(tmp_path):
    items = [i for i in logs.items() if not (i.role == "depth" and i.stamp_ns == logs.START_NS + 2 * STEP_NS)]
    target, _ = run(logs.write(tmp_path / "in.mcap", items))
    table = metrics(target)
    assert table["missing"].to_list() == [[], [], ["depth"], [], [], []]
    assert table["surface_source"].to_list()[2] == "held"
    assert table["reason_codes"].to_list()[2] == [
        "depth.no_message",
        "stereo.no_right_image",
        "occupancy.no_depth",
        "surface.plane_held",
        "objects.no_depth_ground_distances",
    ]
    assert table["reasons"].to_list()[2][3] == {
        "source": "surface",
        "code": "plane_held",
        "values": [],
        "cause": "no_depth",
    }


@pytest.mark.parametrize("role", ["depth", "segmentation", "detections"])
def test_a_role_the_log_does_not_fill_is_null_with_a_reason(tmp_path, role):
    source = logs.write(tmp_path / "in.mcap", logs.items(roles=tuple(r for r in logs.ALL if r != role)))
    target, _ = run(source)
    table = metrics(target)
    assert table.height == 6
    if role == "depth":
        assert table["surface_source"].to_list() == ["assumed"] + ["estimated"] * 5
    if role == "segmentation":
        assert table["lane_left_offset_m"].null_count() == 6
        assert table["detections_unjudged"].to_list() == [2] * 6
        reasons = [
            "stereo.no_right_image",
            "lanes.no_segmentation",
            "surface.no_segmentation_lower_image",
            "objects.no_segmentation_not_filtered",
        ]
        assert table["reason_codes"].to_list() == [reasons] * 6
        texts = [m.data for m in by_topic(target)["/perception/log"]]
        assert len(texts) == len(reasons), "each is logged once, not in every frame"


def test_without_images_depth_makes_the_frames(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(roles=("calibration", "depth")))
    target, summary = run(source)
    assert summary.frames == 6
    assert set(metrics(target)["surface_source"]) == {"lower_image"}


def test_a_broken_message_is_counted_copied_and_named(tmp_path):
    items = logs.items()
    at = next(k for k, item in enumerate(items) if item.role == "detections")
    items[at] = logs.Item("detections", items[at].stamp_ns, b"\xff\xff\xff")
    source = logs.write(tmp_path / "in.mcap", items)
    target, summary = run(source)
    assert summary.problems == {"/camera/front/detections": 1}
    assert any("/camera/front/detections" in note and str(items[at].stamp_ns) in note for note in summary.notes)
    assert b"\xff\xff\xff" in [m.data for m in log.read(log.summarise(target))]
    assert metrics(target)["missing"].to_list()[0] == ["detections"]


def test_other_topics_by_name(tmp_path):
    items = [
        logs.Item(i.role, i.stamp_ns, i.data, "/cam/label" if i.role == "segmentation" else "") for i in logs.items()
    ]
    source = logs.write(tmp_path / "in.mcap", items)
    target, summary = run(source, overrides={"segmentation": "/cam/label"})
    assert set(metrics(target)["lane_left_status"]) == {"measured"}
    guessed, summary = run(source, "guessed")
    assert any("/cam/label" in note for note in summary.notes)
    assert guessed.read_bytes() == target.read_bytes()


def twice(role, items):
    return [*items, *[logs.Item(i.role, i.stamp_ns, i.data, "/other/view") for i in items if i.role == role]]


def renamed(role, items):
    return [logs.Item(i.role, i.stamp_ns, i.data, "/first/view" if i.role == role else "") for i in items]


@pytest.mark.parametrize(
    ("items", "words"),
    [
        (logs.items(roles=("image", "depth")), "no calibration"),
        (twice("image", renamed("image", logs.items())), "2 topics fit role image: /first/view, /other/view"),
        (logs.items(roles=("calibration", "detections")), "nothing to replay"),
        (
            [logs.Item("calibration", 5, logs.items()[0].data, "/camera/front/image")],
            "expected foxglove.CompressedImage",
        ),
        (logs.items(roles=("calibration",)), "nothing to replay"),
    ],
    ids=["no calibration", "two topics", "no image", "wrong schema", "no frames"],
)
def test_a_log_that_cannot_be_replayed_is_one_line_and_no_file(tmp_path, capsys, items, words):
    source = logs.write(tmp_path / "in.mcap", items)
    assert replay_main([str(source), str(tmp_path / "out.mcap")]) == 1
    err = capsys.readouterr().err
    assert re.fullmatch(r"error: [^\n]*\n", err)
    assert words in err
    assert str(source) in err
    assert [p.name for p in tmp_path.iterdir()] == ["in.mcap"]


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"time_range": TimeRange(start_s=100)}, LogError, r"in the requested part; the log lasts \d\.\d{3} s$"),
        ({"overrides": {"depth": "/nowhere"}}, ChannelError, "/nowhere"),
    ],
)
def test_a_time_range_or_topic_that_the_log_does_not_have_is_an_error(source, options, error, message):
    with pytest.raises(error, match=message):
        run(source, **options)


@pytest.mark.parametrize(
    "arguments",
    [["--frames", "0"], ["--only", "sonar"], ["--start", "x"], ["--start", "nan"], ["--end", "inf"], []],
    ids=["no frames", "no stage", "no number", "nan", "inf", "no files"],
)
def test_wrong_usage_is_exit_code_2(arguments, capsys):
    files = ["a", "b"] if arguments else []
    with pytest.raises(SystemExit) as caught:
        replay_main([*files, *arguments])
    assert caught.value.code == 2
    assert "usage:" in capsys.readouterr().err


def test_the_command_prints_its_outputs(source, capsys):
    target = source.with_name("out.mcap")
    assert replay_main([str(source), str(target), "--only", "surface", "--set", "surface.inlier_m=0.04"]) == 0
    out, err = capsys.readouterr()
    assert "6 frames" in out
    assert str(target) in out
    assert err == ""
    assert metrics(target)["reason_codes"].to_list()[0] == [
        f"{stage}.switched_off" for stage in ("stereo", "odometry", "lanes", "objects", "occupancy")
    ]
    assert replay_main([str(source), str(target), "--force", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
