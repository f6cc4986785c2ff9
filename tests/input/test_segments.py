"""Replays of logs with equal stamps, and with clocks that jump: what is left out, and where a new segment begins."""

from dataclasses import replace

import pytest

from roadperc_stream.cli.check import main as check
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.config import load_config
from roadperc_stream.errors import LogError
from roadperc_stream.info.examine import examine
from roadperc_stream.model.reason import TEMPLATES
from roadperc_stream.output.tables import sidecar_path, totals
from roadperc_stream.system.time import TimeRange
from tests import logs
from tests.analytic import STEP_NS
from tests.replaying import replay
from tests.resume import parts
from tests.resume.parts import cut, replayed, write

CFG = load_config(None, ("sync.max_wait_s=0.2",))
ROAD = replace(logs.SMALL, width=96, height=72)
FRAMES, MS, HOUR_NS = 12, 1_000_000, 3_600_000_000_000
IMAGE = "/camera/front/image"
LATCHED = ("/camera/front/calibration", "/tf")


def messages_of(items):
    return [logs.message(item, number) for number, item in enumerate(items)]


@pytest.fixture(scope="module")
def drive():
    return messages_of(logs.items(FRAMES, road=ROAD))


@pytest.fixture(scope="module")
def tidy(drive, tmp_path_factory):
    return rows(replayed(tmp_path_factory.mktemp("tidy"), [drive], CFG))


def rows(paths):
    return parts.rows(paths, "metrics")


def copies(messages, later_ns, *topics, times=1):
    """The messages, and copies of those on some topics (without topics: of all) that arrive later."""
    again = [m for m in messages if m.channel.topic in topics or not topics]
    return [
        *messages,
        *(replace(m, log_time_ns=m.log_time_ns + later_ns * (k + 1)) for m in again for k in range(times)),
    ]


def image_of(frame):
    return lambda m: m.channel.topic == IMAGE and m.publish_time_ns == logs.START_NS + frame * STEP_NS


TWICE = {
    "one image twice": lambda drive: [
        *drive,
        *(replace(m, log_time_ns=m.log_time_ns + 1) for m in filter(image_of(5), drive)),
    ],
    "two recorders of the camera": lambda drive: copies(drive, 3 * MS, IMAGE),
    "two recorders of everything": lambda drive: copies(drive, 3 * MS),
    "a recorder that is three frames late": lambda drive: copies(drive, 3 * STEP_NS + 1, IMAGE),
    "four copies": lambda drive: copies(drive, 2 * MS, IMAGE, times=4),
}


@pytest.mark.parametrize("case", TWICE)
def test_images_with_the_stamp_of_an_earlier_one_are_left_out(case, drive, tidy, tmp_path):
    messages = TWICE[case](drive)
    summary = replay(write(tmp_path / "in.mcap", messages), tmp_path / "out.mcap", CFG)
    assert rows([tmp_path / "out.mcap"]).equals(tidy)
    assert summary.dropped["image"] == sum(m.channel.topic == IMAGE for m in messages) - FRAMES
    assert any(f"{IMAGE}: message with stamp" in note and "same stamp" in note for note in summary.notes)
    facts = examine(tmp_path / "in.mcap", {}).replay
    assert (facts.frames, facts.segments, facts.unused["image"]) == (FRAMES, 1, summary.dropped["image"])


def test_the_expected_frames_and_the_frames_asked_for_are_without_copies(drive, tmp_path):
    source, done = write(tmp_path / "in.mcap", copies(drive, 3 * MS, IMAGE)), []
    replay(source, tmp_path / "out.mcap", CFG, progress=lambda *numbers: done.append(numbers))
    assert done[-1] == (FRAMES, FRAMES)
    assert replay(source, tmp_path / "few.mcap", CFG, time_range=TimeRange(frames=5)).frames == 5


def test_a_strict_replay_stops_at_a_copy(drive, tmp_path):
    source = write(tmp_path / "in.mcap", copies(drive, MS, IMAGE))
    with pytest.raises(LogError, match=f"{IMAGE}: message with stamp {logs.START_NS} ns .*same stamp.*--strict"):
        replay(source, tmp_path / "out.mcap", CFG, strict=True)


@pytest.mark.parametrize("case", ["two recorders of everything", "a recorder that is three frames late"])
def test_copies_in_the_next_part_are_left_out(case, drive, tidy, tmp_path):
    """The cuts are between images and their copies."""
    messages = TWICE[case](drive)
    ends = [logs.START_NS + k * STEP_NS + 2 * MS for k in (3, 7, 8)]
    assert rows(replayed(tmp_path, cut(messages, ends), CFG)).equals(tidy)


def test_copies_do_not_change_a_warm_up_or_a_start(drive, tmp_path):
    both = {}
    for name, messages in (("once", drive), ("twice", copies(drive, MS, IMAGE))):
        source, target = write(tmp_path / f"{name}.mcap", messages), tmp_path / f"{name}.out.mcap"
        replay(source, target, CFG, time_range=TimeRange(start_s=0.2), warm_up_s=0.1)
        both[name] = rows([target])
    assert both["twice"].equals(both["once"])


def drive_of(*stretches):
    """A drive of several stretches, each with the stamp of its first frame and its number of frames."""
    made = messages_of(logs.items(1, road=ROAD))[: len(LATCHED)]
    for start_ns, frames in stretches:
        for k in range(frames):
            stamp_ns = start_ns + k * STEP_NS
            made += messages_of(logs.frame_items(stamp_ns, logs.shifted(ROAD, len(made))))
    return made


def in_order(messages):
    """The messages with ascending log times, as a recorder with its own clock writes them."""
    return [replace(m, log_time_ns=logs.START_NS + k * 10 * MS) for k, m in enumerate(messages)]


AHEAD = {
    "the first frame before the clock is set": [(1, 1), (logs.START_NS, 8)],
    "simulated time, then wall time": [(0, 4), (logs.START_NS, 5)],
    "two hours": [(logs.START_NS, 4), (logs.START_NS + 2 * HOUR_NS, 5)],
}


@pytest.mark.parametrize("case", AHEAD)
def test_durations_and_rates_are_sums_over_segments(case, tmp_path, capsys):
    (_, before), (later_ns, after) = AHEAD[case]
    target = tmp_path / "out.mcap"
    assert replay_main([str(write(tmp_path / "in.mcap", drive_of(*AHEAD[case]))), str(target)]) == 0
    assert f"1 from stamp {later_ns} ns, {after} frames" in capsys.readouterr().out
    found = rows([target])
    assert found["segment"].to_list() == [0] * before + [1] * after
    assert found["odometry_status"][before] == "first"
    seconds = (before - 1 + after - 1) * STEP_NS / 1e9
    assert totals(sidecar_path(target, "metrics"), ()).span_ns == seconds * 1e9
    assert examine(tmp_path / "in.mcap", {}).span_s < 1
    rate = 'name = "frames"\nstatistic = "rate"\nevent = "frame % 4 = 1"\nmost = 10'
    (tmp_path / "rate.toml").write_text(f"[[criterion]]\n{rate}\n")
    assert check([str(target), "--criteria", str(tmp_path / "rate.toml")]) == 1


def test_early_latched_messages_begin_no_segment(drive, tidy, tmp_path):
    early = [replace(m, log_time_ns=0) if m.channel.topic in LATCHED else m for m in drive]
    assert rows(replayed(tmp_path, [early], CFG)).equals(tidy)
    assert examine(tmp_path / "in_0.mcap", {}).span_s == pytest.approx((FRAMES - 1) * STEP_NS / 1e9)


CLOCKS = {
    "steady": [(logs.START_NS, 9)],
    "copies": [(logs.START_NS, 5), (logs.START_NS + 4 * STEP_NS, 1), (logs.START_NS + 5 * STEP_NS, 3)],
    "played twice": [(logs.START_NS, 10), (logs.START_NS, 5)],
    "set back": [(logs.START_NS, 5), (logs.START_NS - HOUR_NS, 4)],
    "set ahead": [(logs.START_NS, 5), (logs.START_NS + HOUR_NS, 4)],
    "a single stamp ahead": [(logs.START_NS, 4), (logs.START_NS + 9 * HOUR_NS, 1), (logs.START_NS + 4 * STEP_NS, 4)],
    "a single stamp back": [(logs.START_NS, 4), (1, 1), (logs.START_NS + 4 * STEP_NS, 4)],
    "back and ahead": [(logs.START_NS, 4), (1, 4), (logs.START_NS, 4)],
}


def test_a_state_is_cleared_if_and_only_if_a_segment_begins(tmp_path):
    cleared = {f"time.{code}" for code, text in TEMPLATES.items() if "state of all stages cleared" in text}
    seen = set()
    for name, stretches in CLOCKS.items():
        target = tmp_path / f"{name}.out.mcap"
        replay(write(tmp_path / f"{name}.mcap", in_order(drive_of(*stretches))), target, CFG)
        found = rows([target])
        begins = [later != earlier for earlier, later in zip([0, *found["segment"]], found["segment"], strict=False)]
        reasons = [[code for code in row if code.startswith("time.")] for row in found["reason_codes"]]
        assert [bool(row) for row in reasons] == begins, name
        starts = [number for number, status in enumerate(found["odometry_status"]) if status == "first"]
        assert starts == [0, *(number for number, begin in enumerate(begins) if begin)], name
        seen |= {code for row in reasons for code in row}
    assert seen == cleared


def test_the_state_of_a_part_knows_the_segments(tmp_path):
    messages = in_order(drive_of(*CLOCKS["back and ahead"]))
    (tmp_path / "whole").mkdir()
    whole = replayed(tmp_path / "whole", [messages], CFG)
    for number in (14, 19, 24):
        folder = tmp_path / str(number)
        folder.mkdir()
        found = replayed(folder, cut(messages, [messages[number].log_time_ns]), CFG)
        assert rows(found).equals(rows(whole)), number
    assert rows(whole)["segment"].to_list() == [0] * 4 + [1] * 4 + [2] * 4
