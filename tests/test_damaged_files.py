"""Loss reports are accurate: for the frame at a cut, and for the files after a damaged one."""

import polars as pl
import pytest
from mcap.reader import make_reader

from roadperc_stream import log
from roadperc_stream.api import replay
from roadperc_stream.cli.info import main as info_main
from roadperc_stream.config import load_config
from roadperc_stream.log import Channel, LogWriter, Message, Recovery
from roadperc_stream.output.tables import sidecar_path
from tests import logs
from tests.analytic import STEP_NS, Road
from tests.log.test_pipes import fed, with_input

OFF = ("odometry", "lanes", "objects", "occupancy")
CFG = load_config(None, [f"{stage}.enabled=false" for stage in OFF])
TINY = Road(width=64, height=48)
FRAMES = 6
SENSORS = {"depth", "segmentation", "detections"}


def beginning(path, share):
    """A log up to a share of its chunks' bytes."""
    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    start, last = chunks[0].chunk_start_offset, chunks[-1]
    end = last.chunk_start_offset + last.chunk_length + last.message_index_length
    return path.read_bytes()[: start + int(share * (end - start))]


def said(path):
    """For each frame, code and values of the reason for losses, and the missing sensors."""
    table = pl.read_parquet(sidecar_path(path, "metrics"))
    return [
        (next(((r["code"], *r["values"]) for r in reasons if r["source"] == "log"), ()), SENSORS & set(missing))
        for reasons, missing in table.select("reasons", "missing").iter_rows()
    ]


def recovered(source, name, *more):
    target = (source if not more else more[0]).with_name(f"{name}.mcap")
    summary = replay([source, *more] if more else source, target, config=CFG, recover=True, force=True)
    return target, summary


@pytest.fixture(params=[0, 3_000_000], ids=["at once", "one after the other"])
def recording(request, tmp_path, monkeypatch):
    """A log in many chunks; the messages of a frame arrive at the same time or one after the other."""
    monkeypatch.setattr("roadperc_stream.log.writing.CHUNK_SIZE_BYTES", 1000)
    path = tmp_path / "in.mcap"
    later = {"depth": 1, "segmentation": 2, "detections": 3}
    items = logs.items(FRAMES, TINY)
    with LogWriter(path) as writer:
        for item in items:
            writer.register(logs.channel(item.role))
        for item in items:
            log_time_ns = item.stamp_ns + later.get(item.role, 0) * request.param
            writer.write(Message(logs.channel(item.role), log_time_ns, item.stamp_ns, 0, item.data))
    return path


def test_a_frame_cut_by_damage_has_a_reason(recording):
    path, incomplete = recording.with_name("cut.mcap"), 0
    for share in (0.51, 0.57, 0.63, 0.66, 0.72):
        path.write_bytes(beginning(recording, share))
        target, summary = recovered(path, "out")
        saved = {(m.channel.topic, m.log_time_ns) for m in log.Salvage(path).messages()}
        written = {(m.channel.topic, m.log_time_ns) for m in log.read(log.summarise(recording))}
        (gap,) = Recovery.of_records(log.summarise(target).metadata).gaps
        assert gap.first_ns <= min(time_ns for _, time_ns in written - saved)
        assert gap.first_ns >= max(time_ns for _, time_ns in saved)
        frames = said(target)
        incomplete += any(lacking for _, lacking in frames)
        assert [bool(lacking) for _, lacking in frames[:-1]] == [False] * (len(frames) - 1)
        assert [reason for reason, _ in frames[:-1]] == [()] * (len(frames) - 1)
        reason, lacking = frames[-1]
        assert not lacking or reason == ("lost_to_damage_after", str(gap.first_ns))
        assert "others are lost" in " ".join(summary.warnings)
    assert incomplete >= 2


def test_the_messages_that_an_error_promises_are_saved(recording):
    path = recording.with_name("cut.mcap")
    path.write_bytes(beginning(recording, 0.6))
    with pytest.raises(log.DamagedLogError, match="all before 0") as caught:
        log.summarise(path)
    _, _, rest = caught.value.can_be_saved.partition("all before ")
    until_ns = logs.START_NS + round(1e9 * float(rest.split(" s")[0]))
    promised = [m for m in log.read(log.summarise(recording)) if m.log_time_ns < until_ns]
    saved = list(log.Salvage(path).messages())
    assert {(m.channel.topic, m.log_time_ns) for m in promised} <= {(m.channel.topic, m.log_time_ns) for m in saved}
    assert len(promised) > 5


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """A log in three files; the second one is cut."""
    monkeypatch.setattr("roadperc_stream.log.writing.CHUNK_SIZE_BYTES", 1000)
    items, files = logs.items(9, TINY), []
    for number in range(3):
        begin_ns = logs.START_NS + 3 * number * STEP_NS
        kept = [item for item in items if begin_ns <= item.stamp_ns < begin_ns + 3 * STEP_NS]
        files.append(logs.write(tmp_path / f"part_{number}.mcap", kept))
    files[1].write_bytes(beginning(files[1], 0.7))
    return files


def test_a_gap_ends_where_the_next_file_begins(parts):
    target, summary = recovered(parts[0], "out", *parts[1:])
    frames = said(target)
    third_ns = logs.START_NS + 6 * STEP_NS
    assert [reason for reason, _ in frames[:3]] == [()] * 3
    assert [reason for reason, _ in frames[-2:]] == [(), ()]
    code, _, last_ns = frames[-3][0]
    assert (code, last_ns) == ("lost_to_damage", str(third_ns))
    assert f"to 0.300 s ({third_ns} ns)" in " ".join(summary.warnings)
    (gap,) = Recovery.of_records(log.summarise(target).metadata).gaps
    assert gap.last_ns == third_ns


def test_a_repaired_file_among_others_gives_the_same_results(parts):
    expected, _ = recovered(parts[0], "out", *parts[1:])
    repaired = parts[1].with_name("repaired.mcap")
    log.write_repaired(parts[1], repaired)
    target, _ = recovered(parts[0], "from_repaired", repaired, parts[2])
    assert said(target) == said(expected)
    assert target.read_bytes() == expected.read_bytes()


def test_a_gap_stays_open_without_a_later_file_of_its_topics(tmp_path):
    other = Channel("/other", "x")
    with LogWriter(tmp_path / "other.mcap") as writer:
        for k in range(3):
            writer.write(Message(other, logs.START_NS + (6 + k) * STEP_NS, 0, 0, b"x"))
    path = logs.write(tmp_path / "a.mcap", logs.items(6, TINY))
    files = [log.summarise(file) for file in (path, tmp_path / "other.mcap")]
    assert log.gone_on_ns(files[0], files) is None
    assert log.gone_on_ns(files[1], files) is None


def test_info_repairs_a_pipe(tmp_path, monkeypatch):
    path = logs.write(tmp_path / "in.mcap", logs.items(3, TINY))
    content = path.read_bytes()[:-200]
    (tmp_path / "cut.mcap").write_bytes(content)
    log.write_repaired(tmp_path / "cut.mcap", tmp_path / "expected.mcap")
    expected = (tmp_path / "expected.mcap").read_bytes()
    pipe = fed(tmp_path / "standard input", content).open("rb")
    assert with_input(monkeypatch, pipe, info_main, "--recover", tmp_path / "input.mcap") == 0
    assert info_main([str(fed(tmp_path / "pipe", content)), "--recover", str(tmp_path / "piped.mcap")]) == 0
    assert (tmp_path / "input.mcap").read_bytes() == (tmp_path / "piped.mcap").read_bytes() == expected
