"""Detections filtered by tags: ratios counted by hand, distances by the 3-4-5 triangle."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.filtering import filter_detections
from roadperc_stream.core.config import ObjectsConfig
from roadperc_stream.core.datatypes import Absent, Reason
from roadperc_stream.core.geometry import Camera
from tests.analytic import VEHICLE, box
from tests.scenes import scene_of

CAMERA = Camera("camera", 100, 80, 50.0, 50.0, 50.0, 40.0)
CFG = ObjectsConfig()


def pictures(depth_m=10.0):
    tags = np.zeros(CAMERA.size, np.uint8)
    tags[20:40, 10:30] = VEHICLE
    return tags, np.full(CAMERA.size, depth_m, np.float32)


def filtered(detection, cfg=CFG, tags=None, depth=None, limit_m=65.535):
    if tags is None:
        tags, _ = pictures()
    if depth is None:
        _, depth = pictures()
    scene = scene_of(CAMERA, tags=tags, depth_m=depth, limit_m=limit_m)
    return filter_detections(cfg, scene, (detection,)).objects[0]


def test_half_a_box_of_vehicle():
    item = filtered(box("Car", 10, 20, 50, 40))
    assert item.class_ratio == 0.5
    assert item.kept


def test_boxes_are_half_open():
    assert filtered(box("Car", 10, 20, 30, 40)).class_ratio == 1.0
    assert filtered(box("Car", 10, 20, 31, 40)).class_ratio == pytest.approx(20 / 21)


@pytest.mark.parametrize(("x_max", "kept"), [(76, True), (77, False)])
def test_share_must_exceed_the_minimum(x_max, kept):
    assert filtered(box("Car", 10, 20, x_max, 40)).kept == kept


def test_exactly_the_minimum_is_not_enough():
    tags = np.zeros(CAMERA.size, np.uint8)
    tags[0:3, 0:1] = VEHICLE
    assert not filtered(box("Car", 0, 0, 1, 10), tags=tags).kept


def test_box_outside_the_image_is_dropped_without_a_ratio():
    item = filtered(box("Car", 150, 20, 180, 40))
    assert (item.kept, item.class_ratio, item.distance_m) == (False, None, None)


def test_box_is_clipped_to_the_image():
    assert filtered(box("Car", -30, 20, 30, 40)).class_ratio == pytest.approx(20 / 30)


def test_distance_is_along_the_ray():
    """Pixel (87.5 - 50) / 50 = 3 / 4 to the side at z = 4 m is 5 m away."""
    camera = Camera("camera", 100, 80, 50.0, 50.0, 49.5, 40.0)
    tags = np.full(camera.size, VEHICLE, np.uint8)
    depth = np.full(camera.size, np.nan, np.float32)
    depth[40, 87] = 4.0
    scene = scene_of(camera, tags=tags, depth_m=depth, limit_m=65.535)
    (item,) = filter_detections(CFG, scene, (box("Car", 80, 30, 95, 50),)).objects
    assert item.distance_m == pytest.approx(5.0)


def test_only_pixels_of_the_class_count_by_default():
    _, depth = pictures()
    depth[25, 45] = 1.0
    assert filtered(box("Car", 10, 20, 50, 40), depth=depth).distance_m > 9
    box_pixels = ObjectsConfig(distance_pixels="box", distance_quantile=0.0)
    assert filtered(box("Car", 10, 20, 50, 40), box_pixels, depth=depth).distance_m < 1.2


def test_low_quantile_forgives_a_stray_pixel():
    _, depth = pictures()
    depth[25, 15] = 1.0
    assert filtered(box("Car", 10, 20, 30, 40), depth=depth).distance_m > 9
    minimum = ObjectsConfig(distance_quantile=0.0)
    assert filtered(box("Car", 10, 20, 30, 40), minimum, depth=depth).distance_m < 1.3


def test_unknown_depth_is_no_distance():
    item = filtered(box("Car", 10, 20, 30, 40), depth=np.full(CAMERA.size, np.nan, np.float32))
    assert (item.distance_m, item.beyond_range, item.kept) == (None, False, True)


def test_beyond_the_range_is_reported():
    item = filtered(box("Car", 10, 20, 30, 40), depth=np.full(CAMERA.size, 65.535, np.float32))
    assert (item.distance_m, item.beyond_range) == (None, True)


def test_unknown_label_is_kept_without_a_ratio():
    item = filtered(box("Unicorn", 10, 20, 30, 40))
    assert (item.kept, item.class_ratio) == (True, None)
    assert item.distance_m is not None


def test_without_tags_everything_is_kept():
    _, depth = pictures()
    scene = scene_of(CAMERA, depth_m=depth, limit_m=65.535)
    (item,) = filter_detections(CFG, scene, (box("Car", 60, 50, 90, 70),)).objects
    assert (item.kept, item.class_ratio) == (True, None)


def test_no_detections_is_a_stated_absence():
    assert filter_detections(CFG, scene_of(CAMERA), None) == Absent(Reason("objects", "no_detections"))
