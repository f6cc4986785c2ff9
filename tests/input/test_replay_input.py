"""A log that is opened for replay: its frames, its messages, what became of them, and what is read how often."""

from dataclasses import replace

import pytest

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ChannelError
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.system.time import TimeRange
from tests import logs
from tests.analytic import STEP_NS
from tests.resume.parts import write

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


def test_every_pass_resets_the_counts(source):
    bad = logs.Item("depth", logs.items(4)[-1].stamp_ns + 1, b"no depth")
    source = logs.write(source, [*logs.items(4), bad])
    log_in = open_input(ReplaySource(source), CFG)
    for _ in range(2):
        assert len(list(log_in.samples())) == 4
        assert log_in.unreadable == {"/camera/front/depth": 1}
        assert any("/camera/front/depth: message at" in note for note in log_in.notes)


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


def with_late_depth(source, path, frame, by_ns):
    """The log once more, the depth of a frame so much later."""
    stamp_ns = logs.START_NS + frame * STEP_NS
    delays = {("/camera/front/depth", stamp_ns): by_ns}
    moved = [
        replace(m, log_time_ns=m.log_time_ns + delays.get((m.channel.topic, m.log_time_ns), 0))
        for m in log.read(log.summarise(source))
    ]
    return write(path, moved)


def test_a_late_message_after_the_end_belongs_to_its_frame(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(8))
    tidy = list(opened(source).samples())
    late = opened(with_late_depth(source, tmp_path / "late.mcap", FRAMES - 1, 3 * STEP_NS + 1))
    arrived_ns = logs.START_NS + (FRAMES + 2) * STEP_NS + 1
    behind = [m for m in late.messages.copied() if m.log_time_ns >= late.messages.end_ns]
    assert [(m.channel.topic, m.log_time_ns) for m in behind] == [("/camera/front/depth", arrived_ns)]
    found = list(late.samples())
    assert [sample.frame.stamp_ns for sample in found] == [sample.frame.stamp_ns for sample in tidy]
    assert found[-1].frame.depth_image is not None
