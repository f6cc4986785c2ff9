"""Notes of a replay on its input: segments, repeated frames, gaps between parts, messages of no frame."""

from dataclasses import replace

import pytest

from roadperc_stream.cli.replay import main
from roadperc_stream.config import SyncConfig, load_config
from roadperc_stream.input.order import OrderConfig
from roadperc_stream.input.outcome import InputOutcome
from roadperc_stream.input.sync import StampPairing
from roadperc_stream.input.transforms import LatchedState
from tests import logs
from tests.analytic import STEP_NS
from tests.input.test_sync import MS, item
from tests.replaying import replay
from tests.resume.parts import inputs, results, rows, write

CFG = load_config(None, ("sync.max_wait_s=0.2",))
ROAD = replace(logs.SMALL, width=96, height=72)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return inputs(logs.write(tmp_path_factory.mktemp("drive") / "in.mcap", logs.items(12, road=ROAD)))


def at(frame):
    return logs.START_NS + frame * STEP_NS


def between(messages, first, end):
    """The messages of some frames; without the first frame also without calibration and transforms."""
    return [m for m in messages if at(first) <= m.log_time_ns < at(end)]


def notes_of(outcome, nearest_ns=None):
    topics = {"image": "/image", "depth": "/depth", "lidar": "/lidar", "segmentation": "/tags"}
    return list(outcome.notes(topics, CFG.sync, nearest_ns or {}))


def synced(segment, stamp_ms, *others):
    reference = replace(item("image", stamp_ms), segment=segment)
    return {"image": reference} | dict.fromkeys(others, reference)


def test_new_segments_are_listed_with_stamps_and_frames():
    outcome = InputOutcome()
    for segment, stamp_ms in [(0, 5), (0, 55), (1, 7), (2, 3), (2, 53)]:
        outcome.add(synced(segment, stamp_ms), segment)
    assert notes_of(outcome) == [
        "3 segments, the state is reset in each: 0 from stamp 5000000 ns, 2 frames; "
        "1 from stamp 7000000 ns, 1 frames; 2 from stamp 3000000 ns, 2 frames"
    ]


@pytest.mark.parametrize(("begun", "said"), [(1, 0), (0, 1)])
def test_a_continued_segment_is_not_new(begun, said):
    outcome = InputOutcome(begun)
    outcome.add(synced(1, 5), 1)
    assert len(notes_of(outcome)) == said


def test_messages_in_no_frame_give_one_note():
    outcome = InputOutcome()
    for role, stamp_ms in [("depth", 3), ("lidar", 4), ("lidar", 54)]:
        outcome.drop(item(role, stamp_ms))
    assert notes_of(outcome) == [
        "messages that belong to no frame: 1 on /depth, stamp 3000000 ns; 2 on /lidar, the first with stamp 4000000 ns"
    ]


def test_the_note_on_a_sensor_in_no_frame_names_the_setting():
    outcome = InputOutcome()
    outcome.add(synced(0, 5, "lidar"), 0, is_written=False)
    for role in ("depth", "lidar"):
        outcome.drop(item(role, 3))
    _, note = notes_of(outcome, {"depth": 12 * MS, "lidar": 11 * MS})
    assert note == "/depth: in no frame; the nearest message is 0.012 s from one, sync.tolerance_s is 0.01"


@pytest.mark.parametrize(
    ("stamps_ms", "nearest_ms"), [([12], 12), ([38], 12), ([-15], 15), ([70], 20), ([25, 38], 12), ([3], None)]
)
def test_the_distance_to_the_nearest_frame_is_found_on_either_side(stamps_ms, nearest_ms):
    """Of depth images before, between and behind two frames; of one that a frame has there is none."""
    order = OrderConfig("image", 1000 * MS)
    pairing = StampPairing(SyncConfig(tolerance_s=0.01), order, ("image", "depth"), LatchedState(), lambda _: None)
    items = [item("image", 0), item("image", 50), *(item("depth", t) for t in stamps_ms)]
    assert len(list(pairing.frames_of(sorted(items, key=lambda i: i.log_time_ns)))) == 2
    assert pairing.nearest_ns == ({} if nearest_ms is None else {"depth": nearest_ms * MS})


def test_a_gap_after_the_continued_result_is_reported(drive, tmp_path):
    first = write(tmp_path / "0.mcap", between(drive, 0, 4))
    replay(first, tmp_path / "out_0.mcap", CFG)
    for begins, noted in ((4, False), (5, True)):
        part = write(tmp_path / f"from_{begins}.mcap", between(drive, begins, 12))
        notes = replay(part, tmp_path / f"out_{begins}.mcap", CFG, continued=tmp_path / "out_0.mcap").notes
        assert (f"{part}: begins 0.100 s after the continued result ends" in notes) == noted
        assert f"4 of {16 - begins} frames are also in the continued result" in notes


def test_the_error_on_an_overlap_names_a_start_that_works(drive, tmp_path, capsys):
    """The results are then those of parts that do not overlap."""
    write(tmp_path / "0.mcap", between(drive, 0, 6))
    write(tmp_path / "whole.mcap", drive)
    options = ["--set", "sync.max_wait_s=0.2"]
    before, after = tmp_path / "out_0.mcap", tmp_path / "out_1.mcap"
    assert main([str(tmp_path / "0.mcap"), str(before), *options]) == 0
    capsys.readouterr()
    command = [str(tmp_path / "whole.mcap"), str(after), "--continue", str(before), *options]
    assert main(command) == 1
    said = capsys.readouterr().err
    assert "expected later messages; pass --start 0.250000001 to skip the overlap" in said
    assert main([*command, "--start", "0.250000001"]) == 0
    replay(tmp_path / "whole.mcap", tmp_path / "out.mcap", CFG)
    assert results([before, after]) == results([tmp_path / "out.mcap"])
    assert rows([before, after], "metrics").equals(rows([tmp_path / "out.mcap"], "metrics"))


def test_a_missing_calibration_names_the_next_step(drive, tmp_path, capsys):
    part = write(tmp_path / "1.mcap", between(drive, 4, 8))
    assert main([str(part), str(tmp_path / "out.mcap")]) == 1
    said = capsys.readouterr().err
    assert "or --topic calibration=/TOPIC; if an earlier file of the log has it, pass that file too" in said
    assert "or --continue with its result" in said
    assert said.endswith("; pass --fov DEGREES or --calibration FILE for a log without one\n")
