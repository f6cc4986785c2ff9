import numpy as np
import pytest

from roadperc_stream.geometry import Camera, project, rigid, transform
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.tools.layouts.boxes import box_distance_m

CAMERA = Camera("camera_front", 16, 12, 8.0, 8.0, 7.5, 5.5)
"""Sees 45 degrees to the left and right."""


@pytest.mark.parametrize(
    ("middle_m", "size_m", "distance_m"),
    [
        ((0, 0, 10), (2, 2, 4), 8.0),
        ((0, 3, 10), (2, 4, 4), np.hypot(8, 1)),
        ((2, 0, 0), (2, 2, 4), np.sqrt(2)),  # its nearest point, at 1 m, is beside the view
        ((0, 0, -5), (2, 2, 2), 4.0),  # outside the view
        ((0, 0, 1), (4, 4, 4), 0.0),  # around the camera
    ],
)
def test_the_distance_is_that_of_the_nearest_point_in_view(middle_m, size_m, distance_m):
    pose = rigid(np.eye(3), np.array(middle_m, float))
    assert box_distance_m(CAMERA, pose, np.array(size_m, float)) == pytest.approx(distance_m, abs=1e-9)


def test_no_point_of_a_turned_box_in_view_is_nearer():
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 41)] * 3), axis=-1).reshape(-1, 3)
    for _ in range(8):
        size_m, turns = rng.uniform(0.5, 4, 3), rng.uniform(-3, 3, 3)
        pose = rigid(rotation_from_rpy(*turns), rng.uniform((-6, -2, 4), (6, 2, 20)))
        points = transform(pose, grid * size_m)
        points = points[points[:, 2] > 0]
        inside = (np.abs(project(CAMERA, points) - (7.5, 5.5)) <= (8, 6)).all(axis=1)
        if inside.any():
            nearest = np.linalg.norm(points[inside], axis=1).min()
            assert nearest - 0.25 < box_distance_m(CAMERA, pose, size_m) <= nearest + 1e-9
