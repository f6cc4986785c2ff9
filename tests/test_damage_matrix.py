"""A replay recovers the same messages as a repair and loses none silently, with any CRCs."""

from dataclasses import replace as changed
from functools import cache
from random import Random

import polars as pl
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from roadperc_stream import log
from roadperc_stream.api import replay
from roadperc_stream.config import load_config
from roadperc_stream.errors import LogError
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.log import Recovery
from roadperc_stream.output.tables import sidecar_path
from tests import logs
from tests.analytic import STEP_NS, Road
from tests.log.flips import flipped

OFF = ("odometry", "lanes", "objects", "occupancy")
CFG = load_config(None, [f"{stage}.enabled=false" for stage in OFF])
FRAMES, STRUCK = 6, 3
"""Number of frames, and the damaged one."""
BEFORE_S = 0.07
UNCHUNKED = {"use_chunking": False}
CHUNKED = {
    "default": {},
    "lz4": {"compression": CompressionType.LZ4},
    "not compressed": {"compression": CompressionType.NONE},
    "data CRC too": {"enable_data_crcs": True},
    "data CRC alone": {"enable_crcs": False, "enable_data_crcs": True},
    "no CRCs": {"enable_crcs": False, "compression": CompressionType.NONE},
}
WRITERS = CHUNKED | {"no chunks": UNCHUNKED, "no chunks, data CRC": UNCHUNKED | {"enable_data_crcs": True}}
DAMAGES = ("data", "chunk head", "message index", "summary", "cut")
OF_ALL = ("data", "summary", "cut")
"""Damages of a log without chunks."""
CASES = [(writer, damage) for writer in WRITERS for damage in (DAMAGES if writer in CHUNKED else OF_ALL)]
UNSEEN = {("no CRCs", "data"), ("no chunks", "data")}
"""A byte in a message without a CRC."""
WITHOUT_PLACE = {
    ("no chunks, data CRC", "data"),
    *(("data CRC alone", damage) for damage in ("data", "chunk head", "message index")),
}
"""Damages that a CRC shows without their place."""
LOSING = {("data", writer) for writer in ("default", "lz4", "not compressed", "data CRC too")}
"""Damages that lose messages."""


@cache
def drive():
    """Messages of a drive; before the last message of each frame comes one without a role."""
    random, found = Random(0), []
    for item in logs.items(FRAMES, Road(width=64, height=48)):
        if item.role == "detections":
            found.append(changed(item, role="noise", data=random.randbytes(4000)))
        found.append(item)
    return found


def written(path, **options):
    """The drive written by the mcap library, about one frame per chunk."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=8_000, **options)
        writer.start()
        numbers = {"noise": writer.register_channel("/noise", "x", 0)}
        for item in drive():
            if item.role not in numbers:
                channel = logs.channel(item.role)
                schema = writer.register_schema(channel.schema_name, channel.schema_encoding, channel.schema_data)
                labels = dict(channel.metadata)
                numbers[item.role] = writer.register_channel(channel.topic, channel.message_encoding, schema, labels)
            writer.add_message(numbers[item.role], item.stamp_ns, item.data, item.stamp_ns)
        writer.finish()
    return path


def damaged(path, writer, damage):
    """A log, and the same log with damage in a middle frame."""
    whole = written(path.with_name("whole.mcap"), **WRITERS[writer])
    content, stamp = whole.read_bytes(), logs.START_NS + STRUCK * STEP_NS
    with whole.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    if summary.chunk_indexes:
        chunk = next(c for c in summary.chunk_indexes if c.message_start_time <= stamp <= c.message_end_time)
        start, end = chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length
    else:
        noise = next(item for item in drive() if item.role == "noise" and item.stamp_ns == stamp)
        start = content.index(noise.data)
        end = start + len(noise.data)
    if damage == "cut":
        path.write_bytes(content[: end - 1000])
        return whole, path
    at = {
        "data": end - 1000,
        "chunk head": start + 9 + 1,  # the first log time
        "message index": end + 9 + 2 + 4 + 1,  # the first one there
        "summary": content.rindex(b"/noise"),
    }
    path.write_bytes(flipped(content, 8 * at[damage]))
    return whole, path


def messages(path):
    found = log.read(log.summarise(path))
    return [plain(m) for m in found if not is_result(m.channel)]


def plain(message):
    return message.channel.topic, message.log_time_ns, message.data


def rows(path):
    return pl.read_parquet(sidecar_path(path, "metrics"))


def run(source, name, **options):
    target = source.with_name(f"{name}.mcap")
    return target, replay(source, target, config=CFG, **options)


@pytest.mark.parametrize(("writer", "damage"), CASES)
def test_replay_and_repair_recover_the_same(tmp_path, tidy, writer, damage):
    whole, path = damaged(tmp_path / "a.mcap", writer, damage)
    repaired = tmp_path / "repaired.mcap"
    salvage, recovery = log.write_repaired(path, repaired)
    assert salvage.whole == ((writer, damage) in UNSEEN)
    target, summary = run(path, "out", recover=True)
    assert messages(target) == messages(repaired)
    assert bool(summary.warnings) != salvage.whole
    lost = {m[:2] for m in messages(whole)} - {m[:2] for m in messages(repaired)}
    assert bool(lost) == (damage == "cut" or (damage, writer) in LOSING)
    for _, time_ns in lost:
        assert any((g.first_ns or 0) <= time_ns <= (g.last_ns or 2**64) for g in recovery.gaps)
    assert_incomplete_frames_say_so(rows(target), tidy[0])
    assert Recovery.of_records(log.summarise(target).metadata) == (None if salvage.whole else recovery)


@pytest.fixture(scope="module")
def tidy(tmp_path_factory):
    """The table of the whole drive, and the result of its beginning."""
    path = written(tmp_path_factory.mktemp("tidy") / "in.mcap")
    return rows(run(path, "out")[0]), run(path, "before", end_s=BEFORE_S)[0]


def assert_incomplete_frames_say_so(found, tidy):
    expected = dict(tidy.select("stamp_ns", "missing").iter_rows())
    lost = set(expected) - set(found["stamp_ns"])
    for stamp, missing, codes in found.select("stamp_ns", "missing", "reason_codes").iter_rows():
        said = any(code.startswith("log.") for code in codes)
        lacks = set(missing) > set(expected[stamp])
        follows = any(stamp - STEP_NS == other for other in lost)
        assert said >= (lacks or follows)
    assert len(found) >= STRUCK


@pytest.mark.parametrize(("writer", "damage"), CASES)
def test_without_recover_only_the_part_before_the_damage_is_replayed(tmp_path, tidy, writer, damage):
    whole, path = damaged(tmp_path / "a.mcap", writer, damage)
    if (writer, damage) in UNSEEN:
        assert len(messages(run(path, "out")[0])) == len(messages(whole))
        return
    with pytest.raises(LogError, match=r"damaged at byte \d+: .*--recover"):
        run(path, "out")
    if (writer, damage) in WITHOUT_PLACE:
        with pytest.raises(LogError, match=r"damaged at byte \d+: .*--recover"):
            run(path, "part", end_s=BEFORE_S)
        return
    target, summary = run(path, "part", end_s=BEFORE_S)
    assert messages(target) == messages(tidy[1])
    assert rows(target).drop("log_id", "^.*_ms$").equals(rows(tidy[1]).drop("log_id", "^.*_ms$"))
    assert "damaged at byte" in summary.warnings[0]
