"""Files with the same messages in any arrangement: equal results, little memory."""

import tracemalloc

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import IndexType, Writer

from roadperc_stream import log
from roadperc_stream.config import load_config
from roadperc_stream.errors import TargetError
from roadperc_stream.log import Channel
from roadperc_stream.log.indexed import IndexedFile
from roadperc_stream.system.time import TimeRange
from tests.arranged import ARRANGEMENTS, arranged, by_library, by_topic, plain, shuffled
from tests.replaying import replay
from tests.test_sample import SAMPLE

A = Channel("/a", "x", source_id=1)
LATEST_NS = 2**64 - 1


@pytest.fixture
def nothing_held(monkeypatch):
    """Sort logs with overlapping chunks on disk."""
    monkeypatch.setattr("roadperc_stream.log.indexed.MOST_HELD_BYTES", 1_000_000)


def was_sorted(summary):
    """Return whether the messages that were read were sorted on disk."""
    source = summary.source
    return (source.in_order if isinstance(source, IndexedFile) else source)._database is not None


def written(path, times, **options):
    """A log of messages at these times."""
    return by_library(path, [(("/a", "/b")[number % 2], time) for number, time in enumerate(times)], **options)


@pytest.mark.usefixtures("nothing_held")
@pytest.mark.parametrize("options", ARRANGEMENTS.values(), ids=ARRANGEMENTS)
def test_the_sample_is_the_same_in_every_arrangement(tmp_path, options):
    whole = log.summarise(SAMPLE)
    found = log.summarise(arranged(SAMPLE, tmp_path / "other.mcap", **options))
    assert (found.channels, found.counts, found.metadata) == (whole.channels, whole.counts, whole.metadata)
    assert (found.first_ns, found.last_ns) == (whole.first_ns, whole.last_ns)
    assert plain(log.read(found)) == plain(log.read(whole))
    assert was_sorted(found) != (options.get("chunk_size") == 50_000)


@pytest.mark.usefixtures("nothing_held")
@pytest.mark.parametrize("rearranged", [shuffled, by_topic])
def test_unordered_messages_are_read_in_log_time_order(tmp_path, rearranged):
    found = log.summarise(rearranged(SAMPLE, tmp_path / "other.mcap"))
    in_order, messages = plain(log.read(log.summarise(SAMPLE))), plain(log.read(found))
    assert [m[1] for m in messages] == [m[1] for m in in_order]
    assert sorted(messages, key=repr) == sorted(in_order, key=repr)
    assert was_sorted(found)


@pytest.mark.usefixtures("nothing_held")
def test_results_do_not_depend_on_the_chunks_of_the_input(tmp_path):
    cfg = load_config(None, ("odometry.enabled=false", "lanes.enabled=false", "objects.enabled=false"))
    names = {"tidy": SAMPLE}
    for name in ("small chunks", "no chunks"):
        names[name] = arranged(SAMPLE, tmp_path / f"{name}.mcap", **ARRANGEMENTS[name])
    outputs = {name: tmp_path / f"{name}.out.mcap" for name in names}
    for name, source in names.items():
        replay(source, outputs[name], cfg, time_range=TimeRange(frames=2))
        replay(outputs[name], tmp_path / "again.mcap", cfg, force=True)
        assert outputs[name].read_bytes() == (tmp_path / "again.mcap").read_bytes()
    tidy = log.summarise(outputs["tidy"])
    for path in outputs.values():
        found = log.summarise(path)
        assert (found.attachments, found.metadata, found.counts) == (tidy.attachments, tidy.metadata, tidy.counts)
        assert plain(log.read(found)) == plain(log.read(tidy))


@settings(max_examples=60)
@given(
    st.lists(st.one_of(st.integers(0, 20), st.integers(0, LATEST_NS)), max_size=40),
    st.sampled_from([*ARRANGEMENTS.values(), {"chunk_size": 100}]),
    st.tuples(st.integers(0, 21), st.integers(0, 21)).map(sorted),
    st.sampled_from([None, ["/a"], ["/b", "/c"], []]),
)
def test_any_part_of_any_arrangement_is_read(tmp_path_factory, times, options, part, topics):
    path = written(tmp_path_factory.mktemp("log") / "a.mcap", times, **options)
    numbered = sorted((time, number) for number, time in enumerate(times))
    summary = log.summarise(path)
    assert [(m.log_time_ns, m.sequence) for m in log.read(summary)] == numbered
    wanted = [
        (time, number)
        for time, number in numbered
        if part[0] <= time < part[1] and (topics is None or "/ab"[1 + number % 2] in "".join(topics))
    ]
    read = log.read(summary, topics=topics, start_ns=part[0], end_ns=part[1])
    assert [(m.log_time_ns, m.sequence) for m in read] == wanted


def test_readers_of_a_sorted_log_are_independent(tmp_path):
    summary = log.summarise(written(tmp_path / "a.mcap", [3, 1, 2, 0], use_chunking=False))
    pairs = list(zip(log.read(summary), log.read(summary), strict=True))
    assert [one.log_time_ns for one, _ in pairs] == [other.log_time_ns for _, other in pairs] == [0, 1, 2, 3]


def test_a_log_is_sorted_when_read_and_leaves_no_file(tmp_path, monkeypatch):
    path = written(tmp_path / "a.mcap", [2, 1], use_chunking=False)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    summary = log.summarise(path)
    assert summary.source._database is None
    messages = log.read(summary)
    assert next(messages).log_time_ns == 1
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_missing_folder_for_temporary_files_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none"))
    summary = log.summarise(written(tmp_path / "a.mcap", [2, 1], use_chunking=False))
    with pytest.raises(TargetError, match=rf"a\.mcap: cannot be sorted in {tmp_path}/none: .*TMPDIR") as caught:
        next(log.read(summary))
    assert "\n" not in str(caught.value)


def read_and_peak(path):
    """Bytes of messages, and the most memory that reading them takes."""
    tracemalloc.start()
    try:
        return sum(len(m.data) for m in log.read(log.summarise(path))), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_every_arrangement_takes_the_memory_of_the_indexed_log(tmp_path, monkeypatch):
    """50 MB of messages must not be in memory together."""
    data = bytes(250_000)
    monkeypatch.setattr("roadperc_stream.log.indexed.MOST_HELD_BYTES", 2_000_000)

    def big(name, order, **options):
        with (tmp_path / name).open("wb") as stream:
            writer = Writer(stream, **options)
            writer.start()
            channel = writer.register_channel("/a", "x", 0)
            for time in order:
                writer.add_message(channel, time, data, time)
            writer.finish()
        return tmp_path / name

    _, tidy = read_and_peak(big("tidy.mcap", range(200)))
    others = {
        "shuffled": big("shuffled.mcap", [7 * k % 200 for k in range(200)]),
        "one chunk": big("one.mcap", range(200), chunk_size=2**40),
        "no index": big("no.mcap", range(200), index_types=IndexType.NONE),
        "no chunks": big("bare.mcap", range(200), use_chunking=False),
    }
    for name, path in others.items():
        read, peak = read_and_peak(path)
        assert read == len(data) * 200
        assert peak < 1.5 * tidy + 4_000_000, name  # one or two chunks
