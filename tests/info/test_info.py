"""roadperc-info prints the facts of logs with known contents."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.writer import Writer

from roadperc_stream.cli.info import main
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.info.examine import examine
from roadperc_stream.log import Channel, LogWriter, Message, Metadata, read, summarise
from roadperc_stream.output import encoding
from roadperc_stream.output.tables import sidecar_path
from tests import logs
from tests.info.odd import SECOND_NS, write

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"


def info(capsys, *arguments):
    """Exit code, stdout and stderr of roadperc-info."""
    code = main([str(argument) for argument in arguments])
    return code, *capsys.readouterr()


def facts_of(path, **overrides):
    return examine(path, overrides)


def only_channel(path):
    (channel,) = facts_of(path).channels
    return channel


def test_rate_and_longest_gap(tmp_path):
    times = [10 * SECOND_NS + k * SECOND_NS // 10 for k in range(20)]
    del times[12:15]
    channel = only_channel(write(tmp_path / "a.mcap", times))
    assert channel.rate_hz == pytest.approx(10.0)
    assert (channel.longest_gap_s, channel.gap_at_s) == pytest.approx((0.4, 1.1))
    assert (channel.stamps_back, channel.stamps_repeated, channel.log_times_back) == (0, 0, 0)


def test_stamps_and_log_times_that_go_back_are_counted(tmp_path):
    image = next(item for item in logs.items(1) if item.role == "image")
    stamps = [logs.START_NS + k for k in (5, 6, 4, 4, 7, 3, 9)]
    data = [encoding.encode_image(stamp_ns, "camera", "png", image.data) for stamp_ns in stamps]
    messages = [
        Message(logs.channel("image"), logs.START_NS + k * SECOND_NS, 1, k, item) for k, item in enumerate(data)
    ]
    images = {c.topic: c for c in facts_of(logs.write(tmp_path / "a.mcap", [], messages)).channels}[
        "/camera/front/image"
    ]
    assert (images.stamps_back, images.stamps_repeated) == (2, 1)
    facts = facts_of(write(tmp_path / "b.mcap", [3, 5, 4, 9, 9, 1]))
    assert (facts.log_times_back, facts.channels[0].log_times_back) == (2, 2)
    assert (facts.first_ns, facts.last_ns) == (1, 9)


def test_the_log_id_does_not_depend_on_the_order_in_the_file(tmp_path):
    ordered = write(tmp_path / "a.mcap", [1, 2, 3, 4])
    shuffled = write(tmp_path / "b.mcap", [3, 1, 4, 2])
    assert facts_of(ordered).log_id == facts_of(shuffled).log_id is not None


def test_huge_gaps_and_times_beyond_any_date_are_printed(tmp_path, capsys):
    path = write(tmp_path / "a.mcap", [0, 1, 2, 3, 2**63, 2**64 - 1], stamps=[1] * 6)
    code, out, _ = info(capsys, path)
    assert code == 0
    assert "9223372036.9" in out.replace("\n", "")
    found = only_channel(write(tmp_path / "a.mcap", [0, 2**64 - 1], stamps=[1] * 2))  # a gap of more than 63 bits
    assert found.longest_gap_s == pytest.approx((2**64 - 1) / 1e9)


def test_logs_without_messages_or_channels_are_printed(tmp_path, capsys):
    code, out, _ = info(capsys, write(tmp_path / "a.mcap", []))
    assert (code, "0 messages on 1 channel" in out) == (0, True)
    with LogWriter(tmp_path / "b.mcap") as writer:
        writer.describe(Metadata("notes", (("k", "v"),)))
    code, out, _ = info(capsys, tmp_path / "b.mcap")
    assert (code, "metadata notes" in out, "0 channels" in out) == (0, True, True)


def test_control_characters_in_names_are_escaped(tmp_path, capsys):
    code, out, _ = info(capsys, write(tmp_path / "a.mcap", [1, 2], topic="/straße/\x1b[31m\n車"))
    assert (code, "\x1b" in out) == (0, False)
    assert r"/straße/\x1b[31m\n車  " in out


def test_long_names_are_not_cut_in_80_columns(tmp_path, capsys):
    topic = "/carla/ego_vehicle/semantic_segmentation_front/camera_info"
    with LogWriter(tmp_path / "a.mcap") as writer:
        writer.write(Message(Channel(topic, "cdr", "vision_msgs/msg/Detection2DArray", "ros2msg", b""), 1, 1, 1, b"?"))
    _, out, _ = info(capsys, tmp_path / "a.mcap")
    assert "  vision_msgs/msg/Detection2DArray\n" in out
    assert f"\n{topic} " in out


def test_many_channels_are_listed(tmp_path, capsys):
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for k in range(400):
            writer.add_message(writer.register_channel(f"/c{k}", "raw", 0), k, b"", k)
        writer.finish()
    code, out, _ = info(capsys, tmp_path / "a.mcap")
    assert (code, "400 messages on 400 channels" in out, "/c399" in out) == (0, True, True)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return logs.write(tmp_path_factory.mktemp("info") / "in.mcap", logs.items(frames=5))


def states(facts):
    return {state.role: state for state in facts.replay.roles}


def test_an_input_log_gives_roles_frames_and_cameras(source):
    facts = facts_of(source)
    replay, found = facts.replay, states(facts)
    assert {role for role, state in found.items() if state.state == "filled"} == set(logs.ALL)
    assert (replay.refusal, replay.reference, replay.frames, replay.skew_s) == (None, "image", 5, 0.0)
    assert (dict(replay.alone), dict(replay.unused), replay.unreadable) == ({}, {}, {})
    (found_camera,) = replay.cameras
    assert found_camera.camera == logs.SMALL.camera
    assert found_camera.ego_T_camera == tuple(map(tuple, logs.SMALL.ego_T_camera.tolist()))
    assert replay.tag_table == logs.TABLE.name


COSTS = {
    "calibration": "a replay stops",
    "depth": "lower",
    "segmentation": "no lanes",
    "detections": "no objects",
    "tf": "assumed_height_m",
}


@pytest.mark.parametrize("role", COSTS)
def test_a_missing_role_is_printed_with_its_consequence(tmp_path, capsys, role):
    path = logs.write(tmp_path / "in.mcap", logs.items(3, roles=set(logs.ALL) - {role}))
    state = states(facts_of(path))[role]
    assert state.state == "missing"
    assert COSTS[role] in state.cost
    assert COSTS[role] in info(capsys, path)[1]


def test_a_given_camera_is_no_longer_missing(tmp_path, capsys):
    path = logs.write(tmp_path / "in.mcap", logs.items(3, roles=set(logs.ALL) - {"calibration", "tf"}))
    text = " ".join(info(capsys, path, "--fov", "90", "--height", "1.5")[1].split())
    assert "calibration missing: the given calibration is used" in text
    assert "tf missing: the given mounting is used" in text
    alone = " ".join(info(capsys, path, "--fov", "90")[1].split())
    assert "calibration missing: the given calibration is used" in alone
    assert "tf missing: the camera is assumed level" in alone


def test_static_transforms_replace_transforms(tmp_path, capsys):
    items = [replace(item, topic="/tf_static" if item.role == "tf" else "") for item in logs.items(2)]
    path = logs.write(tmp_path / "in.mcap", items)
    found = states(facts_of(path))
    assert (found["tf_static"].state, found["tf"].state, found["tf"].cost) == ("filled", "missing", "")
    assert "assumed_height_m" not in info(capsys, path)[1]


def test_an_odometry_topic_is_the_truth_only_by_option(tmp_path, capsys):
    odometry = Message(Channel("/odom", "cdr", "nav_msgs/msg/Odometry", "ros2msg", b""), logs.START_NS, 1, 0, b"")
    path = logs.write(tmp_path / "in.mcap", logs.items(2), [odometry])
    found = states(facts_of(path))["truth_pose"]
    assert (found.state, found.candidates) == ("missing", ("/odom",))
    out = " ".join(info(capsys, path)[1].split())
    assert "a pose topic counts as truth only if you pass it; try --topic truth_pose=/odom" in out
    assert not any("truth" in note for note in facts_of(path).replay.notes)
    assert states(facts_of(path, truth_pose="/odom"))["truth_pose"].why == "--topic"
    assert "truth" not in info(capsys, logs.write(tmp_path / "no_pose.mcap", logs.items(2)))[1]


def test_images_of_another_size_than_their_calibration_are_reported(tmp_path, source, capsys):
    assert facts_of(source).replay.cameras[0].image_size == (logs.SMALL.width, logs.SMALL.height)
    assert "images of" not in info(capsys, source)[1]
    wide = [item for item in logs.items(2, road=replace(logs.SMALL, width=400)) if item.role == "calibration"]
    others = [item for item in logs.items(2) if item.role != "calibration"]
    path = logs.write(tmp_path / "wide.mcap", [*wide, *others])
    (camera,) = facts_of(path).replay.cameras
    assert (camera.camera.width, camera.image_size) == (400, (320, 240))
    assert "images of 320x240" in info(capsys, path)[1]


def test_a_wrong_schema_names_the_found_and_the_expected_one(tmp_path):
    items = [replace(item, topic="/camera/front/detections") for item in logs.items(3) if item.role == "image"]
    state = states(facts_of(logs.write(tmp_path / "in.mcap", [*logs.items(3, roles=("calibration", "tf")), *items])))
    assert state["detections"].state == "wrong schema"
    assert "found foxglove.CompressedImage (protobuf), expected roadperc.Detections" in state["detections"].why


def test_two_channels_with_one_topic_are_reported(tmp_path):
    twin = replace(logs.channel("image"), metadata=(("a", "b"),))
    image = next(item for item in logs.items(1) if item.role == "image")
    extra = [Message(twin, image.stamp_ns, image.stamp_ns, 1, image.data)]
    facts = facts_of(logs.write(tmp_path / "in.mcap", logs.items(3), extra))
    assert states(facts)["image"].state == "several channels"
    assert "2 channels carry this topic" in facts.replay.refusal


def test_topics_are_guessed_or_given_by_option(tmp_path, capsys):
    items = [replace(item, topic="/my/rgb" if item.role == "image" else "") for item in logs.items(3)]
    path = logs.write(tmp_path / "in.mcap", items)
    assert states(facts_of(path))["image"].why == "guessed"
    assert states(facts_of(path, image="/my/rgb"))["image"].why == "--topic"
    code, out, _ = info(capsys, path, "--topic", "image=/not/there")
    assert (code, "a replay stops: --topic image=/not/there: no such topic" in " ".join(out.split())) == (0, True)
    code, _, error = info(capsys, path, "--topic", "image")
    assert (code, "expected ROLE=/TOPIC" in error) == (1, True)


def test_unpaired_frames_and_messages_are_counted(tmp_path):
    late_ns = logs.STEP_NS // 3
    others = [item for item in logs.items(4) if item.role != "detections"]
    stamps = [item.stamp_ns + late_ns for item in others if item.role == "image"]
    late = [logs.Item("detections", stamp, encoding.encode_detections(stamp, "camera", ())) for stamp in stamps]
    replay = facts_of(logs.write(tmp_path / "in.mcap", [*others, *late])).replay
    assert (replay.frames, dict(replay.alone), dict(replay.unused)) == (4, {"detections": 4}, {"detections": 4})


def test_unreadable_messages_are_counted(tmp_path, capsys):
    items = [replace(item, data=b"\xff") if item.role == "detections" else item for item in logs.items(3)]
    path = logs.write(tmp_path / "in.mcap", items)
    replay = facts_of(path).replay
    assert dict(replay.unreadable) == {"/camera/front/detections": 3}
    assert len(replay.problems) == 1
    out = " ".join(info(capsys, path)[1].split())
    assert "a role that is readable and within the tolerance: detections 3" in out
    replay = json.loads(info(capsys, "--json", path)[1])["replay"]
    assert (replay["unreadable"], replay["alone"]) == ({"/camera/front/detections": 3}, {"detections": 3})


@pytest.fixture(scope="module")
def result(source):
    out = source.with_name("out.mcap")
    assert replay_main([str(source), str(out), "--quiet", "--set", "lanes.hold_s=2.0"]) == 0
    return out


def test_a_result_gives_its_provenance(source, result, capsys):
    facts = facts_of(result)
    found = facts.provenance
    assert (facts.kind, facts.log_id, found.changed) == ("result", facts_of(source).log_id, False)
    assert [(s.key, s.value, s.default) for s in found.settings] == [("lanes.hold_s", "2.0", "0.5")]
    assert [(Path(t.path).name, t.rows, t.fault) for t in found.tables] == [
        ("out.metrics.parquet", 5, ""),
        ("out.objects.parquet", 10, ""),
    ]
    code, out, _ = info(capsys, result)
    assert code == 0
    assert all(text in out for text in ("a result of", "seed 0, 5 frames", "unchanged since the replay"))
    assert re.search(r"lanes\.hold_s\W+2\.0\W+0\.5", out)


def test_an_input_changed_after_the_replay_is_reported(result, tmp_path, capsys):
    changed = tmp_path / "changed.mcap"
    with LogWriter(changed) as writer:
        for message in list(read(summarise(result)))[1:]:
            writer.write(message)
        record = {"version": "0", "seed": "0", "digest": facts_of(result).provenance.digest, "dropped.depth": "4"}
        record["digest_algorithm"] = "blake3"
        writer.describe(Metadata("roadperc", tuple(record.items())))
    found = facts_of(changed).provenance
    assert (found.changed, dict(found.dropped)) == (True, {"depth": 4})
    out = info(capsys, changed)[1]
    assert "CHANGED" in out
    assert "changed.metrics.parquet: missing" in out


def test_a_result_without_its_input_has_no_digest_and_other_tables_are_reported(source, result, tmp_path):
    out, other = tmp_path / "only.mcap", tmp_path / "other.mcap"
    assert replay_main([str(source), str(out), "--quiet", "--results-only"]) == 0
    facts = facts_of(out)
    assert (facts.kind, facts.log_id, facts.provenance.digest_found) == ("result", None, None)
    assert "nothing to replay" in facts.replay.refusal
    shutil.copy(result, other)
    sidecar_path(out, "metrics").replace(sidecar_path(other, "metrics"))
    sidecar_path(other, "objects").write_bytes(b"no table")
    faults = [table.fault for table in facts_of(other).provenance.tables]
    assert faults == ["belongs to another configuration", "not a table of a replay, or truncated"]


def test_a_truncated_result_is_a_damaged_result(result, tmp_path, capsys):
    (tmp_path / "cut.mcap").write_bytes(result.read_bytes()[:-20_000])
    code, out, error = info(capsys, tmp_path / "cut.mcap")
    assert (code, error.count("\n")) == (1, 1)
    assert "DAMAGED, a result" in out
    assert "last message before that" in out


def test_an_unreadable_log_does_not_stop_the_others(source, tmp_path, capsys):
    (tmp_path / "text.mcap").write_text("no log at all")
    code, out, error = info(capsys, tmp_path / "text.mcap", source, tmp_path / "gone.mcap")
    assert code == 1
    assert "in.mcap: whole" in out
    assert "not an MCAP log" not in out
    assert error.index("not an MCAP log") < error.index("gone.mcap: No such file")
    assert error.count("\n") == 1
    (tmp_path / "empty").mkdir()
    for path, fault in ((tmp_path / "gone.mcap", "No such file"), (tmp_path / "empty", "roadperc-convert")):
        code, out, error = info(capsys, path)
        assert (code, out, error.count(fault), error.count("\n")) == (1, "", 1, 1)


def test_json_has_one_line_per_log(source, tmp_path, capsys):
    code, out, _ = info(capsys, "--json", source, tmp_path / "gone.mcap")
    found, gone = map(json.loads, out.splitlines())
    assert code == 1
    assert (found["messages"], found["replay"]["frames"], found["file"]["whole"]) == (22, 5, True)
    assert found["channels"][0].keys() >= {"topic", "schema", "rate_hz", "longest_gap_s", "stamps_back"}
    assert gone.keys() == {"log", "error"}


def test_json_has_null_for_nan(tmp_path, capsys):
    camera = replace(logs.SMALL.camera, distortion=(float("nan"), 0.1))
    data = encoding.encode_calibration(logs.START_NS, camera)
    items = [replace(item, data=data) if item.role == "calibration" else item for item in logs.items(2)]
    _, out, _ = info(capsys, "--json", logs.write(tmp_path / "in.mcap", items))
    (found,) = json.loads(out, parse_constant=pytest.fail)["replay"]["cameras"]
    assert found["camera"]["distortion"] == [None, 0.1]


def test_the_sample_has_the_log_id_of_the_readme(capsys, monkeypatch):
    monkeypatch.chdir(SAMPLE.parent)  # names do not wrap, and a long folder would make lines longer
    code, out, _ = info(capsys, SAMPLE.name)
    assert (code, "log 06e969632831a75f" in out, "40 frames" in out) == (0, True, True)
    assert all(len(line) <= 80 for line in out.splitlines())


def test_any_cut_and_any_wrong_byte_gives_one_line(source, tmp_path, capsys):
    whole, path = source.read_bytes(), tmp_path / "broken.mcap"
    for k in range(24):
        at = 8 + k * (len(whole) - 9) // 24
        for content in (whole[:at], whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :]):
            path.write_bytes(content)
            code, _, error = info(capsys, path)
            assert (code, error.count("\n")) == (1, 1), at


def test_a_channel_without_a_schema_is_reported(tmp_path, capsys):
    with LogWriter(tmp_path / "a.mcap") as writer:
        writer.write(Message(Channel("/camera/front/image", "x"), 1, 1, 1, b"?"))
    code, out, _ = info(capsys, tmp_path / "a.mcap")
    assert (code, "found no schema (x), expected" in " ".join(out.split())) == (0, True)
