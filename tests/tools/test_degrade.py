"""``roadperc-degrade`` on small logs: what changes, what stays, and when messages arrive."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli import replay
from roadperc_stream.cli.degrade import main
from roadperc_stream.geometry.rotations import rotation_angle
from roadperc_stream.input.roles import assignment_of_log
from roadperc_stream.input.stream import decoded_messages
from roadperc_stream.tools.corruptions.levels import LEVELS
from tests import logs
from tests.analytic import STEP_NS

DEPTH, TAGS, IMAGE = (f"/camera/front/{name}" for name in ("depth", "segmentation", "image"))
DETECTIONS = "/camera/front/detections"


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """Ten frames, with a message of an unknown channel."""
    extra = replace(logs.foreign(), log_time_ns=logs.START_NS)
    return logs.write(tmp_path_factory.mktemp("clean") / "in.mcap", logs.items(frames=10), [extra])


def degrade(source, out, corruptions, seed=1, *options):
    assert main([str(source), str(out), "--with", corruptions, "--seed", str(seed), "--quiet", *options]) == 0
    return out


def messages(path):
    """Every message by topic, in log-time order."""
    found = {}
    for item in log.read(log.summarise(path)):
        found.setdefault(item.channel.topic, []).append(item)
    return found


def payloads(path, role):
    summary = log.summarise(path)
    roles = assignment_of_log(summary, {})
    return [item.payload for item in decoded_messages(log.read(summary), roles) if item.role == role]


def test_severity_0_copies_every_byte(clean, tmp_path):
    copy = degrade(clean, tmp_path / "out.mcap", "fog=0,frame_drop=0")
    assert copy.read_bytes() == clean.read_bytes()


@pytest.mark.parametrize("name", LEVELS)
def test_every_corruption_changes_the_log_the_same_way_each_time(clean, tmp_path, name):
    first, again = (degrade(clean, tmp_path / out, f"{name}=5") for out in ("a.mcap", "b.mcap"))
    assert first.read_bytes() == again.read_bytes()
    before, after = messages(clean), messages(first)
    assert after["/rosout"] == before["/rosout"]
    changed = {topic for topic in before if after.get(topic) != before[topic]}
    assert changed
    assert DEPTH not in changed or after["/truth/depth"][0].data == before[DEPTH][0].data
    assert TAGS not in changed or [m.data for m in after["/truth/segmentation"]] == [m.data for m in before[TAGS]]


def test_the_record_names_severities_and_seed_and_another_seed_gives_other_bytes(clean, tmp_path):
    first = degrade(clean, tmp_path / "a.mcap", "depth_noise=1,frame_drop=0")
    second = degrade(first, tmp_path / "b.mcap", "messages_lost=1", 7)
    records = [dict(r.values) for r in log.summarise(second).metadata if r.name == "roadperc_degrade"]
    assert [(r.get("depth_noise"), r.get("messages_lost"), r["seed"]) for r in records] == [
        ("1", None, "1"),
        (None, "1", "7"),
    ]
    other = degrade(clean, tmp_path / "c.mcap", "depth_noise=1", 2)
    assert messages(first)[DEPTH] != messages(other)[DEPTH]
    assert messages(first)[IMAGE] == messages(other)[IMAGE]


def test_dropped_frames_lose_all_sensors(clean, tmp_path):
    after = messages(degrade(clean, tmp_path / "out.mcap", "frame_drop=5"))
    stamps = [{m.log_time_ns for m in after[topic]} for topic in (IMAGE, DEPTH, TAGS, DETECTIONS)]
    assert stamps[0] == stamps[1] == stamps[2] == stamps[3]
    assert 1 < len(stamps[0]) < 9
    assert len(after["/truth/depth"]) == 10


def test_messages_are_late_lost_twice_and_out_of_order(clean, tmp_path):
    def degraded(corruption):
        out = degrade(clean, tmp_path / f"{corruption}.mcap", corruption)
        times = [m.log_time_ns for m in log.Salvage(out).messages()]
        assert times == sorted(times)
        return messages(out)

    before, late = messages(clean), degraded("messages_late=3")
    assert {m.log_time_ns - m.publish_time_ns for topic in (IMAGE, DEPTH) for m in late[topic]} == {0, 200_000_000}
    assert sorted(m.data for m in late[DEPTH]) == sorted(m.data for m in before[DEPTH])
    twice = degraded("messages_twice=5")[IMAGE]
    assert 11 < len(twice) < 19
    assert len({m.sequence for m in twice}) == 10
    assert 1 < len(degraded("messages_lost=5")[IMAGE]) < 10
    mixed = degraded("messages_out_of_order=3")[IMAGE]
    assert [m.sequence for m in mixed] != sorted(m.sequence for m in mixed)
    assert max(m.log_time_ns - m.publish_time_ns for m in mixed) <= 8 * STEP_NS


def test_depth_holes_are_unknown_and_other_pixels_stay(clean, tmp_path):
    out = degrade(clean, tmp_path / "o.mcap", "depth_holes=3")
    before, after = (payloads(path, "depth")[0].depth_m for path in (clean, out))
    holes, known = np.isnan(after) & ~np.isnan(before), ~np.isnan(after)
    assert 0.05 < holes.mean() < 0.3  # the sky is unknown before
    assert np.array_equal(before[known], after[known])


def test_the_calibration_is_turned_by_the_angle(clean, tmp_path):
    out = degrade(clean, tmp_path / "o.mcap", "calibration_turned=4")
    ((before,),), ((after,),) = (payloads(path, "tf") for path in (clean, out))
    turn = before.parent_T_child[:3, :3].T @ after.parent_T_child[:3, :3]
    assert np.degrees(rotation_angle(turn)) == pytest.approx(2)
    assert np.array_equal(before.parent_T_child[:3, 3], after.parent_T_child[:3, 3])


def test_detections_are_missed_and_false(clean, tmp_path):
    """There are two in each of ten frames."""
    missed = payloads(degrade(clean, tmp_path / "m.mcap", "detections_missed=5"), "detections")
    false = payloads(degrade(clean, tmp_path / "f.mcap", "detections_false=3"), "detections")
    assert 1 < sum(map(len, missed)) < 14
    assert 40 < sum(map(len, false)) < 80


def test_a_crashed_camera_sends_black_images_and_no_tags(clean, tmp_path):
    out = degrade(clean, tmp_path / "out.mcap", "camera_crash=5")
    before, after = messages(clean), messages(out)
    images = zip(after[IMAGE], payloads(out, "image"), strict=True)
    black = [m.log_time_ns for m, image in images if not image.bgr.any()]
    assert 4 <= len(black) <= 6
    kept = {m.log_time_ns for m in after[TAGS]}
    assert kept == {m.log_time_ns for m in before[TAGS]} - set(black)
    assert [m for m in after[IMAGE] if m.log_time_ns in kept] == [m for m in before[IMAGE] if m.log_time_ns in kept]
    assert after[DEPTH] == before[DEPTH]


def test_a_result_is_degraded_without_its_results_and_replays(clean, tmp_path):
    run = [str(clean), str(tmp_path / "run.mcap"), "--quiet"]
    assert replay.main(run) == 0
    out = degrade(tmp_path / "run.mcap", tmp_path / "out.mcap", "depth_noise=2")
    assert not [topic for topic in messages(out) if topic.startswith("/perception")]
    assert replay.main([str(out), str(tmp_path / "again.mcap"), "--quiet"]) == 0
    heights = [pl.read_parquet(tmp_path / f"{name}.metrics.parquet")["camera_height_m"] for name in ("run", "again")]
    assert 0 < (heights[0] - heights[1]).abs().max() < 0.1


def test_wrong_input_is_one_line(tmp_path, capsys):
    only_image = logs.write(tmp_path / "image.mcap", logs.items(2, roles=("calibration", "image")))
    assert main([str(only_image), str(tmp_path / "o.mcap"), "--with", "depth_noise=1"]) == 1
    assert capsys.readouterr().err == f"error: {only_image}: depth_noise changes nothing: no channel of depth\n"
    for wrong in ("foggy=1", "fog=6", "fog", "fog=1,fog=2", "snow=3"):
        with pytest.raises(SystemExit):
            main([str(only_image), str(tmp_path / "o.mcap"), "--with", wrong])
    error = capsys.readouterr().err
    assert "did you mean fog?" in error
    assert "no corruption 'snow'; known: gaussian_noise, " in error


def test_the_command_says_what_it_wrote(clean, tmp_path, capsys):
    assert main([str(clean), str(tmp_path / "o.mcap"), "--with", "fog=2"]) == 0
    line = capsys.readouterr().out
    assert "fog=2" in line
    assert str(tmp_path / "o.mcap") in line
