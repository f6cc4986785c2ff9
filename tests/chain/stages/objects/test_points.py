"""The distance of a box by depth alone: ground, something in front, background, and a lidar's few points."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.points import measured_by_points
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera
from roadperc_stream.model import Box, Detection

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
