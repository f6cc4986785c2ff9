"""Finished and growing logs as sources of the player; stage times follow the metrics of each frame."""

import pytest

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.log import Channel, LogWriter, Message
from roadperc_stream.output.results import result_channel
from roadperc_stream.schemas import row_messages as pb
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.schemas.protobuf import schema
from roadperc_stream.schemas.topics import LIVE_ONLY, RESULTS, TIMES_TOPIC
from roadperc_stream.view.live.source import Reach, Source, finished_log, has_times, held, running_replay, with_times
from roadperc_stream.view.result_frames import ReplayTimes

S = 1_000_000_000
ONCE, OFTEN, TWIN, SILENT = (
    Channel("/once", "raw"),
    Channel("/often", "raw"),
    Channel("/often", "raw", "other", "text", b"x"),
    Channel("/silent", "raw"),
)


def messages(seconds=30):
    """One message, then two channels of one topic four times a second; 100 kB each, so that chunks close."""
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
    return writer, running_replay(writer.while_written(), 10 * S)


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
        yield running if request.param == "complete" else finished_log(log.summarise(tmp_path / "log.mcap"))


def test_a_source_gives_all_messages_in_order(source):
    found = [m for m in source.follow(0) if m] if source.reach().complete else until_edge(source.follow(0))
    assert plain(found) == plain(messages())


def test_start_times_are_inclusive_and_end_times_exclusive(source):
    for time_ns in range(10 * S, 39 * S, 5 * S // 4):
        for start_ns, expected_ns in ((time_ns, time_ns), (time_ns + 1, time_ns + S // 4)):
            assert next(iter(source.follow(start_ns))).log_time_ns == expected_ns
        assert {m.log_time_ns for m in source.read({"/often"}, time_ns, time_ns + 1)} == {time_ns}
        assert list(source.read({"/often"}, time_ns + 1, time_ns + S // 4)) == []


def until_edge(coming):
    return list(iter(lambda: next(coming), None))


def test_held_messages_are_the_last_of_each_channel(source):
    assert {c.topic for c in source.channels} == {"/once", "/often", "/silent"}
    found = held(source, {"/once", "/often", "/silent"}, 36 * S + 1)
    assert [(m.channel.topic, m.channel.schema_name, m.log_time_ns) for m in found] == [
        ("/once", "", 10 * S),
        ("/often", "", 36 * S),
        ("/often", "other", 36 * S),
    ]
    assert held(source, {"/often"}, 10 * S - 1) == []


def test_messages_of_one_log_time_are_held_together(tmp_path):
    writer, running = opened(tmp_path / "log.mcap")
    for k in range(4):
        writer.write(Message(ONCE, 10 * S + k // 2, 0, k, bytes([k])))
    assert [m.data for m in held(running, {"/once"}, 20 * S)] == [b"\x02", b"\x03"]
    writer.__exit__(None, None, None)


def test_the_reach_ends_before_an_incomplete_frame(tmp_path):
    writer, running = opened(tmp_path / "log.mcap")
    assert running.reach() == Reach(10 * S - 1, 10 * S - 1, complete=False)
    for time_ns in (10 * S, 12 * S):
        writer.write(Message(ONCE, time_ns, time_ns, 0, b""))
    assert running.reach() == Reach(10 * S - 1, 12 * S - 1, complete=False)
    writer.__exit__(None, None, None)
    assert running.reach() == Reach(10 * S - 1, 12 * S)


def test_following_a_growing_log_continues_after_chunks_and_the_rename(tmp_path):
    writer, running = opened(tmp_path / "log.mcap")
    coming, found = running.follow(0), []
    for k, message in enumerate(messages(20)):
        writer.write(message)
        if k % 7 == 0:
            found += until_edge(coming)
    writer.__exit__(None, None, None)
    found += [m for m in coming if m]
    assert plain(found) == plain(messages(20))


def test_a_growing_log_holds_one_chunk_in_memory(tmp_path):
    writer, _ = opened(tmp_path / "log.mcap")
    most, growing = 0, writer.while_written()
    for message in messages(20):
        writer.write(message)
        most = max(most, sum(len(m.data) for m in growing._open))
    assert most < 1_200_000
    writer.__exit__(None, None, None)


def test_reading_a_discarded_log_is_an_error(tmp_path):
    writer, running = opened(tmp_path / "log.mcap")
    for message in messages(5):
        writer.write(message)
    writer.__exit__(KeyboardInterrupt, None, None)
    with pytest.raises(LogError, match=r"log\.mcap"):
        list(running.read({"/once"}, 0, 99 * S))


def test_a_log_without_messages_cannot_be_played(tmp_path):
    with LogWriter(tmp_path / "log.mcap"):
        pass
    with pytest.raises(LogError, match="no messages to play"):
        finished_log(log.summarise(tmp_path / "log.mcap"))


IMAGE, LINE = Channel("/image", "raw"), Channel("/perception/log", "raw")
METRICS = result_channel("/perception/metrics", "roadperc.FrameMetrics")


def metrics(frame, channel=METRICS):
    content = pb.FrameMetrics(log_id="log", frame=frame, frame_id="camera")
    content.timestamp.FromNanoseconds(frame * S)
    return Message(channel, frame * S, frame * S, frame, content.SerializeToString())


def image(frame):
    return Message(IMAGE, frame * S, frame * S, frame, b"")


def timed(messages, times):
    """A source of messages, None for those not written yet, with these stage times."""
    return with_times(script(messages), times.of)


def script(messages):
    def read(topics, start_ns, end_ns):
        there = (m for m in messages if m)
        return (m for m in there if m.channel.topic in topics and start_ns <= m.log_time_ns < end_ns)

    def follow(start_ns):
        return (m for m in messages if not m or m.log_time_ns >= start_ns)

    return Source((IMAGE, METRICS), lambda: Reach(0, 9 * S), read, follow)


def known(*frames):
    times = ReplayTimes()
    for frame in frames:
        note(times, frame)
    return times


def note(times, frame):
    times.note(FrameMetrics("log", frame, 0), {"lanes_ms": 1.0 + frame, "total_ms": 10.0})


def stamped(messages):
    return [m and (m.channel.topic, m.log_time_ns // S) for m in messages]


def test_stage_times_have_the_documented_channel():
    source = timed(LOG, known())
    assert source.channels[:2] == (IMAGE, METRICS)
    assert [(c.topic, c.schema_name) for c in source.channels[2:]] == list(LIVE_ONLY.items())
    assert source.channels[2].schema_data == schema("roadperc.StageTimes").data
    assert TIMES_TOPIC not in RESULTS


LOG = [image(0), metrics(0), image(1), metrics(1), image(2), metrics(2)]


def test_known_stage_times_follow_the_metrics_of_their_frame():
    assert [t for topic, t in stamped(timed(LOG, known(0, 2)).follow(0)) if topic == TIMES_TOPIC] == [0, 2]
    assert stamped(timed(LOG, known(0, 1, 2)).follow(1 * S)) == [
        ("/image", 1),
        ("/perception/metrics", 1),
        (TIMES_TOPIC, 1),
        ("/image", 2),
        ("/perception/metrics", 2),
        (TIMES_TOPIC, 2),
    ]


def test_a_message_contains_the_known_stage_times():
    *_, last = timed(LOG, known(2)).follow(0)
    times = pb.StageTimes.FromString(last.data)
    assert (times.timestamp.ToNanoseconds(), times.frame_id) == (2 * S, "camera")
    assert (times.lanes_ms, times.total_ms, times.HasField("stereo_ms")) == (3.0, 10.0, False)


def test_late_stage_times_are_sent_before_the_next_frame():
    """The replay knows the times of a frame after it writes the metrics and a log line."""
    line = Message(LINE, 0, 0, 0, b"")
    times = known()
    coming = timed([metrics(0), None, line, None, None, image(1)], times).follow(0)
    found = [next(coming) for _ in range(4)]
    note(times, 0)
    found += coming
    assert stamped(found) == [
        ("/perception/metrics", 0),
        None,
        ("/perception/log", 0),
        None,
        (TIMES_TOPIC, 0),
        None,
        ("/image", 1),
    ]


def test_stage_times_of_the_last_frame_are_sent_at_the_end():
    times = known()
    coming = timed([metrics(0)], times).follow(0)
    assert stamped([next(coming)]) == [("/perception/metrics", 0)]
    note(times, 0)
    assert stamped(coming) == [(TIMES_TOPIC, 0)]


def test_stage_times_are_held_after_a_seek():
    source = timed(LOG, known(0, 1, 2))
    assert stamped(held(source, {"/image", TIMES_TOPIC}, 1 * S + 5)) == [("/image", 1), (TIMES_TOPIC, 1)]
    assert stamped(held(source, {"/image", "/perception/metrics"}, 0)) == [("/image", 0), ("/perception/metrics", 0)]


def test_foreign_and_damaged_metrics_have_no_stage_times():
    foreign = Channel("/perception/metrics", "protobuf", "other.Metrics")
    broken = Message(METRICS, 0, 0, 0, b"\xff\xff")
    messages = [metrics(0, foreign), broken]
    assert list(timed(messages, known(0)).follow(0)) == messages


def test_has_times_depends_on_the_first_frame():
    last = [metrics(9)]
    for messages, frame, there in ((LOG, 0, True), (LOG, 5, False), ([image(0)], 0, False), (last, 9, True)):
        assert has_times(script(messages), known(frame).of) is there
    assert not has_times(script(last), known(8).of)
