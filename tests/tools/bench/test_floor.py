"""The floor contains the library calls of the chain only."""

import cv2
import pytest

import roadperc_stream as rp
from roadperc_stream.tools.bench import floor
from roadperc_stream.tools.bench.course import Times


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


def test_opencv_is_left_as_it_was(bench_logs):
    before = cv2.StereoSGBM, cv2.HoughLinesP, cv2.calcOpticalFlowPyrLK
    floor.perceive(bench_logs["png"].first_frame, Times())
    assert before == (cv2.StereoSGBM, cv2.HoughLinesP, cv2.calcOpticalFlowPyrLK)
