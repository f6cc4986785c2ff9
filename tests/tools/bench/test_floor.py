"""What is measured as unavoidable is what the chain does."""

import cv2
import numpy as np
import pytest

import roadperc_stream as rp
from roadperc_stream.config import OdometryConfig
from roadperc_stream.tools.bench import floor
from roadperc_stream.tools.bench.course import Times
from roadperc_stream.tools.bench.tracking_floor import Tracking


@pytest.fixture(scope="module")
def result(bench_logs, tmp_path_factory):
    path = tmp_path_factory.mktemp("floor") / "out.mcap"
    rp.replay(bench_logs["stereo"].path, path)
    return path


def test_parts_of_a_log_with_a_pair(bench_logs, result):
    found = floor.measure(bench_logs["stereo"].path, result)
    parts = {name: value for name, value in found.items() if name != "cpu"}
    names = ("inflate", "decode", "track", "hough", "disparity", "serialise")
    assert set(parts) == {f"part/{name}" for name in names}
    assert all(value > 0 for value in parts.values())
    assert found["cpu"] == pytest.approx(sum(parts.values()))


def test_a_log_without_a_pair_has_no_disparity(bench_logs, result):
    assert "part/disparity" not in floor.measure(bench_logs["png"].path, result)


def test_the_disparities_are_those_the_chain_tries(bench_logs):
    """f = 160, 0.5 m apart, 1.4 m high, nearest road 120 rows below: 160 * 0.5 * 120 / 160 / 1.4 = 43, a tenth more."""
    assert floor.disparities_of(bench_logs["stereo"].path) == 48
    assert floor.disparities_of(bench_logs["png"].path) == 0


def shifted(grey, columns):
    return np.ascontiguousarray(np.roll(grey, columns, axis=1))


def test_tracking_follows_a_shift_and_begins_anew_where_it_is_large():
    grey = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (480, 640), np.uint8), (7, 7), 2)
    K, depth_m, times = np.array([[640.0, 0, 320], [0, 640, 240], [0, 0, 1]]), np.full((480, 640), 10.0), Times()
    tracking = Tracking(OdometryConfig(), K, times)
    for columns in (0, 3, 6):
        tracking.step(shifted(grey, columns), depth_m)
    assert tracking.keyframes == 1
    assert times.ms["track"] > 0
    for columns in range(9, 48, 3):
        tracking.step(shifted(grey, columns), depth_m)
    assert tracking.keyframes == 2
