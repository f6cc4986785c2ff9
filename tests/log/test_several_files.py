"""Several files as one log: the results of the whole log for any cuts, and notes on gaps."""

import random
from collections import Counter
from dataclasses import replace
from functools import reduce
from operator import or_

import polars.selectors as cs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import roadperc_stream as rp
from roadperc_stream import log
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import LogError, TargetError
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.input.outcome import FileSpan, joins
from roadperc_stream.log import Attachment, Channel, Message, Metadata
from roadperc_stream.output.tables import read_footer
from roadperc_stream.system.time import TimeRange
from tests import logs
from tests.arranged import ARRANGEMENTS, arranged, by_us, parts, plain
from tests.logs import START_NS
from tests.replaying import replay
from tests.test_sample import SAMPLE

CFG = ReplayConfig()
WHOLE = log.summarise(SAMPLE)
MESSAGES = sum(WHOLE.counts.values())
A, B = Channel("/a", "x", "S", "s", b"d", (("k", "v"),)), Channel("/b", "x")
S = 1_000_000_000


def written(path, messages, **extra):
    found = [Message(channel, time, time, 0, f"{channel.topic} {time}".encode()) for channel, time in messages]
    return by_us(path, found, **extra)


@pytest.mark.parametrize("arrangement", [{}, ARRANGEMENTS["no chunks"]], ids=["indexed", "no index"])
@pytest.mark.parametrize("seed", [1, 2])
def test_files_of_the_sample_equal_the_sample(tmp_path, seed, arrangement):
    cuts = sorted(random.Random(seed).sample(range(1, MESSAGES), 4))
    files = parts(SAMPLE, tmp_path, cuts, **arrangement)
    random.Random(seed).shuffle(files)
    log_in, whole = open_input(ReplaySource(files), CFG), open_input(ReplaySource(SAMPLE), CFG)
    assert plain(log_in.messages.copied()) == plain(whole.messages.copied())
    assert (log_in.log_id, log_in.span_ns, log_in.topics) == (whole.log_id, whole.span_ns, whole.topics)


def test_files_give_the_results_of_the_whole_log(tmp_path):
    third = [m.log_time_ns for m in log.read(WHOLE, topics=["/camera/front/image"])][2]
    cut = next(k for k, m in enumerate(log.read(WHOLE)) if m.log_time_ns == third) + 1
    files, part = parts(SAMPLE, tmp_path, [cut]), TimeRange(start_s=0.05, frames=3)
    replay(SAMPLE, tmp_path / "whole.mcap", CFG, time_range=part)
    summary = replay(files, tmp_path / "out.mcap", CFG, time_range=part)
    assert (tmp_path / "out.mcap").read_bytes() == (tmp_path / "whole.mcap").read_bytes()
    tables = [rp.read_metrics(tmp_path / name).select(~cs.ends_with("_ms")) for name in ("out.mcap", "whole.mcap")]
    assert tables[0].equals(tables[1])
    facts = read_footer(tmp_path / "out.metrics.parquet").facts
    assert facts["source"] == f"{files[0]} and 1 more"
    assert summary.frames == 3


@settings(max_examples=50)
@given(st.lists(st.lists(st.tuples(st.sampled_from([A, B]), st.integers(0, 30)), max_size=12), min_size=2, max_size=5))
def test_files_are_read_in_log_time_order(tmp_path_factory, files):
    folder = tmp_path_factory.mktemp("parts")
    summary = log.summarise([written(folder / f"{k}.mcap", messages) for k, messages in enumerate(files)])
    counted = [Counter((time, channel.topic) for channel, time in messages) for messages in files]
    wanted = sorted(reduce(or_, counted).elements())  # of repeated messages, the largest number in one file
    read = [(m.log_time_ns, m.channel.topic) for m in log.read(summary)]
    assert [time for time, _ in read] == [time for time, _ in wanted]
    assert sorted(read) == wanted
    assert sum(summary.counts.values()) == len(wanted)
    assert {(c.topic, c.metadata) for c in summary.channels} == {(c.topic, c.metadata) for f in files for c, _ in f}
    assert len(summary.channels) == len({c.topic for f in files for c, _ in f})
    late = [(m.log_time_ns, m.channel.topic) for m in log.read(summary, topics=["/a"], start_ns=10, end_ns=20)]
    assert sorted(late) == [(time, topic) for time, topic in wanted if 10 <= time < 20 and topic == "/a"]


def test_equal_channels_are_joined_across_files_only(tmp_path):
    twins = Channel("/a", "x", source_id=1), Channel("/a", "x", source_id=2)
    one = written(tmp_path / "1.mcap", [(twins[0], 1), (twins[1], 2)])
    two = written(tmp_path / "2.mcap", [(twins[0], 3), (Channel("/a", "y"), 4), (twins[1], 5)])
    summary = log.summarise([one, two])
    assert [(c.topic, c.message_encoding) for c in summary.channels] == [("/a", "x"), ("/a", "x"), ("/a", "y")]
    assert [summary.counts[c.source_id] for c in summary.channels] == [2, 2, 1]
    assert {m.channel for m in log.read(summary)} == set(summary.channels)


def test_files_are_open_only_while_they_are_read(tmp_path, monkeypatch):
    files = [written(tmp_path / f"{k}.mcap", [(A, 10 * k + j) for j in range(9)]) for k in range(30)]
    summary, now, most = log.summarise(files), [0], [0]
    for part, _ in summary.source.files:

        def counted(*args, messages=part.source.messages, **options):
            now[0] += 1
            most[0] = max(most[0], now[0])
            yield from messages(*args, **options)
            now[0] -= 1

        monkeypatch.setattr(type(part.source), "messages", part.source.messages.__func__)
        object.__setattr__(part.source, "messages", counted)
    assert len(list(log.read(summary))) == 270
    assert most[0] <= 2


SHARED = [("/a", 1), ("/a", 2), ("/b", 2), ("/a", 2), ("/b", 3), ("/a", 4)]


@pytest.mark.parametrize("together", [2, 40])
def test_repeated_messages_come_once(tmp_path, together):
    """As often as in the file with the most of them, in the order of that file."""
    channels = {"/a": A, "/b": B}
    pieces = [SHARED[:4], SHARED[2:], SHARED] + [SHARED[1:3]] * (together - 2)
    files = [written(tmp_path / f"{k}.mcap", [(channels[t], ns) for t, ns in piece]) for k, piece in enumerate(pieces)]
    summary = log.summarise(files)
    assert [(m.channel.topic, m.log_time_ns) for m in log.read(summary)] == SHARED
    assert {c.topic: summary.counts[c.source_id] for c in summary.channels} == {"/a": 4, "/b": 2}
    assert sum(part.repeats for part in summary.files) == sum(map(len, pieces)) - len(SHARED)
    assert [m.log_time_ns for m in log.read(summary, topics=["/a"], start_ns=2, end_ns=4)] == [2, 2]


@pytest.mark.parametrize("changed", [{"publish_time_ns": 4}, {"sequence": 1}, {"data": b"y"}, {"channel": B}])
def test_messages_that_differ_are_all_kept(tmp_path, changed):
    message = Message(A, 5, 5, 0, b"x")
    for name, one in (("1", message), ("2", replace(message, **changed))):
        by_us(tmp_path / f"{name}.mcap", [one])
    summary = log.summarise([tmp_path / "1.mcap", tmp_path / "2.mcap"])
    assert len(list(log.read(summary))) == 2
    assert [part.repeats for part in summary.files] == [0, 0]


@pytest.mark.parametrize("arrangement", [{}, ARRANGEMENTS["no index"]], ids=["indexed", "no index"])
def test_files_with_repeated_messages_equal_the_whole_log(tmp_path, arrangement):
    messages = list(log.read(WHOLE))
    early, late = messages[: MESSAGES * 6 // 10], messages[MESSAGES * 4 // 10 :]
    files = [
        arranged(SAMPLE, tmp_path / f"{k}.mcap", some, **arrangement) for k, some in enumerate((early, late, messages))
    ]
    whole = open_input(ReplaySource(SAMPLE), CFG)
    for some in ([files[0], files[1]], [SAMPLE, files[2]]):
        log_in = open_input(ReplaySource(some), CFG)
        assert plain(log_in.messages.copied()) == plain(whole.messages.copied())
        assert (log_in.log_id, log_in.expected_frames) == (whole.log_id, whole.expected_frames)
    shared = len(early) + len(late) - MESSAGES
    notes = open_input(ReplaySource(files[:2]), CFG).notes
    assert any(f"{shared} of its messages are also in earlier files and count once" in note for note in notes)


def test_attachments_and_metadata_are_united(tmp_path):
    same, mine, yours = Attachment("a", "t", b"1", 1), Attachment("b", "t", b"2"), Attachment("b", "t", b"3")
    one = written(tmp_path / "1.mcap", [(A, 1)], attachments=[same, mine], metadata=[Metadata("m", (("k", "v"),))])
    again = Attachment("a", "t", b"1", 9)
    two = written(tmp_path / "2.mcap", [(A, 2)], attachments=[again, yours], metadata=[Metadata("m", (("k", "v"),))])
    summary = log.summarise([one, two])
    assert summary.attachments == (same, mine, yours)
    assert summary.metadata == (Metadata("m", (("k", "v"),)),)


def test_gaps_and_overlaps_are_reported():
    spans = [
        FileSpan(name, a * S, b * S, 11) for name, a, b in [("a", 0, 10), ("b", 11, 20), ("c", 15, 18), ("d", 23, 33)]
    ]
    assert list(joins(spans)) == ["c: overlaps b by 3.000 s", "d: begins 3.000 s after b ends"]
    assert not list(joins([FileSpan("a", 0, 1, 1), FileSpan("b", 1, 2, 0)]))


def test_a_replay_reports_gaps_between_files(tmp_path, capsys):
    items = logs.items(8)
    edge = logs.START_NS + 3 * logs.STEP_NS
    early = logs.write(tmp_path / "1.mcap", [item for item in items if item.stamp_ns < edge])
    late = logs.write(tmp_path / "2.mcap", [item for item in items if item.stamp_ns > edge + 2 * logs.STEP_NS])
    out = tmp_path / "out.mcap"
    assert replay_main([str(late), "--only", "surface", str(early), str(out)]) == 0
    assert f"note: {late}: begins 0.200 s after {early} ends\n" in capsys.readouterr().out
    assert [frame.input.stamp_ns for frame in rp.frames([early, late])] == [
        START_NS + k * logs.STEP_NS for k in (0, 1, 2, 6, 7)
    ]


def test_calibration_and_transforms_of_the_first_file_hold_in_the_others(tmp_path):
    once = parts(SAMPLE, tmp_path, [MESSAGES // 2])
    assert not list(log.read(log.summarise(once[1]), topics=["/tf", "/camera/front/calibration"]))
    frames = open_input(ReplaySource(once, time_range=TimeRange(start_s=1.5, frames=1)), CFG).samples()
    assert next(iter(frames)).frame.mounted


def test_a_file_given_twice_is_an_error(tmp_path):
    (tmp_path / "link.mcap").symlink_to(SAMPLE.absolute())
    for again in (SAMPLE, tmp_path / "link.mcap"):
        with pytest.raises(LogError, match="is given twice"):
            open_input(ReplaySource([SAMPLE, again]), CFG)
    with pytest.raises(LogError, match="no log is given"):
        rp.replay([], tmp_path / "out.mcap")


@pytest.mark.parametrize("number", [2, 3])
@pytest.mark.parametrize("force", [[], ["--force"]])
def test_a_forgotten_output_overwrites_no_input(tmp_path, number, force, capsys):
    files = [logs.write(tmp_path / f"part_{k}.mcap", logs.items(2)) for k in range(number)]
    last = files[-1].read_bytes()
    assert replay_main([*map(str, files), *force]) == 1
    assert f"refusing to overwrite {files[-1]}: it was not written by roadperc-replay" in capsys.readouterr().err
    assert files[-1].read_bytes() == last


def test_several_inputs_replace_only_a_result(tmp_path):
    files = parts(SAMPLE, tmp_path, [MESSAGES // 2])
    out, part = tmp_path / "out.mcap", TimeRange(frames=1)
    replay(files, out, CFG, time_range=part)
    with pytest.raises(TargetError, match="exists; pass --force"):
        replay(files, out, CFG, time_range=part)
    replay(files, out, CFG, time_range=part, force=True)
    out.write_bytes(b"something of value")
    with pytest.raises(TargetError, match="was not written by roadperc-replay"):
        replay(files, out, CFG, time_range=part, force=True)
    with pytest.raises(TargetError, match="is the input; name another output"):
        replay(files, files[0], CFG, force=True)
    assert out.read_bytes() == b"something of value"
