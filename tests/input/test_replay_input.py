"""A log that is opened for replay: its frames, its messages, what became of them, and what is read how often."""

import pytest

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ChannelError
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.system.time import TimeRange
from tests import logs

CFG = ReplayConfig()


@pytest.fixture
def source(tmp_path):
    return logs.write(tmp_path / "in.mcap", logs.items(4))


def test_samples_messages_and_counts(source):
    log_in = open_input(ReplaySource(source), CFG)
    assert (log_in.expected_frames, log_in.frames) == (4, 0)
    assert [sample.index for sample in log_in.samples()] == [0, 1, 2, 3]
    assert (log_in.frames, log_in.dropped, log_in.unreadable, log_in.notes) == (4, {}, {}, ())
    assert list(log_in.messages.copied()) == list(log.read(log.summarise(source)))
    assert log_in.span_ns == (log_in.summary.first_ns, log_in.summary.last_ns)
    assert set(log_in.topics) == set(logs.ALL)


def test_dropped_messages_are_recorded(source):
    late = [logs.Item("depth", item.stamp_ns + 20_000_000, item.data) for item in logs.items(4) if item.role == "depth"]
    source = logs.write(source, sorted([*logs.items(4), *late], key=lambda item: item.stamp_ns))
    log_in = open_input(ReplaySource(source), CFG)
    list(log_in.samples())
    record = log_in.record()
    assert (record["frames"], record["dropped.depth"]) == ("4", "4")
    assert record["digest"].startswith(log_in.log_id)
    assert record["input_messages"] == str(len(list(log_in.messages.copied())))
    assert not any(key.startswith("topic.") for key in record)


def test_a_topic_that_the_user_chose_is_recorded(source, tmp_path):
    moved = [logs.Item(i.role, i.stamp_ns, i.data, "/cam/rgb" if i.role == "image" else "") for i in logs.items(2)]
    other = [logs.Item("image", i.stamp_ns, i.data, "/cam/other") for i in moved if i.role == "image"]
    source = logs.write(tmp_path / "two.mcap", sorted([*moved, *other], key=lambda item: item.stamp_ns))
    with pytest.raises(ChannelError, match="2 topics fit role image"):
        open_input(ReplaySource(source), CFG)
    assert open_input(ReplaySource(source, {"image": "/cam/rgb"}), CFG).record()["topic.image"] == "/cam/rgb"


FRAMES = 3


def opened(source):
    return open_input(ReplaySource(source, time_range=TimeRange(frames=FRAMES)), CFG)
