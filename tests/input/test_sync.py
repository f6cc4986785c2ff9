"""Messages to moments: pairing by stamp, late sensors, drops, what holds."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.core.config import SyncConfig
from roadperc_stream.core.datatypes import Transform
from roadperc_stream.core.geometry import Camera
from roadperc_stream.errors import ChannelError
from roadperc_stream.input.sync import Held, Stamped, SyncCounts, reference_role, synchronise

MS = 1_000_000
CFG = SyncConfig(tolerance_s=0.01, max_wait_s=1.0)
CAMERA = Camera("c", 10, 10, 5.0, 5.0, 4.5, 4.5)


def item(role, stamp_ms, log_ms=None, payload=None):
    payload = payload if payload is not None else SimpleNamespace(frame_id="c")
    return Stamped(role, round((stamp_ms if log_ms is None else log_ms) * MS), round(stamp_ms * MS), payload)


def run(items, roles=("image", "depth"), cfg=CFG):
    counts = SyncCounts()
    ordered = sorted(items, key=lambda i: i.log_time_ns)
    moments = list(synchronise(cfg, ordered, "image", roles, Held(), counts))
    return moments, counts


def stamps(moments):
    return [
        (m.reference.stamp_ns // MS, m.parts["depth"].stamp_ns // MS if "depth" in m.parts else None) for m in moments
    ]


def test_pairs_by_stamp_and_tells_the_skew():
    moments, counts = run([item("image", 0), item("depth", 3), item("image", 50), item("depth", 48)])
    assert stamps(moments) == [(0, 3), (50, 48)]
    assert [m.skew_ns for m in moments] == [3 * MS, 2 * MS]
    assert (counts.frames, counts.dropped) == (2, {})


def test_a_late_sensor_is_waited_for():
    moments, _ = run([item("image", 0), item("image", 50), item("depth", 0, 120), item("depth", 50, 170)])
    assert stamps(moments) == [(0, 0), (50, 50)]


def test_a_sensor_that_never_comes_is_not_waited_for_beyond_the_limit():
    items = [item("image", t) for t in range(0, 3000, 50)] + [item("depth", 0)]
    counts = SyncCounts()
    stream = synchronise(CFG, iter(items), "image", ("image", "depth"), Held(), counts)
    next(stream)
    assert len(list(stream)) == 59


def test_outside_the_tolerance_is_missing_and_counted():
    moments, counts = run([item("image", 0), item("depth", 20), item("image", 50), item("depth", 50)])
    assert stamps(moments) == [(0, None), (50, 50)]
    assert counts.dropped == {"depth": 1}


@pytest.mark.parametrize(("tolerance_s", "found"), [(0.019, None), (0.02, 20)])
def test_the_tolerance_is_set(tolerance_s, found):
    moments, _ = run([item("image", 0), item("depth", 20)], cfg=CFG.model_copy(update={"tolerance_s": tolerance_s}))
    assert stamps(moments) == [(0, found)]


@pytest.mark.parametrize(("max_wait_s", "found"), [(0.1, None), (0.3, 0)])
def test_how_long_a_late_sensor_is_waited_for_is_set(max_wait_s, found):
    """The depth comes 200 ms late, after the images of four more frames."""
    items = [*(item("image", t) for t in range(0, 201, 50)), item("depth", 0, 200.001)]
    moments, _ = run(items, cfg=CFG.model_copy(update={"max_wait_s": max_wait_s}))
    assert stamps(moments)[0] == (0, found)


def test_a_faster_sensor_is_thinned_out_and_counted():
    moments, counts = run([item("image", 0), item("image", 100), *[item("depth", t) for t in range(0, 101, 20)]])
    assert stamps(moments) == [(0, 0), (100, 100)]
    assert counts.dropped == {"depth": 4}


def test_every_reference_message_is_a_frame():
    moments, _ = run([item("image", t) for t in (0, 50, 100)], roles=("image",))
    assert len(moments) == 3
    assert moments[0].skew_ns is None


def test_without_images_a_long_stream_is_forgotten():
    items = [item("depth", t) for t in range(0, 60_000, 50)]
    counts = SyncCounts()
    assert list(synchronise(CFG, items, "image", ("image", "depth"), Held(), counts)) == []
    assert counts.dropped["depth"] == 1200


def test_calibration_holds_until_replaced():
    second = Camera("c", 10, 10, 7.0, 7.0, 4.5, 4.5)
    items = [
        item("calibration", 0, payload=CAMERA),
        item("image", 1),
        item("image", 50),
        item("calibration", 60, payload=second),
        item("image", 100),
    ]
    moments, _ = run(items, roles=("image", "calibration"))
    assert [m.held.cameras["calibration"].fx for m in moments] == [5.0, 5.0, 7.0]


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 400)), max_size=40))
def test_nothing_is_lost_nothing_is_used_twice(arrivals):
    items = [item("image", t) for t in range(0, 2000, 50)]
    items += [item("depth", 50 * k, 50 * k + delay) for k, delay in arrivals]
    moments, counts = run(items)
    used = [m.parts["depth"] for m in moments if "depth" in m.parts]
    assert len(moments) == 40
    assert len({id(part) for part in used}) == len(used)
    assert len(used) + counts.dropped["depth"] == len(arrivals)
    assert all(abs(m.parts["depth"].stamp_ns - m.reference.stamp_ns) <= 10 * MS for m in moments if "depth" in m.parts)


def edge(parent, child, x):
    T = np.eye(4)
    T[0, 3] = x
    return Transform(parent, child, T)


def test_transforms_chain_through_the_tree():
    tree = item("tf", 0, payload=(edge("ego", "rig", 1.0), edge("rig", "left", 2.0), edge("ego", "lidar", 5.0)))
    held = Held().updated(tree)
    assert held.lookup("ego", "left")[0, 3] == 3.0
    assert held.lookup("left", "lidar")[0, 3] == 2.0
    assert held.lookup("ego", "nowhere") is None
    assert held.updated(item("tf", 1, payload=(edge("ego", "rig", 4.0),))).lookup("ego", "left")[0, 3] == 6.0


def test_a_loop_of_transforms_is_refused():
    held = Held().updated(item("tf", 0, payload=(edge("a", "b", 1.0), edge("b", "a", 1.0))))
    with pytest.raises(ChannelError, match="frame 'a' hangs on itself"):
        held.lookup("a", "c")


@pytest.mark.parametrize(
    ("edges", "looped"),
    [
        ([("ego", "rig")], ()),
        ([("lidar", "lidar"), ("ego", "rig")], ("lidar",)),
        ([("a", "b"), ("b", "a"), ("b", "c")], ("b", "a")),
        ([("camera", "ego")], ("ego",)),
        ([("left", "camera"), ("camera", "left")], ("camera", "left")),
        ([("rig", "ego"), ("camera", "rig"), ("rig", "odom")], ("ego", "rig")),
        ([("odom", "camera"), ("camera", "ego")], ()),
    ],
)
def test_edges_of_a_loop_are_found_before_they_hold(edges, looped):
    held = Held().updated(item("tf", 0, payload=(edge("ego", "camera", 1.0),)))
    message = item("tf", 1, payload=tuple(edge(parent, child, 2.0) for parent, child in edges))
    assert held.in_loops(message) == looped


frame_names = st.sampled_from("abcdef")


@given(st.lists(st.lists(st.tuples(frame_names, frame_names), max_size=8), max_size=6))
def test_without_the_edges_of_loops_there_is_always_a_tree(messages):
    held = Held()
    for message in messages:
        transforms = item("tf", 0, payload=tuple(edge(parent, child, 1.0) for parent, child in message))
        looped = held.in_loops(transforms)
        kept = tuple(e for e in transforms.edges if e.child not in looped)
        held = held.updated(item("tf", 0, payload=kept))
        for name in "abcdef":
            held.lookup("a", name)


def test_reference_role():
    assert reference_role({"depth", "left"}) == "left"
    with pytest.raises(ChannelError, match="nothing to replay"):
        reference_role({"detections"})


def test_a_gap_longer_than_the_wait_does_not_rob_a_waiting_frame():
    """Without segmentation at the last frame before the gap, the frame keeps its depth."""
    items = [item("image", 0), item("depth", 0), item("seg", -50), item("image", 2500), item("depth", 2500)]
    items = [i if i.role != "seg" else item("segmentation", -50, 0) for i in items]
    moments, _ = run(items, roles=("image", "depth", "segmentation"))
    assert stamps(moments) == [(0, 0), (2500, 2500)]


def test_equal_log_times_do_not_pile_up():
    items = [item("image", t, 0) for t in range(300)]
    stream = synchronise(CFG, iter(items), "image", ("image", "depth"), Held(), SyncCounts())
    seen = sum(1 for _ in stream)
    assert seen == 300
