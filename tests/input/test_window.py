"""The part of a log that is replayed: what arrives behind its end, and how often that is looked at."""

from dataclasses import replace

import pytest

from roadperc_stream import log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.time import TimeRange
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.input.window import WindowMessages
from roadperc_stream.log import LogWriter
from tests import logs
from tests.analytic import STEP_NS

FRAMES = 3


@pytest.fixture
def reads(monkeypatch):
    """First log time of every part of a log that is read."""
    asked, read = [], WindowMessages._read

    def noted(self, start_ns, *more):
        asked.append(start_ns)
        return read(self, start_ns, *more)

    monkeypatch.setattr(WindowMessages, "_read", noted)
    return asked


def opened(source):
    return open_input(ReplaySource(source, time_range=TimeRange(frames=FRAMES)), ReplayConfig())


def with_late_depth(source, path, frame, by_ns):
    """The log once more, the depth of a frame so much later."""
    stamp_ns = logs.START_NS + frame * STEP_NS
    delays = {("/camera/front/depth", stamp_ns): by_ns}
    moved = [
        replace(m, log_time_ns=m.log_time_ns + delays.get((m.channel.topic, m.log_time_ns), 0))
        for m in log.read(log.summarise(source))
    ]
    with LogWriter(path) as writer:
        for message in sorted(moved, key=lambda m: m.log_time_ns):
            writer.write(message)
    return path


def test_where_nothing_arrives_late_what_is_behind_the_end_is_looked_at_once(tmp_path, reads):
    log_in = opened(logs.write(tmp_path / "in.mcap", logs.items(8)))
    assert len(list(log_in.samples())) == FRAMES
    messages = list(log_in.messages())
    end_ns = logs.START_NS + FRAMES * STEP_NS
    assert log_in.plan.window.end_ns == end_ns
    assert max(message.log_time_ns for message in messages) < end_ns
    assert reads.count(end_ns) == 1


def test_what_arrives_behind_the_end_belongs_to_its_instant(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(8))
    tidy = list(opened(source).samples())
    late = opened(with_late_depth(source, tmp_path / "late.mcap", FRAMES - 1, 3 * STEP_NS + 1))
    arrived_ns = logs.START_NS + (FRAMES + 2) * STEP_NS + 1
    assert late.plan.window.late_until_ns == arrived_ns + 1
    behind = [m for m in late.messages() if m.log_time_ns >= late.plan.window.end_ns]
    assert [(m.channel.topic, m.log_time_ns) for m in behind] == [("/camera/front/depth", arrived_ns)]
    found = list(late.samples())
    assert [sample.frame.stamp_ns for sample in found] == [sample.frame.stamp_ns for sample in tidy]
    assert found[-1].frame.depth is not None
