"""What roadperc-info says of logs whose contents are known."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.writer import Writer

from roadperc_stream.cli.info import main
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.info.examine import examine
from roadperc_stream.log import Channel, LogWriter, Message, MessageDigest, Metadata, read, summarise
from roadperc_stream.output import encoding
from roadperc_stream.output.tables import sidecar_path
from tests import logs
from tests.info.odd import SECOND_NS, write

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"


def info(capsys, *arguments):
    """Exit code, what was printed, and what was said on stderr."""
    code = main([str(argument) for argument in arguments])
    return code, *capsys.readouterr()


def facts_of(path, **overrides):
    return examine(path, overrides)


def only_channel(path):
    (channel,) = facts_of(path).channels
    return channel


def test_rate_jitter_and_longest_gap(tmp_path):
    times = [10 * SECOND_NS + k * SECOND_NS // 10 for k in range(20)]
    del times[12:15]
    channel = only_channel(write(tmp_path / "a.mcap", times))
    assert channel.rate_hz == pytest.approx(10.0)
    assert (channel.longest_gap_s, channel.gap_at_s) == pytest.approx((0.4, 1.1))
    assert channel.jitter_s == pytest.approx(0.075)  # between 14 zeros and one of 0.3: the 95 % of 16 intervals
    assert (channel.stamps_back, channel.stamps_repeated, channel.log_times_back) == (0, 0, 0)


def test_stamps_that_go_back_repeat_or_are_unset_are_counted(tmp_path):
    times = [k * SECOND_NS for k in range(1, 9)]
    stamps = [5, 6, 4, 4, 7, 0, 3, 9]
    channel = only_channel(write(tmp_path / "a.mcap", times, stamps=stamps))
    assert (channel.stamps_back, channel.stamps_back_at_s) == (2, 2.0)
    assert (channel.stamps_repeated, channel.stamps_unset) == (1, 1)


def test_log_times_that_go_back_are_counted(tmp_path):
    times = [3, 5, 4, 9, 9, 1]
    facts = facts_of(write(tmp_path / "a.mcap", times))
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


def test_a_gap_of_more_than_63_bits(tmp_path):
    found = facts_of(write(tmp_path / "a.mcap", [0, 2**64 - 1], stamps=[1] * 2)).channels[0]
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
        for k in range(3000):
            writer.add_message(writer.register_channel(f"/c{k}", "raw", 0), k, b"", k)
        writer.finish()
    code, out, _ = info(capsys, tmp_path / "a.mcap")
    assert (code, "3000 messages on 3000 channels" in out, "/c2999" in out) == (0, True, True)


@pytest.fixture
def drive(tmp_path):
    return logs.write(tmp_path / "in.mcap", logs.items(frames=5))


def states(facts):
    return {state.role: state for state in facts.replay.roles}


def test_an_input_log_gives_roles_frames_and_cameras(drive):
    facts = facts_of(drive)
    replay, found = facts.replay, states(facts)
    assert {role for role, state in found.items() if state.state == "filled"} == set(logs.ALL)
    assert (replay.refusal, replay.reference, replay.frames, replay.skew_s) == (None, "image", 5, 0.0)
    assert (dict(replay.alone), dict(replay.unused), replay.unreadable) == ({}, {}, {})
    (found_camera,) = replay.cameras
    assert found_camera.camera == logs.SMALL.camera
    assert found_camera.ego_T_camera == tuple(map(tuple, logs.SMALL.ego_T_camera.tolist()))
    assert replay.tag_table == logs.TABLE.name


@pytest.mark.parametrize(
    ("role", "cost"),
    [
        ("calibration", "a replay stops"),
        ("depth", "no distances"),
        ("segmentation", "no lanes"),
        ("detections", "no objects"),
        ("tf", "assumed_height_m"),
    ],
)
def test_a_missing_role_is_printed_with_its_consequence(tmp_path, capsys, role, cost):
    path = logs.write(tmp_path / "in.mcap", logs.items(3, roles=set(logs.ALL) - {role}))
    state = states(facts_of(path))[role]
    assert state.state == "missing"
    assert cost in state.cost
    assert cost in info(capsys, path)[1]


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
    said = " ".join(info(capsys, path)[1].split())
    assert "the truth only if you say so; could be --topic truth_pose=/odom" in said
    assert not any("truth" in note for note in facts_of(path).replay.notes)
    assert states(facts_of(path, truth_pose="/odom"))["truth_pose"].why == "--topic"


def test_a_log_without_poses_prints_nothing_about_truth(drive, capsys):
    assert "truth" not in info(capsys, drive)[1]


def test_images_of_another_size_than_their_calibration_are_reported(tmp_path, drive, capsys):
    assert facts_of(drive).replay.cameras[0].image_size == (logs.SMALL.width, logs.SMALL.height)
    assert "images of" not in info(capsys, drive)[1]
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
    code, _, said = info(capsys, path, "--topic", "image")
    assert (code, "expected ROLE=/TOPIC" in said) == (1, True)


def test_unpaired_frames_and_messages_are_counted(tmp_path):
    late_ns = logs.STEP_NS // 3
    items = [
        replace(item, stamp_ns=item.stamp_ns + late_ns, data=moved) if item.role == "detections" else item
        for item, moved in zip(logs.items(4), moved_by(logs.items(4), late_ns), strict=True)
    ]
    replay = facts_of(logs.write(tmp_path / "in.mcap", items)).replay
    assert (replay.frames, dict(replay.alone), dict(replay.unused)) == (4, {"detections": 4}, {"detections": 4})


def moved_by(items, late_ns):
    """Each message as it would be with a later stamp, by making the drive's messages anew."""
    for item in items:
        anew = {part.role: part.data for part in logs.frame_items(item.stamp_ns + late_ns, logs.SMALL)}
        yield anew.get(item.role, item.data)


def test_unreadable_messages_are_counted(tmp_path, capsys):
    items = [replace(item, data=b"\xff") if item.role == "detections" else item for item in logs.items(3)]
    path = logs.write(tmp_path / "in.mcap", items)
    replay = facts_of(path).replay
    assert dict(replay.unreadable) == {"/camera/front/detections": 3}
    assert len(replay.problems) == 1
    said = " ".join(info(capsys, path)[1].split())
    assert "a role that is within the tolerance and can be decoded: detections 3" in said


@pytest.fixture
def result(drive, tmp_path):
    out = tmp_path / "out.mcap"
    assert replay_main([str(drive), str(out), "--quiet", "--set", "lanes.hold_s=2.0"]) == 0
    return out


def test_a_result_gives_its_provenance(drive, result, capsys):
    facts = facts_of(result)
    found = facts.provenance
    assert (facts.kind, facts.log_id, found.changed) == ("result", facts_of(drive).log_id, False)
    assert [(s.key, s.value, s.default) for s in found.settings] == [("lanes.hold_s", "2.0", "0.5")]
    assert [(Path(t.path).name, t.rows, t.fault) for t in found.tables] == [
        ("out.metrics.parquet", 5, ""),
        ("out.objects.parquet", 10, ""),
    ]
    code, out, _ = info(capsys, result)
    assert code == 0
    assert all(words in out for words in ("a result of", "seed 0, 5 frames", "those that were replayed"))
    assert re.search(r"lanes\.hold_s\W+2\.0\W+0\.5", out)


def test_an_input_changed_after_the_replay_is_reported(result, tmp_path, capsys):
    changed = tmp_path / "changed.mcap"
    with LogWriter(changed) as writer:
        for message in list(read(summarise(result)))[1:]:
            writer.write(message)
        said = {"version": "0", "seed": "0", "digest": facts_of(result).provenance.digest, "dropped.depth": "4"}
        said["digest_algorithm"] = "blake3"
        writer.describe(Metadata("roadperc", tuple(said.items())))
    found = facts_of(changed).provenance
    assert (found.changed, dict(found.dropped)) == (True, {"depth": 4})
    out = info(capsys, changed)[1]
    assert "CHANGED" in out
    assert "changed.metrics.parquet: is not there" in out


def with_record(result, path, **changes):
    """A result with other words in its record; None takes one out."""
    summary = summarise(result)
    (record,) = [dict(record.values) for record in summary.metadata if record.name == "roadperc"]
    with LogWriter(path) as writer:
        for message in read(summary):
            writer.write(message)
        said = {key: value for key, value in {**record, **changes}.items() if value is not None}
        writer.describe(Metadata("roadperc", tuple(said.items())))
    return path


def input_digest(result, algorithm):
    digest = MessageDigest(algorithm)
    for message in read(summarise(result)):
        if not message.channel.label("producer"):
            digest.update(message)
    return digest.hexdigest()


def test_results_with_old_and_new_digests_are_compared(result, tmp_path):
    digest = input_digest(result, "sha256")
    found = facts_of(with_record(result, tmp_path / "before.mcap", digest=digest, digest_algorithm=None))
    assert (found.log_id, found.provenance.changed) == (digest[:16], False)
    digest = input_digest(result, "blake3")
    found = facts_of(with_record(result, tmp_path / "same.mcap"))
    assert (found.log_id, found.provenance.digest, found.provenance.changed) == (digest[:16], digest, False)


def test_an_unknown_digest_algorithm_is_not_compared(result, tmp_path, capsys):
    changed = with_record(result, tmp_path / "later.mcap", digest_algorithm="blake9")
    found = facts_of(changed)
    assert (found.log_id, found.provenance.digest_found, found.provenance.changed) == (None, None, False)
    assert "whose digest blake9 is not known here" in info(capsys, changed)[1]


def test_tables_of_another_replay_are_reported(drive, result):
    other = result.with_name("other.mcap")
    assert replay_main([str(drive), str(other), "--quiet"]) == 0
    sidecar_path(other, "metrics").replace(sidecar_path(result, "metrics"))
    sidecar_path(result, "objects").write_bytes(b"no table")
    faults = [table.fault for table in facts_of(result).provenance.tables]
    assert faults == ["is of another configuration", "is not a table of a replay, or was cut short"]


def test_a_result_without_its_input_has_no_digest(drive, tmp_path):
    out = tmp_path / "only.mcap"
    assert replay_main([str(drive), str(out), "--quiet", "--results-only"]) == 0
    facts = facts_of(out)
    assert (facts.kind, facts.log_id, facts.provenance.digest_found) == ("result", None, None)
    assert "nothing to replay" in facts.replay.refusal


def test_a_truncated_result_is_a_damaged_result(result, capsys):
    result.write_bytes(result.read_bytes()[:-20_000])
    code, out, said = info(capsys, result)
    assert (code, said.count("\n")) == (1, 1)
    assert "DAMAGED, a result" in out
    assert "last message before that" in out


def test_an_unreadable_log_does_not_stop_the_others(drive, tmp_path, capsys):
    (tmp_path / "text.mcap").write_text("no log at all")
    code, out, said = info(capsys, tmp_path / "text.mcap", drive, tmp_path / "gone.mcap")
    assert code == 1
    assert "in.mcap: whole" in out
    assert "not an MCAP log" not in out
    assert said.index("not an MCAP log") < said.index("gone.mcap: No such file")
    assert said.count("\n") == 1


def test_a_log_that_cannot_be_opened_gives_one_line(tmp_path, capsys):
    for path, fault in ((tmp_path / "gone.mcap", "No such file"), (tmp_path, "roadperc-convert")):
        code, out, said = info(capsys, path)
        assert (code, out, said.count(fault), said.count("\n")) == (1, "", 1, 1)


def test_json_has_one_line_per_log(drive, tmp_path, capsys):
    code, out, _ = info(capsys, "--json", drive, tmp_path / "gone.mcap")
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
    monkeypatch.chdir(SAMPLE.parent)  # names stay whole on their line, however long the folder's
    code, out, _ = info(capsys, SAMPLE.name)
    assert (code, "log 06e969632831a75f" in out, "40 frames" in out) == (0, True, True)
    assert all(len(line) <= 80 for line in out.splitlines())


def test_any_cut_and_any_wrong_byte_gives_one_line(drive, tmp_path, capsys):
    whole, path = drive.read_bytes(), tmp_path / "broken.mcap"
    for k in range(60):
        at = 8 + k * (len(whole) - 9) // 60
        for content in (whole[:at], whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :]):
            path.write_bytes(content)
            code, _, said = info(capsys, path)
            assert (code, said.count("\n")) == (1, 1), at


def test_a_channel_without_a_schema_is_reported(tmp_path, capsys):
    with LogWriter(tmp_path / "a.mcap") as writer:
        writer.write(Message(Channel("/camera/front/image", "x"), 1, 1, 1, b"?"))
    code, out, _ = info(capsys, tmp_path / "a.mcap")
    assert (code, "found no schema (x), expected" in " ".join(out.split())) == (0, True)
