"""Messages to frames: pairing by stamp, late sensors, drops, what is latched."""

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.config import SyncConfig
from roadperc_stream.geometry import Camera
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.order import OrderConfig, StampOrder
from roadperc_stream.input.stream import Problems, RoleAssignment, decoded_messages
from roadperc_stream.input.sync import StampPairing, reference_of, skew_ns
from roadperc_stream.input.transforms import LatchedState
from roadperc_stream.log import Channel, Message
from roadperc_stream.model import Transform
from roadperc_stream.output import encoding

MS = 1_000_000
CAMERA = Camera("c", 10, 10, 5.0, 5.0, 4.5, 4.5)


def item(role, stamp_ms, log_ms=None, payload=None):
    payload = payload if payload is not None else SimpleNamespace(frame_id="c")
    log_ms = stamp_ms if log_ms is None else log_ms
    return Stamped(round(stamp_ms * MS), payload, role, round(log_ms * MS))


class Pass:
    """A pass over messages as a replay makes it."""

    def __init__(self, items, roles=("image", "depth"), tolerance_s=0.01, max_wait_s=1.0):
        ordered = sorted(items, key=lambda i: i.log_time_ns)
        self.left_out = []
        cfg = OrderConfig("image", round(max_wait_s * 1000) * MS)
        settings = SyncConfig(tolerance_s=tolerance_s)
        patient = replace(cfg, lateness_ns=cfg.max_wait_ns)
        first = StampOrder(patient, lambda _: None)
        assert sum(1 for _ in first.through(ordered)) <= len(ordered)
        cfg = replace(cfg, lateness_ns=first.lateness_ns)
        pairing = StampPairing(settings, cfg, roles, LatchedState(), self.left_out.append)
        self.frames = list(pairing.frames_of(ordered))

    @property
    def dropped(self):
        return Counter(item.role for item in self.left_out)


def run(items, **options):
    made = Pass(items, **options)
    return made.frames, made


def stamps(frames):
    return [(reference_of(m).stamp_ns // MS, m["depth"].stamp_ns // MS if "depth" in m else None) for m in frames]


def test_pairs_by_stamp_and_measures_the_skew():
    frames, synchroniser = run([item("image", 0), item("depth", 3), item("image", 50), item("depth", 48)])
    assert stamps(frames) == [(0, 3), (50, 48)]
    assert [skew_ns(m) for m in frames] == [3 * MS, 2 * MS]
    assert synchroniser.dropped == {}


def test_a_late_sensor_is_waited_for():
    frames, _ = run([item("image", 0), item("image", 50), item("depth", 0, 120), item("depth", 50, 170)])
    assert stamps(frames) == [(0, 0), (50, 50)]


def test_a_sensor_that_never_comes_is_not_waited_for():
    items = (item("image", t) for t in range(0, 3000, 50))
    drop = [].append
    cfg = OrderConfig("image", 1000 * MS)
    stream = StampPairing(SyncConfig(tolerance_s=0.01), cfg, ("image", "depth"), LatchedState(), drop).frames_of(items)
    next(stream)
    assert next(items).stamp_ns == 150 * MS  # the images of the two frames behind it show that nothing can come
    assert len(list(stream)) == 58


@pytest.mark.parametrize(("tolerance_s", "found"), [(0.019, None), (0.02, 20)])
def test_messages_outside_the_tolerance_are_missing_and_counted(tolerance_s, found):
    frames, synchroniser = run([item("image", 0), item("depth", 20)], tolerance_s=tolerance_s)
    assert stamps(frames) == [(0, found)]
    assert skew_ns(frames[0]) == (None if found is None else 20 * MS)
    assert synchroniser.dropped == ({"depth": 1} if found is None else {})


@pytest.mark.parametrize(("max_wait_s", "found"), [(0.1, None), (0.3, 0)])
def test_the_wait_for_a_late_sensor_is_configurable(max_wait_s, found):
    """The depth comes 200 ms late, after the images of four more frames."""
    items = [*(item("image", t) for t in range(0, 251, 50)), item("depth", 0, 200.001)]
    frames, _ = run(items, max_wait_s=max_wait_s)
    assert stamps(frames)[0] == (0, found)


def test_a_faster_sensor_is_thinned_out_and_counted():
    frames, synchroniser = run([item("image", 0), item("image", 100), *[item("depth", t) for t in range(0, 101, 20)]])
    assert stamps(frames) == [(0, 0), (100, 100)]
    assert synchroniser.dropped == {"depth": 4}


def test_without_images_a_long_stream_is_forgotten():
    items = [item("depth", t) for t in range(0, 60_000, 50)]
    frames, synchroniser = run(items)
    assert frames == []
    assert synchroniser.dropped["depth"] == 1200


def test_calibration_is_latched_until_replaced():
    second = Camera("c", 10, 10, 7.0, 7.0, 4.5, 4.5)
    items = [
        item("calibration", 0, payload=CAMERA),
        item("image", 1),
        item("image", 50),
        item("calibration", 60, payload=second),
        item("image", 100),
    ]
    frames, _ = run(items, roles=("image", "calibration"))
    assert [reference_of(m).latched.cameras["calibration"].fx for m in frames] == [5.0, 5.0, 7.0]


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 400)), max_size=40))
def test_every_message_is_used_once_or_counted(arrivals):
    items = [item("image", t) for t in range(0, 2000, 50)]
    items += [item("depth", 50 * k, 50 * k + delay) for k, delay in arrivals]
    frames, synchroniser = run(items)
    used = [m["depth"] for m in frames if "depth" in m]
    assert len(frames) == 40
    assert len({id(part) for part in used}) == len(used)
    assert len(used) + synchroniser.dropped["depth"] == len(arrivals)
    assert all(abs(m["depth"].stamp_ns - reference_of(m).stamp_ns) <= 10 * MS for m in frames if "depth" in m)


def test_a_long_gap_keeps_the_messages_of_a_waiting_frame():
    """Without segmentation at the last frame before the gap, the frame keeps its depth."""
    items = [item("image", 0), item("depth", 0), item("seg", -50), item("image", 2500), item("depth", 2500)]
    items = [i if i.role != "seg" else item("segmentation", -50, 0) for i in items]
    frames, _ = run(items, roles=("image", "depth", "segmentation"))
    assert stamps(frames) == [(0, 0), (2500, 2500)]


def test_equal_log_times_do_not_pile_up():
    items = [item("image", t, 0) for t in range(300)]
    assert len(run(items)[0]) == 300


def transforms(*edges, log_time_ns=1):
    edges = [Transform(parent, child, np.eye(4)) for parent, child in edges]
    data = encoding.encode_transforms(0, edges)
    return Message(Channel("/tf", "protobuf", "foxglove.FrameTransforms"), log_time_ns, log_time_ns, 0, data)


def test_cameras_and_transforms_are_latched_side_by_side():
    edges = (Transform("ego", "camera", np.eye(4)),)
    state = LatchedState().updated("calibration", CAMERA).updated("tf", edges)
    assert (state.cameras, list(state.tree.edges)) == ({"calibration": CAMERA}, ["camera"])


def test_transforms_that_close_a_loop_are_left_out_and_reported():
    problems = Problems()
    messages = [
        transforms(("ego", "camera")),
        transforms(("camera", "ego"), log_time_ns=5),
        transforms(("camera", "ego"), ("ego", "lidar"), log_time_ns=6),
    ]
    kept = decoded_messages(messages, RoleAssignment({"tf": "/tf"}), problems=problems)
    assert [[edge.child for edge in item.edges] for item in kept] == [["camera"], ["lidar"]]
    (text,) = problems.first.values()
    assert text == "/tf: message at 5 ns: a loop of transforms ('camera' to 'ego'), expected a tree: left out"
    assert not problems.counts
