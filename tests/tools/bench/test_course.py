"""The course method agrees with the chain on the benchmark's logs, and with known results."""

import numpy as np
import pytest

from roadperc_stream.errors import LogError
from roadperc_stream.model import Boundary
from roadperc_stream.tools.bench import agreement, course
from roadperc_stream.tools.bench.agreement import ego_lines, lines_apart_px, plane_difference, require_agreement
from roadperc_stream.tools.bench.course import (
    Course,
    CourseResult,
    Times,
    merged,
    ransac_plane,
    read_messages,
)

pytestmark = pytest.mark.long


@pytest.mark.parametrize("name", ["png", "jpeg"])
def test_plane_lines_and_drivable_road_are_those_of_the_chain(bench_logs, name, monkeypatch):
    """Within a tenth of the limits, and with both lines in every frame."""
    for limit, value in (("TILT_DEG", 0.01), ("HEIGHT_M", 0.001), ("COLUMNS", 0.5 / 320)):
        monkeypatch.setattr(agreement, f"LARGEST_{limit}", value)
    monkeypatch.setattr(agreement, "LEAST_COVERED", 0.99)
    found = []
    apart_px = agreement.lines_apart_px
    monkeypatch.setattr(agreement, "lines_apart_px", lambda *results: found.append(apart_px(*results)) or found[-1])
    require_agreement(bench_logs[name].path, 4)
    assert [len(lines) for lines in found] == [2] * 4


def test_another_plane_is_refused(bench_logs, monkeypatch):
    monkeypatch.setattr(course, "ransac_plane", lambda *_: np.array([0.0, 1.0, 0.0, -1.5]))
    with pytest.raises(LogError, match=r"frame 0: the plane heights differ by 0\.1 m, expected at most 0\.01"):
        require_agreement(bench_logs["png"].path, 1)


def test_other_lines_are_refused(bench_logs, monkeypatch):
    monkeypatch.setattr(agreement, "ego_lines", lambda *_: (np.array([-1.0, 300.0]), None))
    with pytest.raises(LogError, match="frame 0: the lane lines differ by"):
        require_agreement(bench_logs["png"].path, 1)


def test_the_camera_moves_as_the_car_does(bench_logs):
    """10 m/s at 20 frames a second; the camera looks along z."""
    stream = read_messages(bench_logs["png"].path)
    first = next(stream)
    method = Course(first, Times())
    assert method.step(first).motion is None
    for messages in stream:
        motion = method.step(messages).motion
        assert motion[:3, 3] == pytest.approx([0, 0, -0.5], abs=0.03)


def test_the_plane_of_most_points():
    rng = np.random.default_rng(1)
    points = rng.uniform(-10, 10, (3, 3000))
    points[1, :2000] = 1.4 + rng.normal(0, 0.005, 2000)
    plane = ransac_plane(points, rng)
    assert plane / np.sign(plane[1]) == pytest.approx([0, 1, 0, -1.4], abs=0.002)


def test_lines_of_nearly_one_slope_and_intercept_are_one():
    lines = merged(np.array([1.0, 1.05, -1.0, 1.0]), np.array([0.0, 10.0, 400.0, 60.0]), 40.0)
    assert lines == pytest.approx(np.array([[1.025, 5.0], [-1.0, 400.0], [1.0, 60.0]]))


def test_the_ego_lane_lies_between_the_nearest_lines():
    at_bottom = np.array([10.0, 90.0, 120.0, 300.0])
    slopes = np.array([-1.0, -2.0, 2.0, 1.0])
    lines = np.column_stack((slopes, 99 - slopes * at_bottom))
    left, right = ego_lines(lines, (100, 200))
    assert left[0] == -2.0
    assert right[0] == 2.0
    assert ego_lines(lines[:1], (100, 200))[1] is None


def test_differences_of_known_results():
    plane = np.array([0.0, np.cos(0.01), np.sin(0.01), -1.4])
    tilt_deg, height_m = plane_difference(-plane, np.array([0.0, 1.0, 0.0, -1.45]))
    assert tilt_deg == pytest.approx(np.degrees(0.01))
    assert height_m == pytest.approx(0.05)
    found = CourseResult(plane, np.ones((100, 60), bool), np.array([[-2.0, 100.0], [2.0, 0.0]]), [], None)
    boundary = Boundary(side="left", status="measured", raw_px=(1.0, 100.0, 20.0, 50.0))
    assert lines_apart_px(found, (boundary,)) == [5.0]


def test_it_measures_every_part_after_the_first_frame(bench_logs):
    found = course.measure(bench_logs["stereo"].path, 2)
    parts = {name: value for name, value in found.items() if name.startswith("part/")}
    assert set(parts) == {f"part/{name}" for name in ("decode", "surface", "lanes", "objects", "odometry", "stereo")}
    assert all(value > 0 for value in parts.values())
    assert sum(parts.values()) <= found["cpu"]
