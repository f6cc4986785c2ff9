"""A finished log and one that is being written give the player the same."""

import pytest

from roadperc_stream.errors import LogError
from roadperc_stream.log import Channel, LogWriter, Message
from roadperc_stream.view.live.playhead import Reach
from roadperc_stream.view.live.source import FinishedLog, RunningReplay, held

S = 1_000_000_000
ONCE, OFTEN, TWIN, SILENT = (
    Channel("/once", "raw"),
    Channel("/often", "raw"),
    Channel("/often", "raw", "other", "text", b"x"),
    Channel("/silent", "raw"),
)


def messages(seconds=100):
    """One at the start, two channels of one topic four times a second; 100 kB each, so that chunks close."""
    yield Message(ONCE, 10 * S, 10 * S, 0, b"once")
    for k in range(4 * seconds):
        time_ns = 10 * S + k * S // 4
        data = k.to_bytes(4, "big") * 25_000
        yield from (Message(channel, time_ns, time_ns, k, data) for channel in (OFTEN, TWIN))


def plain(found):
    return [
        (m.channel.topic, m.channel.schema_name, m.log_time_ns, m.publish_time_ns, m.sequence, m.data) for m in found
    ]


def opened(path):
    writer = LogWriter(path)
    writer.__enter__()
    for channel in (ONCE, OFTEN, TWIN, SILENT):
        writer.register(channel)
    return writer, RunningReplay(writer.while_written(), 10 * S)


@pytest.fixture(params=["finished", "running", "complete"])
def source(request, tmp_path):
    writer, running = opened(tmp_path / "log.mcap")
    for message in messages():
        writer.write(message)
    if request.param == "running":
        yield running
        writer.__exit__(None, None, None)
    else:
        writer.__exit__(None, None, None)
        yield running if request.param == "complete" else FinishedLog.opened(tmp_path / "log.mcap")


def test_all_messages_in_order(source):
    found = [m for m in source.follow(0) if m] if source.reach().complete else until_edge(source.follow(0))
    assert plain(found) == plain(messages())


def test_a_start_that_is_a_messages_very_time_begins_with_it(source):
    for time_ns in range(10 * S, 109 * S, S // 4):
        for start_ns, expected_ns in ((time_ns, time_ns), (time_ns + 1, time_ns + S // 4)):
            assert next(iter(source.follow(start_ns))).log_time_ns == expected_ns


def test_an_end_that_is_a_messages_very_time_leaves_it_out(source):
    for time_ns in range(10 * S, 109 * S, S // 4):
        assert {m.log_time_ns for m in source.read({"/often"}, time_ns, time_ns + 1)} == {time_ns}
        assert list(source.read({"/often"}, time_ns + 1, time_ns + S // 4)) == []


def until_edge(coming):
    return list(iter(lambda: next(coming), None))


def test_every_channel_is_known(source):
    assert {c.topic for c in source.channels} == {"/once", "/often", "/silent"}


def test_following_starts_anywhere(source):
    first = next(iter(source.follow(60 * S + 1)))
    assert first.log_time_ns == 60 * S + S // 4


def test_what_holds_is_the_last_of_each_channel(source):
    found = held(source, {"/once", "/often", "/silent"}, 60 * S + 1)
    assert [(m.channel.topic, m.channel.schema_name, m.log_time_ns) for m in found] == [
        ("/once", "", 10 * S),
        ("/often", "", 60 * S),
        ("/often", "other", 60 * S),
    ]


def test_all_of_one_time_holds_together(tmp_path):
    writer, running = opened(tmp_path / "log.mcap")
    for k in range(4):
        writer.write(Message(ONCE, 10 * S + k // 2, 0, k, bytes([k])))
    assert [m.data for m in held(running, {"/once"}, 20 * S)] == [b"\x02", b"\x03"]
    writer.__exit__(None, None, None)


def test_nothing_holds_before_the_first(source):
    assert held(source, {"/often"}, 10 * S - 1) == []


def test_the_reach_ends_before_a_frame_that_may_not_be_whole(tmp_path):
    writer, running = opened(tmp_path / "log.mcap")
    assert running.reach() == Reach(10 * S - 1, 10 * S - 1, complete=False)
    for time_ns in (10 * S, 12 * S):
        writer.write(Message(ONCE, time_ns, time_ns, 0, b""))
    assert running.reach() == Reach(10 * S - 1, 12 * S - 1, complete=False)
    writer.__exit__(None, None, None)
    assert running.reach() == Reach(10 * S - 1, 12 * S)


def test_following_waits_at_the_edge_and_survives_chunks_and_the_new_name(tmp_path):
    writer, running = opened(tmp_path / "log.mcap")
    coming, found = running.follow(0), []
    for k, message in enumerate(messages(20)):
        writer.write(message)
        if k % 7 == 0:
            found += until_edge(coming)
    writer.__exit__(None, None, None)
    found += [m for m in coming if m]
    assert plain(found) == plain(messages(20))


def test_memory_is_that_of_a_chunk(tmp_path):
    writer, running = opened(tmp_path / "log.mcap")
    most = 0
    for message in messages(20):
        writer.write(message)
        most = max(most, sum(len(m.data) for m in running.growing._open))
    assert most < 1_200_000
    writer.__exit__(None, None, None)


def test_the_file_is_the_same_with_a_reader(tmp_path):
    followed, running = opened(tmp_path / "followed.mcap")
    with LogWriter(tmp_path / "plain.mcap") as alone:
        for channel in (ONCE, OFTEN, TWIN, SILENT):
            alone.register(channel)
        for message in messages(5):
            followed.write(message)
            alone.write(message)
        assert list(running.read({"/once"}, 0, 99 * S))
    followed.__exit__(None, None, None)
    assert (tmp_path / "followed.mcap").read_bytes() == (tmp_path / "plain.mcap").read_bytes()


def test_a_reader_of_a_discarded_log_is_told(tmp_path):
    writer, running = opened(tmp_path / "log.mcap")
    for message in messages(5):
        writer.write(message)
    writer.__exit__(KeyboardInterrupt, None, None)
    with pytest.raises(LogError, match=r"log\.mcap"):
        list(running.read({"/once"}, 0, 99 * S))


def test_a_log_without_messages_cannot_be_played(tmp_path):
    with LogWriter(tmp_path / "log.mcap"):
        pass
    with pytest.raises(LogError, match="no message to play"):
        FinishedLog.opened(tmp_path / "log.mcap")
