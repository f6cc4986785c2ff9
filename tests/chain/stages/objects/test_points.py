"""The distance of a box by depth alone: ground, something in front, background, and a lidar's few points."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.points import measured_by_points, measured_of_class
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera
from roadperc_stream.model import Box, Detection
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE
from roadperc_stream.model.tag_tables import label_lookup
from tests.scenes import scene_of

CAMERA = Camera("camera", 320, 240, 320.0, 320.0, 159.5, 119.5)
PERSON = Detection("Pedestrian", Box(150, 102, 166, 136), 1.0)
"""1.7 m high at 16 m, with the camera 1.4 m above the road, less its feet."""


def measured(*objects, background_m=40.0, every=1):
    """The measured distance; objects are (distance, box), the last in front; one pixel of ``every`` has a depth."""
    rows = np.arange(240, dtype=np.float32)[:, None]
    depth = np.minimum(320 * 1.4 / np.maximum(rows - 119.5, 0.1), background_m) * np.ones((1, 320), np.float32)
    for distance_m, (x0, y0, x1, y1) in objects:
        depth[y0:y1, x0:x1] = distance_m
    sparse = np.full_like(depth, np.nan)
    sparse[::every, ::every] = depth[::every, ::every]
    return measured_by_points(ObjectsConfig(), CAMERA, sparse, np.inf, PERSON)


@pytest.mark.parametrize("every", [1, 3])
def test_ground_and_background_are_left_out(every):
    found = measured((16.0, (150, 102, 166, 147)), every=every)
    assert found.distance_m == pytest.approx(16.0, rel=0.02)
    assert found.std_m < 0.15 * 16.0


@pytest.mark.parametrize("every", [1, 3])
def test_a_post_in_front_of_the_box_is_left_out(every):
    found = measured((16.0, (150, 102, 166, 147)), (8.0, (164, 40, 172, 176)), every=every)
    assert found.distance_m == pytest.approx(16.0, rel=0.02)


def test_without_an_upright_surface_the_distance_is_uncertain():
    found = measured()
    assert found.distance_m is None or found.std_m > 0.15 * found.distance_m


def test_a_box_without_points_has_no_distance():
    nothing = np.full(CAMERA.size, np.nan, np.float32)
    assert measured_by_points(ObjectsConfig(), CAMERA, nothing, np.inf, PERSON).distance_m is None


CAR = Detection("Car", Box(100, 100, 160, 130), 1.0)
"""1.6 m high at 17 m."""
WHOLE = (17.0, range(2, 28, 5), range(2, 58, 4))
"""Distance, rows and columns in the box of a lidar's points on the car."""


def of_class(*groups, others=()):
    """The distance by groups (distance, rows, columns) of points in the box, each 1 % deeper at its far end."""
    distances_m = np.full(CAMERA.size, np.nan, np.float32)
    for distance_m, rows, columns in groups:
        u, v = np.meshgrid(columns, rows)
        distances_m[v + 100, u + 100] = distance_m * np.linspace(1.0, 1.01, u.size).reshape(u.shape)
    rows, columns = np.indices(CAMERA.size)
    lengths = np.hypot(np.hypot((columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy), 1.0)
    tags = np.full(CAMERA.size, TABLE.names.index("vehicle"), np.uint8)
    frame = scene_of(CAMERA, depth_m=(distances_m / lengths).astype(np.float32), source="lidar", tags=tags)
    corners = np.array(others, float).reshape(-1, 4).T
    return measured_of_class(ObjectsConfig(), frame, CAR, label_lookup(TABLE, "Car"), corners)


def test_points_of_a_nearer_car_in_a_corner_are_left_out():
    found = of_class(WHOLE, (8.0, range(20, 30, 4), range(0, 12, 4)))
    assert found.distance_m == pytest.approx(17.0, rel=0.01)
    assert found.std_m < 1.0


def test_points_in_the_box_of_a_nearer_car_are_its_points():
    """The nearer car hides most of this one, and has most points in this one's box."""
    front = (12.0, range(0, 30, 3), range(20, 60, 3))
    found = of_class(front, (17.0, range(2, 28, 5), range(2, 18, 4)), others=[(120, 90, 200, 150)])
    assert found.distance_m == pytest.approx(17.0, rel=0.01)
    assert of_class(front).distance_m == pytest.approx(12.0, rel=0.01)


def test_a_box_with_the_points_of_another_object_alone_is_uncertain_or_unknown():
    found = of_class((12.0, range(0, 30, 3), range(0, 60, 3)), others=[(90, 90, 200, 150)])
    assert found.distance_m is None or found.std_m > 1.5


def test_one_point_may_be_anywhere_on_the_car():
    few, many = of_class((17.0, (9,), (30,))), of_class(WHOLE)
    assert few.distance_m == pytest.approx(17.0)
    assert few.std_m > 1.0 > many.std_m


def test_two_groups_of_equal_size_are_two_hypotheses():
    found = of_class((17.0, range(2, 28, 5), range(2, 58, 4)), (22.0, range(3, 29, 5), range(2, 58, 4)))
    assert found.std_m > 1.0


def test_a_box_without_points_of_its_class_has_no_distance():
    assert of_class().distance_m is None
