"""Continued replays of the parts of a log give the results of the whole log."""

import hashlib
import os
import zlib
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roadperc_stream import log, read_metrics
from roadperc_stream.chain import encoding
from roadperc_stream.chain.encoding import FORMAT_VERSION, decode, encode
from roadperc_stream.config import load_config
from roadperc_stream.errors import NoFrameError, StateError
from roadperc_stream.eval.runs import collect, find_runs
from roadperc_stream.eval.scan import rows_of
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.metrics import frame_metrics
from roadperc_stream.output.writing import FrameOutput
from roadperc_stream.resume.checkpoint import Checkpoint
from roadperc_stream.resume.state import ReplayState, SavedState
from roadperc_stream.schemas.record import STATE_ATTACHMENT
from roadperc_stream.system.time import TimeRange
from tests import logs
from tests.replaying import replay
from tests.resume.parts import assert_same_rows, cut, inputs, replayed, results, rows, with_attachments, write
from tests.steps import step

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
WAIT = ("sync.max_wait_s=0.2",)
CFG = load_config(None, WAIT)
ROAD = replace(logs.SMALL, width=96, height=72)
LATCHED = ("/camera/front/calibration", "/tf")
TABLES = ("metrics", "objects")


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return inputs(logs.write(tmp_path_factory.mktemp("drive") / "in.mcap", logs.items(16, road=ROAD)))


def assert_equal(whole, parts):
    assert results(parts) == results(whole)
    for table in TABLES:
        assert_same_rows(rows(parts, table), rows(whole, table))


def cut_anywhere(data, messages, wait_ns):
    """Randomly delayed and lost messages, and their parts at random cuts."""
    draw = data.draw
    delays = draw(st.lists(st.integers(0, wait_ns), min_size=len(messages), max_size=len(messages)))
    lost = draw(st.frozensets(st.integers(10, len(messages) - 1), max_size=len(messages) // 8))
    arrived = [
        replace(m, log_time_ns=m.log_time_ns + delay * (m.channel.topic not in LATCHED))
        for k, (m, delay) in enumerate(zip(messages, delays, strict=True))
        if k not in lost
    ]
    arrived.sort(key=lambda m: m.log_time_ns)
    first = {m.channel.topic: m.log_time_ns for m in reversed(arrived)}
    times = st.integers(max(first.values()) + 1, arrived[-1].log_time_ns)
    return arrived, cut(arrived, draw(st.lists(times, min_size=1, max_size=4)))


def assert_parts_equal_the_whole(data, messages, cfg, wait_ns):
    arrived, parts = cut_anywhere(data, messages, wait_ns)
    with TemporaryDirectory() as folder:
        (Path(folder) / "whole").mkdir()
        assert_equal(replayed(Path(folder) / "whole", [arrived], cfg), replayed(Path(folder), parts, cfg))


ANYHOW = {"deadline": None, "suppress_health_check": list(HealthCheck)}


@settings(max_examples=2, **ANYHOW)
@given(data=st.data())
def test_a_small_log_cut_anywhere(drive, data):
    assert_parts_equal_the_whole(data, drive, CFG, 200_000_000)


@pytest.mark.accuracy
@settings(max_examples=int(os.environ.get("PARTS", "500")), **ANYHOW)
@given(data=st.data())
def test_a_small_log_cut_anywhere_at_length(drive, data):
    assert_parts_equal_the_whole(data, drive, CFG, 200_000_000)


@pytest.mark.accuracy
@settings(max_examples=max(int(os.environ.get("PARTS", "500")) // 20, 1), **ANYHOW)
@given(data=st.data())
def test_the_sample_cut_anywhere(data):
    assert_parts_equal_the_whole(data, inputs(SAMPLE), load_config(), 1_000_000_000)


def test_the_sample_in_three_parts(tmp_path):
    """The last part is shorter than the wait."""
    messages = [m for m in inputs(SAMPLE) if m.log_time_ns < log.summarise(SAMPLE).first_ns + 400_000_000]
    first, last = messages[0].log_time_ns, messages[-1].log_time_ns
    cfg = load_config(None, ("sync.max_wait_s=0.2",))
    parts = replayed(tmp_path, cut(messages, [first + (last - first) // 2, last - 120_000_000]), cfg)
    (tmp_path / "whole").mkdir()
    whole = replayed(tmp_path / "whole", [messages], cfg)
    assert_equal(whole, parts)
    assert read_metrics(parts)["frame"].to_list() == read_metrics(whole[0])["frame"].to_list()


def test_hindsight_reaches_back_over_a_cut(tmp_path):
    """The rows of the second before the cut are in the state: tracks are smoothed over it."""
    messages = inputs(SAMPLE)
    first, last = messages[0].log_time_ns, messages[-1].log_time_ns
    parts = replayed(tmp_path, cut(messages, [first + (last - first) * 2 // 5]), load_config(None, WAIT))
    (tmp_path / "whole").mkdir()
    whole = replayed(tmp_path / "whole", [messages], load_config(None, WAIT))
    assert_equal(whole, parts)
    begin = rows(parts[:1], "metrics").height
    for table, column in (("objects", "object_distance_hindsight_m"), ("metrics", "step_hindsight_m")):
        known = rows(parts, table).filter(pl.col(column).is_not_null())["frame"]
        assert begin in known, column


def test_a_decoded_state_gives_the_same_frames():
    """Each frame is computed from the previous state and from its decoded bytes."""
    cfg = load_config()
    state = again = ReplayState()
    for sample in open_input(ReplaySource(SAMPLE, time_range=TimeRange(frames=8)), cfg).samples():
        again = decode(encode(again), ReplayState)
        rows = []
        for before in (state, again):
            chain, result = step(cfg, before.chain, sample.frame)
            rows.append(frame_metrics(cfg, "", sample, result, before.earlier))
            state, again = again, ReplayState(chain, sample.as_earlier)
        assert rows[0] == rows[1]
        assert encode(again) == encode(state)


def test_the_fields_of_a_state_match_its_version():
    """If this fails, raise FORMAT_VERSION, so that older states are refused."""
    held = _held(msgspec.inspect.type_info(SavedState), {})
    names = sorted(f"{kind.__name__}.{name}" for kind, names in held.items() for name in names)
    digest = hashlib.sha256(" ".join(names).encode()).hexdigest()[:8]
    assert (FORMAT_VERSION, digest) == (14, "49627510"), names


@pytest.mark.parametrize("kind", [SavedState, Checkpoint, FrameOutput])
def test_encoded_types_have_no_caches(kind):
    """Private fields, and fields that comparisons ignore, may differ in equal states."""
    held = _held(msgspec.inspect.type_info(kind), {})
    caches = [(part, f.name) for part in held for f in fields(part) if f.name.startswith("_") or not f.compare]
    assert (caches, kind in held) == ([], True)


def _held(info, found):
    """Names of the fields of all dataclasses in a type, by dataclass."""
    if isinstance(info, msgspec.inspect.DataclassType):
        kind = getattr(info.cls, "__origin__", info.cls)
        if kind in found:
            return found
        found[kind] = [field.encode_name for field in info.fields]
    for name in ("fields", "item_type", "item_types", "types", "key_type", "value_type", "type"):
        inner = getattr(info, name, ())
        for part in inner if isinstance(inner, tuple) else (inner,):
            if isinstance(part, msgspec.inspect.Type | msgspec.inspect.Field):
                _held(part, found)
    return found


@pytest.fixture(scope="module")
def parts(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    return replayed(folder, cut(drive, [drive[0].log_time_ns + 500_000_000]), CFG)


def names(path):
    return [attachment.name for attachment in log.summarise(path).attachments]


def test_a_result_has_the_messages_of_its_frames_and_replays_without_the_state(parts, tmp_path):
    again = tmp_path / "again.mcap"
    assert [names(part) for part in parts] == [["roadperc.toml", "roadperc.state"]] * 2
    replay(parts[0], again, CFG)
    assert again.read_bytes() == parts[0].read_bytes()
    summary = replay(parts[1], tmp_path / "second.mcap", CFG)
    assert any("begins without its state" in note for note in summary.notes)
    rows, alone = read_metrics(parts[1]), read_metrics(tmp_path / "second.mcap")
    assert rows["frame"][0] > 0
    assert alone["frame"][0] == 0
    assert set(rows["stamp_ns"]) <= set(alone["stamp_ns"]), "the images of all its frames are in it"
    written = {m.sequence for m in log.read(log.summarise(parts[1]), topics=["/perception/metrics"])}
    assert written == set(rows["frame"])


def test_a_result_names_the_log_that_it_continues(parts):
    first = read_metrics(parts[0])["log_id"][0]
    (record,) = log.summarise(parts[1]).metadata
    assert dict(record.values)["continues"] == first
    runs = find_runs([str(path) for path in parts])
    assert [run.continues for run in runs] == ["", first]
    assert runs[0].end_frame == runs[1].first_frame == read_metrics(parts[1])["frame"].min() > 0


def test_readers_take_the_last_version_of_a_frame(parts, tmp_path):
    runs = find_runs([str(path) for path in parts])
    given = [collect(rows_of(run).select("frame"), "")["frame"].to_list() for run in runs]
    assert [*given[0], *given[1]] == list(range(16)) == read_metrics(parts)["frame"].to_list()
    assert [run.frames for run in runs] == [len(frames) for frames in given]
    assert len(read_metrics(parts[0])) > runs[0].frames
    assert find_runs([str(parts[0])])[0].frames == len(read_metrics(parts[0]))


def test_a_result_is_not_continued_with_other_settings(drive, parts, tmp_path):
    other, later = load_config(None, (*WAIT, "lanes.hold_s=0.3")), cut(drive, [drive[0].log_time_ns + 500_000_000])[1]
    with pytest.raises(StateError, match=r"cannot be continued with other settings: lanes.hold_s was 0.5, is 0.3"):
        replay(write(tmp_path / "in.mcap", later), tmp_path / "out.mcap", other, continued=parts[0])


def test_an_oversized_state_is_left_out(drive, tmp_path, monkeypatch):
    monkeypatch.setattr(encoding, "MOST_BYTES", 1000)
    summary = replay(write(tmp_path / "in.mcap", drive), tmp_path / "out.mcap", CFG)
    assert any("this result cannot be continued" in note for note in summary.notes)
    assert names(tmp_path / "out.mcap") == ["roadperc.toml"]


def test_results_alone_cannot_be_continued(drive, parts, tmp_path):
    with pytest.raises(StateError, match=r"with its input \(not --results-only\)"):
        replayed(tmp_path, cut(drive, [drive[0].log_time_ns + 500_000_000]), CFG, results_only=True)


@pytest.mark.parametrize(
    ("data", "expected"), [(None, r"has no attachment roadperc\.state"), (b"", "not the state of a replay")]
)
def test_an_invalid_state_is_refused(drive, parts, tmp_path, data, expected):
    before = with_attachments(parts[0], tmp_path / "before.mcap", **{STATE_ATTACHMENT: data})
    with pytest.raises(StateError, match=expected):
        replay(parts[1], tmp_path / "out.mcap", CFG, continued=before)
    assert [path.name for path in tmp_path.iterdir()] == ["before.mcap"]


def test_a_state_with_missing_messages_is_refused(drive, parts, tmp_path):
    before = tmp_path / "before.mcap"
    with log.LogWriter(before) as writer:
        for item in log.summarise(parts[0]).attachments:
            writer.attach(item)
        for message in inputs(parts[0])[:-30]:
            writer.write(message)
    later = write(tmp_path / "in.mcap", cut(drive, [drive[0].log_time_ns + 500_000_000])[1])
    with pytest.raises(StateError, match="is not in it: expected the unchanged result"):
        replay(later, tmp_path / "out.mcap", CFG, continued=before)


def test_a_changed_state_gives_a_state_or_one_error(parts):
    (data,) = (item.data for item in log.summarise(parts[0]).attachments if item.name == STATE_ATTACHMENT)
    rng = np.random.default_rng(1)
    for _ in range(60):
        changed = bytearray(data)
        changed[int(rng.integers(12, len(data)))] = int(rng.integers(256))
        changed[8:12] = zlib.crc32(changed[12:]).to_bytes(4, "little")
        with suppress(StateError):
            assert isinstance(decode(bytes(changed), SavedState), SavedState)


def test_an_earlier_log_cannot_continue_a_result(parts, tmp_path):
    with pytest.raises(StateError, match=r"begins 0\.\d{3} s before the end of .*: expected later messages"):
        replay(parts[0], tmp_path / "out.mcap", CFG, continued=parts[0])


def test_a_log_of_another_sensor_cannot_continue_a_result(parts, drive, tmp_path):
    cut_ns = drive[0].log_time_ns + 500_000_000
    depth = [m for m in drive if m.log_time_ns < cut_ns and m.channel.topic != "/camera/front/image"]
    (before,) = replayed(tmp_path, [depth], CFG)
    with pytest.raises(StateError, match="would make the frames: expected role depth, as in the continued result"):
        replay(parts[1], tmp_path / "out.mcap", CFG, continued=before)


def test_only_a_continued_replay_may_have_no_frame(drive, tmp_path):
    """The camera fails, the depth sensor continues."""
    (depth, *_) = [m for m in drive if m.channel.topic == "/camera/front/depth"]
    stamps = [drive[-1].log_time_ns + k * 100_000_000 for k in range(1, 20)]
    alone = [replace(depth, log_time_ns=t, data=logs.frame_items(t, ROAD)[1].data) for t in stamps]
    made = replayed(tmp_path, [[*drive, *alone[:10]], alone[10:]], CFG)
    assert [len(read_metrics(path)) for path in made] == [16, 0]
    assert read_metrics(made)["frame"].to_list() == list(range(16))
    with pytest.raises(NoFrameError):
        replay(tmp_path / "in_0.mcap", tmp_path / "out.mcap", CFG, time_range=TimeRange(start_s=1.0))


def test_a_file_cut_by_start_and_end(parts, drive, tmp_path):
    """With --start and --end, a late message belongs to the frame in the second part."""
    source = write(tmp_path / "in.mcap", drive)
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    replay(source, first, CFG, time_range=TimeRange(end_s=0.5))
    replay(source, second, CFG, time_range=TimeRange(start_s=0.5), continued=first)
    assert results([first, second]) == results(parts)
