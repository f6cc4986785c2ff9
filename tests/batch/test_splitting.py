"""A log is cut so that every frame is in a part, and so that neighbours have frames in common, however they come."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.batch.splitting import LEAST_SHARED, SplitPart, parts_of, parts_of_log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.time import TimeRange, ns_to_seconds, seconds_to_ns
from roadperc_stream.errors import ConfigError
from roadperc_stream.input import ReplaySource, open_input
from tests.analytic import STEP_NS
from tests.logs import items, write

FIRST_NS = 1_700_000_000_123_456_789
S = 1_000_000_000


def looking_at(times_ns):
    return lambda start_ns, end_ns: [time_ns for time_ns in times_ns if start_ns <= time_ns < end_ns]


def every(step_s, until_s, first_ns=FIRST_NS):
    return [first_ns + seconds_to_ns(k * step_s) for k in range(int(until_s / step_s) + 1)]


def limits_ns(part, span_ns):
    """What TimeRange asks of a log, as the input counts it."""
    first_ns, last_ns = span_ns
    start_ns = first_ns if part.start_s is None else first_ns + seconds_to_ns(part.start_s)
    return start_ns, last_ns + 1 if part.end_s is None else first_ns + seconds_to_ns(part.end_s)


def frames_in(part, times_ns, span_ns):
    start_ns, end_ns = limits_ns(part, span_ns)
    return [time_ns for time_ns in times_ns if start_ns <= time_ns < end_ns]


@st.composite
def logs(draw):
    """Times of frames with any steps between them, pauses included, in a log that may be longer than they are."""
    steps_ns = draw(st.lists(st.sampled_from([S // 30, S // 10, S // 3, S, 4 * S, 37 * S]), min_size=3, max_size=120))
    times_ns = [FIRST_NS + draw(st.integers(0, 20 * S))]
    for step_ns in steps_ns:
        times_ns.append(times_ns[-1] + step_ns)
    return times_ns, (FIRST_NS, times_ns[-1] + draw(st.integers(0, 20 * S)))


@given(logs(), st.floats(2.5, 60.0), st.floats(0.0, 2.4))
def test_parts_cover_a_log_and_share_the_frames_they_say(log, split_s, overlap_s):
    times_ns, span_ns = log
    parts = parts_of(span_ns, split_s, looking_at(times_ns), overlap_s)
    assert [part.index for part in parts] == list(range(len(parts)))
    assert (parts[0].start_s, parts[0].shared_frames, parts[-1].end_s) == (None, 0, None)
    covered = [frames_in(part, times_ns, span_ns) for part in parts]
    assert sorted(set().union(*covered)) == times_ns
    for (one, other), (before, after) in zip(pairwise(parts), pairwise(covered), strict=True):
        shared = [time_ns for time_ns in after if time_ns in before]
        assert LEAST_SHARED <= len(shared) == other.shared_frames
        assert before[-len(shared) :] == after[: len(shared)] == shared
        assert limits_ns(one, span_ns)[0] < limits_ns(other, span_ns)[0] <= limits_ns(one, span_ns)[1]
        assert other.start_s <= one.end_s - overlap_s + 1e-9


@given(st.floats(1.0, 400.0), st.floats(2.5, 60.0))
def test_parts_have_the_length_asked_for_and_the_last_one_no_less_than_half(length_s, split_s):
    span_ns = FIRST_NS, FIRST_NS + seconds_to_ns(length_s)
    parts = parts_of(span_ns, split_s, looking_at(every(0.25, length_s)), 2.0)
    ends_s = [0.0, *(part.end_s for part in parts[:-1]), length_s]
    lengths_s = [end - start for start, end in pairwise(ends_s)]
    assert lengths_s[:-1] == pytest.approx([split_s] * (len(parts) - 1))
    if len(parts) > 1:
        assert split_s / 2 - 1e-6 <= lengths_s[-1] <= 1.5 * split_s + 1e-6
    else:
        assert length_s < 1.5 * split_s + 1e-6


def test_a_short_log_is_one_part_that_asks_for_the_whole():
    (part,) = parts_of((FIRST_NS, FIRST_NS + 14 * S), 10.0, looking_at(every(0.1, 14)), 2.0)
    assert part == SplitPart(0, None, None)
    assert part.time_range == TimeRange()
    assert part.warm_up_s(5.0) == 0.0


def test_known_parts():
    parts = parts_of((FIRST_NS, FIRST_NS + 35 * S), 10.0, looking_at(every(0.5, 35)), 2.0)
    assert parts == (
        SplitPart(0, None, 10.0),
        SplitPart(1, 8.0, 20.0, 4),
        SplitPart(2, 18.0, 30.0, 4),
        SplitPart(3, 28.0, None, 4),
    )
    assert [part.warm_up_s(5.0) for part in parts] == [0.0, 5.0, 5.0, 5.0]


def test_where_frames_are_rare_a_part_begins_at_the_third_last_before_the_cut():
    first, second, third = parts_of((FIRST_NS, FIRST_NS + 60 * S), 20.0, looking_at(every(3.0, 60)), 2.0)
    assert (first.end_s, second.start_s, second.shared_frames) == (20.0, 12.0, 3)
    assert (second.end_s, third.start_s, third.shared_frames) == (40.0, 33.0, 3)


def test_a_log_is_not_cut_where_the_camera_was_silent():
    times_ns = [*every(0.1, 12.0), *every(0.1, 20.0, FIRST_NS + 45 * S)]
    parts = parts_of((FIRST_NS, FIRST_NS + 65 * S), 10.0, looking_at(times_ns), 2.0)
    assert [part.end_s for part in parts] == [10.0, 20.0, 50.0, 60.0, None]
    assert parts[2].start_s == pytest.approx(11.8)


def test_a_log_is_not_cut_before_its_first_frames():
    times_ns = every(0.1, 30.0, FIRST_NS + 25 * S)
    parts = parts_of((FIRST_NS, FIRST_NS + 55 * S), 10.0, looking_at(times_ns), 2.0)
    assert [part.end_s for part in parts] == [30.0, 40.0, 50.0, None]


def test_what_is_asked_for_is_split_and_no_more():
    parts = parts_of((FIRST_NS, FIRST_NS + 60 * S), 10.0, looking_at(every(0.5, 60)), 2.0, TimeRange(5.0, 29.0))
    assert [(part.start_s, part.end_s) for part in parts] == [(5.0, 15.0), (13.0, 29.0)]
    assert parts[0].warm_up_s(3.0) == 3.0


@pytest.mark.parametrize("split_s", [2.0, 1.0, 0.0, -5.0, float("nan")])
def test_parts_that_are_all_overlap_are_refused(split_s):
    with pytest.raises(ConfigError, match=r"split .* expected more than 2 s"):
        parts_of((FIRST_NS, FIRST_NS + 60 * S), split_s, looking_at(every(0.1, 60)), 2.0)


def test_a_number_of_frames_is_refused():
    with pytest.raises(ConfigError, match="frames 7"):
        parts_of((FIRST_NS, FIRST_NS + 60 * S), 10.0, looking_at([]), 2.0, TimeRange(frames=7))


def test_times_come_from_the_log(tmp_path):
    made = items(frames=60)
    log_in = open_input(ReplaySource(write(tmp_path / "in.mcap", made)), cfg := ReplayConfig(sync={"max_wait_s": 0.1}))
    length_s = 59 * ns_to_seconds(STEP_NS)
    first, second = parts_of_log(log_in, cfg, length_s / 2)
    assert first.end_s == pytest.approx(length_s / 2)
    assert second.start_s == pytest.approx(length_s / 2 - 0.2)
    images_ns = [item.stamp_ns for item in made if item.role == "image"]
    span_ns = images_ns[0], images_ns[-1]
    assert second.shared_frames == len(
        set(frames_in(first, images_ns, span_ns)) & set(frames_in(second, images_ns, span_ns))
    )
