"""The channel of the times: behind each frame's metrics, wherever playback goes and as soon as they are known."""

from dataclasses import dataclass, field

from roadperc_stream.log import Channel, Message
from roadperc_stream.schemas import roadperc_pb2 as pb
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.schemas.record import PRODUCER
from roadperc_stream.schemas.registry import schema
from roadperc_stream.schemas.topics import LIVE_ONLY, RESULTS, TIMES_TOPIC
from roadperc_stream.view.live.playhead import Reach
from roadperc_stream.view.live.source import TimedSource, held
from roadperc_stream.view.result_frames import ReplayTimes

S = 1_000_000_000
IMAGE, LINE = Channel("/image", "raw"), Channel("/perception/log", "raw")
METRICS = Channel("/perception/metrics", "protobuf", "roadperc.FrameMetrics", metadata=(PRODUCER,))


def metrics(frame, channel=METRICS):
    content = pb.FrameMetrics(log_id="log", frame=frame, frame_id="camera")
    content.timestamp.FromNanoseconds(frame * S)
    return Message(channel, frame * S, frame * S, frame, content.SerializeToString())


def image(frame):
    return Message(IMAGE, frame * S, frame * S, frame, b"")


@dataclass
class Script:
    """A log of which some messages are not there yet: None stands in their place."""

    messages: list
    done: list = field(default_factory=list)
    channels = (IMAGE, METRICS)

    def reach(self):
        return Reach(0, 9 * S)

    def read(self, topics, start_ns, end_ns):
        there = (m for m in self.messages if m)
        return (m for m in there if m.channel.topic in topics and start_ns <= m.log_time_ns < end_ns)

    def follow(self, start_ns):
        return (m for m in self.messages if not m or m.log_time_ns >= start_ns)


def known(*frames):
    times = ReplayTimes()
    for frame in frames:
        note(times, frame)
    return times


def note(times, frame):
    times.note(FrameMetrics("log", frame, 0), {"lanes_ms": 1.0 + frame, "total_ms": 10.0})


def plain(messages):
    return [m and (m.channel.topic, m.log_time_ns // S) for m in messages]


LOG = [image(0), metrics(0), image(1), metrics(1), image(2), metrics(2)]


def test_the_channel_is_that_of_the_contract():
    source = TimedSource(Script(LOG), known())
    assert source.channels[:2] == (IMAGE, METRICS)
    assert [(c.topic, c.schema_name) for c in source.channels[2:]] == list(LIVE_ONLY.items())
    assert source.channel.schema_data == schema("roadperc.StageTimes").data
    assert TIMES_TOPIC not in RESULTS


def test_each_frames_times_follow_its_metrics():
    assert plain(TimedSource(Script(LOG), known(0, 1, 2)).follow(1 * S)) == [
        ("/image", 1),
        ("/perception/metrics", 1),
        (TIMES_TOPIC, 1),
        ("/image", 2),
        ("/perception/metrics", 2),
        (TIMES_TOPIC, 2),
    ]


def test_a_message_says_what_is_known():
    *_, last = TimedSource(Script(LOG), known(2)).follow(0)
    times = pb.StageTimes.FromString(last.data)
    assert (times.timestamp.ToNanoseconds(), times.frame_id) == (2 * S, "camera")
    assert (times.lanes_ms, times.total_ms, times.HasField("stereo_ms")) == (3.0, 10.0, False)


def test_times_that_come_late_come_before_the_next_frame():
    """The replay writes metrics and a line for the log, and only then knows how long the frame took."""
    line = Message(LINE, 0, 0, 0, b"")
    times = known()
    coming = TimedSource(Script([metrics(0), None, line, None, None, image(1)]), times).follow(0)
    found = [next(coming) for _ in range(4)]
    note(times, 0)
    found += coming
    assert plain(found) == [
        ("/perception/metrics", 0),
        None,
        ("/perception/log", 0),
        None,
        (TIMES_TOPIC, 0),
        None,
        ("/image", 1),
    ]


def test_times_of_the_last_frame_come_at_the_end():
    times = known()
    coming = TimedSource(Script([metrics(0)]), times).follow(0)
    assert plain([next(coming)]) == [("/perception/metrics", 0)]
    note(times, 0)
    assert plain(coming) == [(TIMES_TOPIC, 0)]


def test_a_frame_whose_times_are_not_known_has_none():
    assert plain(TimedSource(Script(LOG), known(0, 2)).follow(0)).count((TIMES_TOPIC, 1)) == 0
    assert (TIMES_TOPIC, 2) in plain(TimedSource(Script(LOG), known(0, 2)).follow(0))


def test_what_holds_after_a_seek():
    source = TimedSource(Script(LOG), known(0, 1, 2))
    assert plain(held(source, {"/image", TIMES_TOPIC}, 1 * S + 5)) == [("/image", 1), (TIMES_TOPIC, 1)]
    assert plain(held(source, {"/image", "/perception/metrics"}, 0)) == [("/image", 0), ("/perception/metrics", 0)]


def test_only_a_replays_own_metrics_are_asked():
    foreign = Channel("/perception/metrics", "protobuf", "other.Metrics")
    broken = Message(METRICS, 0, 0, 0, b"\xff\xff")
    messages = [metrics(0, foreign), broken]
    assert list(TimedSource(Script(messages), known(0)).follow(0)) == messages


def test_whether_there_are_times():
    assert TimedSource(Script(LOG), known(0)).has_times()
    assert not TimedSource(Script(LOG), known(5)).has_times()
    assert not TimedSource(Script([image(0)]), known(0)).has_times()


def test_the_times_of_a_frame_at_the_logs_very_end_are_found():
    assert TimedSource(Script([metrics(9)]), known(9)).has_times()
    assert not TimedSource(Script([metrics(9)]), known(8)).has_times()
    assert not TimedSource(Script([image(9)]), known(9)).has_times()
