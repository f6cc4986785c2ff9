"""The course method agrees with the chain on the benchmark's logs, and with known results."""

import numpy as np
import pytest

from roadperc_stream.api import frames
from roadperc_stream.tools.bench import course
from roadperc_stream.tools.bench.course import Course, Times, merged, ransac_plane, read_messages

pytestmark = pytest.mark.long


def ego_lines(lines, shape):
    """The nearest (slope, intercept) left and right of the centre of the image's bottom."""
    at_bottom = (shape[0] - 1 - lines[:, 1]) / lines[:, 0] - shape[1] / 2
    return {
        "left": lines[np.where(at_bottom < 0, at_bottom, -np.inf).argmax()],
        "right": lines[np.where(at_bottom >= 0, at_bottom, np.inf).argmin()],
    }


@pytest.mark.parametrize("name", ["png", "jpeg"])
def test_plane_lines_and_drivable_road_are_those_of_the_chain(bench_logs, name):
    method = None
    for messages, frame in zip(read_messages(bench_logs[name].path), frames(bench_logs[name].path), strict=True):
        method = method or Course(messages, Times())
        own, result = method.step(messages), frame.result
        plane = own.plane * np.sign(own.plane[:3] @ result.surface.plane.n)
        assert np.degrees(np.arccos(min(plane[:3] @ result.surface.plane.n, 1.0))) < 0.01
        assert plane[3] == pytest.approx(result.surface.plane.offset_m, abs=0.001)
        assert own.drivable[result.drivable].mean() > 0.99
        assert [boundary.side for boundary in result.lanes.boundaries] == ["left", "right"]
        lines = ego_lines(own.lines, own.drivable.shape)
        for boundary in result.lanes.boundaries:
            slope, intercept = lines[boundary.side]
            x1, y1, x2, y2 = boundary.raw_px
            assert [(y1 - intercept) / slope, (y2 - intercept) / slope] == pytest.approx([x1, x2], abs=0.5)


def test_the_camera_moves_as_the_car_does(bench_logs):
    """10 m/s at 20 frames a second; the camera looks along z."""
    stream = read_messages(bench_logs["png"].path)
    first = next(stream)
    method = Course(first, Times())
    assert method.step(first).motion is None
    for messages in stream:
        assert method.step(messages).motion[:3, 3] == pytest.approx([0, 0, -0.5], abs=0.03)


def test_the_plane_of_most_points():
    rng = np.random.default_rng(1)
    points = rng.uniform(-10, 10, (3, 3000))
    points[1, :2000] = 1.4 + rng.normal(0, 0.005, 2000)
    plane = ransac_plane(points, rng)
    assert plane / np.sign(plane[1]) == pytest.approx([0, 1, 0, -1.4], abs=0.002)


def test_lines_of_nearly_one_slope_and_intercept_are_one():
    lines = merged(np.array([1.0, 1.05, -1.0, 1.0]), np.array([0.0, 10.0, 400.0, 60.0]), 40.0)
    assert lines == pytest.approx(np.array([[1.025, 5.0], [-1.0, 400.0], [1.0, 60.0]]))


def test_it_measures_every_part_after_the_first_frame(bench_logs):
    found = course.measure(bench_logs["stereo"].path, 2)
    parts = {name: value for name, value in found.items() if name.startswith("part/")}
    assert set(parts) == {f"part/{name}" for name in ("decode", "surface", "lanes", "objects", "odometry", "stereo")}
    assert all(value > 0 for value in parts.values())
    assert sum(parts.values()) <= found["cpu"]
