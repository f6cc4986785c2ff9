"""Messages in the order of their stamps: late ones, stragglers, recordings that begin anew."""

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.input.order import OrderConfig, StampOrder, _Segments
from tests.input.test_sync import CAMERA, MS, item

WAIT_MS = 200
CFG = OrderConfig("image", WAIT_MS * MS)


def in_stamp_order(items, cfg, drop):
    order = StampOrder(cfg, drop)
    yield from order.through(items)
    yield from order.rest()


def lateness_ns(items, cfg):
    """As a first pass measures it."""
    order = StampOrder(replace(cfg, lateness_ns=cfg.max_wait_ns), lambda _: None)
    assert list(order.through(items)) is not None
    return order.lateness_ns


def ordered(items, cfg=None):
    """Segment, role and stamp in milliseconds of what is given out, and what is left out."""
    arrived = sorted(items, key=lambda i: i.log_time_ns)
    left_out = []
    cfg = cfg or replace(CFG, lateness_ns=lateness_ns(arrived, CFG))
    given = list(in_stamp_order(arrived, cfg, left_out.append))
    return [(i.segment, i.role, i.stamp_ns // MS) for i in given], [(i.role, i.stamp_ns // MS) for i in left_out]


def images(*stamps, log_ms=None, segment=0):
    return [(segment, "image", stamp) for stamp in stamps]


def arriving(*stamps, role="image"):
    """Messages that arrive in this order, 10 ms apart."""
    return [item(role, stamp, 10 * number) for number, stamp in enumerate(stamps)]


def test_without_lateness_a_message_waits_only_for_the_next_image():
    items = iter([item("image", t) for t in range(0, 500, 50)])
    assert next(in_stamp_order(items, CFG, None)).stamp_ns == 0
    assert next(items).stamp_ns == 100 * MS


def test_a_late_image_is_sorted():
    items = [item("image", 0), item("image", 100), item("image", 50, 110), item("image", 150)]
    assert ordered(items) == (images(0, 50, 100, 150), [])


@pytest.mark.parametrize(("late_ms", "comes"), [(WAIT_MS, True), (WAIT_MS + 1, False)])
def test_a_message_may_be_as_late_as_the_wait(late_ms, comes):
    items = [item("image", 1000), item("image", 1000 - late_ms, 1010), item("image", 1050)]
    expected = images(1000 - late_ms, 1000, 1050) if comes else images(1000, 1050)
    assert ordered(items) == (expected, [] if comes else [("image", 1000 - late_ms)])


@given(st.lists(st.integers(0, WAIT_MS), min_size=120, max_size=120))
def test_any_delay_up_to_the_wait_changes_nothing(delays_ms):
    tidy = [item(role, t) for t in range(0, 2000, 50) for role in ("image", "depth", "segmentation")]
    late = [item(i.role, i.stamp_ns // MS, i.stamp_ns // MS + delay) for i, delay in zip(tidy, delays_ms, strict=True)]
    given, left_out = ordered(late)
    assert left_out == []
    assert Counter(given) == Counter(ordered(tidy)[0])
    assert [stamp for _, _, stamp in given] == sorted(stamp for _, _, stamp in given)


def test_latched_messages_come_first_among_equal_stamps():
    items = [item("image", 0), item("image", 50), item("calibration", 50, 51, CAMERA), item("image", 100)]
    assert ordered(items)[0] == [*images(0), (0, "calibration", 50), *images(50, 100)]


def test_a_late_calibration_holds_for_waiting_frames():
    items = [*(item("image", t) for t in (0, 500, 1000)), item("calibration", 10, 1001, CAMERA), item("image", 1500)]
    assert ordered(items) == ([*images(0, 500), (0, "calibration", 10), *images(1000, 1500)], [])


RECORDING = range(0, 1000, 50)


@pytest.mark.parametrize(
    ("stamps", "given", "stragglers"),
    [
        ((1000, 1050, 100, 1100, 1150), images(1000, 1050, 1100, 1150), (100,)),
        ((1000, 1050, 100, 150, 1100, 1150), images(1000, 1050, 1100, 1150), (100, 150)),
        ((1000, 1050, 150, 100, 1100, 1150), images(1000, 1050, 1100, 1150), (150, 100)),
        ((1000, 1050, 300, 200, 100, 1100, 1150), images(1000, 1050, 1100, 1150), (300, 200, 100)),
        ((1000, 1050, 0, 50, 100, 150), images(1000, 1050) + images(0, 50, 100, 150, segment=1), ()),
        ((1000, 1050, 500, 0, 50, 100), images(1000, 1050) + images(0, 50, 100, segment=1), (500,)),
        ([*RECORDING] * 3, [row for k in range(3) for row in images(*RECORDING, segment=k)], ()),
    ],
    ids=["one", "two", "two that fall", "three that fall", "three that ascend", "one before three", "played thrice"],
)
def test_three_ascending_images_begin_a_segment(stamps, given, stragglers):
    assert ordered(arriving(*stamps)) == (given, [("image", stamp) for stamp in stragglers])


HOUR = 3_600_000


@pytest.mark.parametrize(
    ("stamps", "given", "left"),
    [
        ((0, 50, HOUR + 50), images(0, 50, HOUR + 50), ()),
        ((0, HOUR + 1, HOUR + 51, HOUR + 101), images(0) + images(HOUR + 1, HOUR + 51, HOUR + 101, segment=1), ()),
        ((0, 50, HOUR + 51, HOUR + 101), images(0, 50) + images(HOUR + 51, HOUR + 101, segment=1), ()),
        ((0, 50, 9 * HOUR, 100, 150), images(0, 50, 100, 150), (9 * HOUR,)),
        ((0, 2 * HOUR, 4 * HOUR, 6 * HOUR), [row for k in range(4) for row in images(2 * k * HOUR, segment=k)], ()),
        (
            (9 * HOUR, 0, 50, 2 * HOUR, 2 * HOUR + 50),
            images(9 * HOUR) + images(0, 50, segment=1) + images(2 * HOUR, 2 * HOUR + 50, segment=2),
            (),
        ),
    ],
    ids=["an hour", "more", "at the end of the log", "a single image", "an image every two hours", "back and ahead"],
)
def test_a_jump_ahead_of_more_than_an_hour_begins_a_segment(stamps, given, left):
    assert ordered(arriving(*stamps)) == (given, [("image", stamp) for stamp in left])


def test_other_sensors_begin_no_segment_and_go_to_that_of_their_image():
    others = [item("depth", 9 * HOUR, 1), item("calibration", 0, 2, CAMERA), item("depth", 2 * HOUR, 15)]
    given, left = ordered([*arriving(10, 2 * HOUR, 2 * HOUR + 50, 2 * HOUR + 100), *others])
    assert [row for row in given if row[1] == "image"] == images(10) + images(
        2 * HOUR, 2 * HOUR + 50, 2 * HOUR + 100, segment=1
    )
    assert (1, "depth", 2 * HOUR) in given
    assert left == []


@pytest.mark.parametrize(
    "stamps",
    [
        (0, 0, 50, 100, 100, 100, 150),
        (0, 50, 0, 100, 50, 150, 100, 150),
        (1000, 1050, 0, 0, 50, 50, 100, 100),
        (0, 0, 2 * HOUR, 2 * HOUR, 2 * HOUR + 50, 2 * HOUR + 50, 2 * HOUR + 100, 2 * HOUR + 100),
    ],
    ids=["copies", "a second recorder, a frame later", "after a step back", "after a jump ahead"],
)
def test_the_first_of_images_with_equal_stamps_is_used(stamps):
    given, left = ordered(arriving(*stamps))
    assert [stamp for *_, stamp in given] == sorted(set(stamps), key=stamps.index)
    assert len(left) == len(stamps) - len(given)


def test_messages_around_a_segment_start_are_assigned_by_stamp():
    items = [
        *arriving(1000, 1050),
        item("depth", 0, 20),
        item("image", 0, 21),
        item("depth", 1050, 22),
        item("image", 50, 23),
        item("depth", 50, 24),
        item("image", 100, 25),
    ]
    given, left_out = ordered(items)
    assert given[:3] == [*images(1000, 1050), (0, "depth", 1050)]
    assert sorted(given[3:]) == sorted([(1, "depth", 0), (1, "depth", 50), *images(0, 50, 100, segment=1)])
    assert left_out == []


def test_messages_without_images_do_not_wait_forever():
    items = (item("depth", t) for t in range(0, 100_000, 50))
    stream = in_stamp_order(items, CFG, None)
    assert next(stream).stamp_ns == 0
    assert next(items).stamp_ns <= 3 * WAIT_MS * MS


def test_equal_log_times_without_images_do_not_pile_up():
    items = (item("depth", t, 0) for t in range(20_000))
    next(in_stamp_order(items, CFG, None))
    assert next(items).stamp_ns <= 10_002 * MS


@pytest.mark.parametrize("row", [[], [0, 50]], ids=["no image", "two images"])
def test_messages_with_earlier_stamps_do_not_wait_forever(row):
    """Its messages are given as they are, images that may begin a segment go on waiting for a third one."""
    images_back = [item("image", t, 5050 + t) for t in row]
    others = [item("depth", t, 5100 + t) for t in range(0, 40_000, 50)]
    held, most_held = _Segments(CFG, lambda _: None), 0
    given = list(held.numbered(item("image", 5000)))
    for one in [*images_back, *others]:
        given += list(held.numbered(one))
        most_held = max(most_held, len(held.held))
    assert most_held <= 10_000 / 50 + 2 + len(row)
    assert [i.role for i in held.row] == ["image"] * len(row)
    assert {i.segment for i in given} == {0}
    if row:
        (*_, third) = held.numbered(item("image", 100, 45_200))
        assert (third.role, third.segment) == ("image", 1)


def test_a_sensor_that_catches_up_during_a_pause_of_the_images_does_not_wait():
    held = _Segments(CFG, lambda _: None)
    times = [*range(0, 500, 50), *range(5000, 30_000, 50)]
    given = [list(held.numbered(one)) for one in [item("image", 5000), *(item("depth", t, 5000 + t) for t in times)]]
    assert len(given[-1]) == 1
    assert held.held == []


def image_every_50_ms(*times, late=0):
    return [item("image", t, t + late) for t in times]


PAUSING = (*range(5000, 6000, 50), *range(9000, 10_000, 50))
OTHERS = {
    "always too late": (
        image_every_50_ms(*range(0, 3000, 50)),
        [item("depth", t, t + 3 * WAIT_MS) for t in range(0, 2000, 50)],
    ),
    "ahead by seconds": (image_every_50_ms(*PAUSING), [item("depth", t + 3000, t) for t in range(0, 10_000, 50)]),
    "ahead by an hour": (image_every_50_ms(*PAUSING), [item("depth", t + 3_600_000, t) for t in range(0, 10_000, 50)]),
    "long before the images": (
        image_every_50_ms(*range(0, 3000, 50), late=5 * WAIT_MS),
        [item("depth", t) for t in range(0, 3000, 50)],
    ),
    "many of them": (
        [*(image_every_50_ms(*range(0, 1000, 50), *range(1050, 2000, 50))), item("image", 1000, 1000 + WAIT_MS)],
        [item("detections", t / 10) for t in range(20_000)],
    ),
}


@pytest.mark.parametrize("case", OTHERS)
def test_messages_of_another_sensor_do_not_affect_images(case):
    arrived, others = OTHERS[case]
    given, left_out = ordered([*others, *arrived])
    assert [row for row in given if row[1] == "image"] == images(*sorted(i.stamp_ns // MS for i in arrived))
    assert left_out == []


@pytest.mark.parametrize("late_ms", [0, 30, WAIT_MS])
def test_the_lateness_of_a_log_is_measured(late_ms):
    items = [item("image", t) for t in range(0, 1000, 50)] + [
        item("depth", t, t + late_ms + 1) for t in range(0, 700, 50)
    ]
    items += [item("image", 0, 999)]  # a straggler
    arrived = sorted(items, key=lambda i: i.log_time_ns)
    assert lateness_ns(arrived, CFG) // MS in range(late_ms // 50 * 50, late_ms + 51)
