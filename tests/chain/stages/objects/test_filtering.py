"""Detections judged by tags: ratios counted by hand, distances by the 3-4-5 triangle."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.judge import judge
from roadperc_stream.core.config import ObjectsConfig
from roadperc_stream.core.datatypes import Absent
from roadperc_stream.core.geometry import Camera
from roadperc_stream.core.semantics import CARLA_BEFORE_0_9_14 as TABLE
from tests.analytic import VEHICLE, box

CAMERA = Camera("camera", 100, 80, 50.0, 50.0, 50.0, 40.0)
CFG = ObjectsConfig()


def scene(depth_m=10.0):
    tags = np.zeros(CAMERA.size, np.uint8)
    tags[20:40, 10:30] = VEHICLE
    return tags, np.full(CAMERA.size, depth_m, np.float32)


def judged(detection, cfg=CFG, tags=None, depth=None, limit_m=65.535):
    if tags is None:
        tags, _ = scene()
    if depth is None:
        _, depth = scene()
    return judge(cfg, (detection,), CAMERA, tags, TABLE, depth, limit_m).objects[0]


def test_half_a_box_of_vehicle():
    item = judged(box("Car", 10, 20, 50, 40))
    assert item.class_ratio == 0.5
    assert item.kept


def test_boxes_are_half_open():
    assert judged(box("Car", 10, 20, 30, 40)).class_ratio == 1.0
    assert judged(box("Car", 10, 20, 31, 40)).class_ratio == pytest.approx(20 / 21)


@pytest.mark.parametrize(("x_max", "kept"), [(76, True), (77, False)])
def test_share_must_exceed_the_minimum(x_max, kept):
    assert judged(box("Car", 10, 20, x_max, 40)).kept == kept


def test_exactly_the_minimum_is_not_enough():
    tags = np.zeros(CAMERA.size, np.uint8)
    tags[0:3, 0:1] = VEHICLE
    assert not judged(box("Car", 0, 0, 1, 10), tags=tags).kept


def test_box_outside_the_image_is_dropped_without_a_ratio():
    item = judged(box("Car", 150, 20, 180, 40))
    assert (item.kept, item.class_ratio, item.distance_m) == (False, None, None)


def test_box_is_clipped_to_the_image():
    assert judged(box("Car", -30, 20, 30, 40)).class_ratio == pytest.approx(20 / 30)


def test_distance_is_along_the_ray():
    """Pixel (87.5 - 50) / 50 = 3 / 4 to the side at z = 4 m is 5 m away."""
    camera = Camera("camera", 100, 80, 50.0, 50.0, 49.5, 40.0)
    tags = np.full(camera.size, VEHICLE, np.uint8)
    depth = np.full(camera.size, np.nan, np.float32)
    depth[40, 87] = 4.0
    (item,) = judge(CFG, (box("Car", 80, 30, 95, 50),), camera, tags, TABLE, depth, 65.535).objects
    assert item.distance_m == pytest.approx(5.0)


def test_only_pixels_of_the_class_count_unless_told():
    _, depth = scene()
    depth[25, 45] = 1.0
    assert judged(box("Car", 10, 20, 50, 40), depth=depth).distance_m > 9
    box_pixels = ObjectsConfig(distance_pixels="box", distance_quantile=0.0)
    assert judged(box("Car", 10, 20, 50, 40), box_pixels, depth=depth).distance_m < 1.2


def test_low_quantile_forgives_a_stray_pixel():
    _, depth = scene()
    depth[25, 15] = 1.0
    assert judged(box("Car", 10, 20, 30, 40), depth=depth).distance_m > 9
    minimum = ObjectsConfig(distance_quantile=0.0)
    assert judged(box("Car", 10, 20, 30, 40), minimum, depth=depth).distance_m < 1.3


def test_unknown_depth_is_no_distance():
    item = judged(box("Car", 10, 20, 30, 40), depth=np.full(CAMERA.size, np.nan, np.float32))
    assert (item.distance_m, item.beyond_range, item.kept) == (None, False, True)


def test_beyond_the_range_is_said():
    item = judged(box("Car", 10, 20, 30, 40), depth=np.full(CAMERA.size, 65.535, np.float32))
    assert (item.distance_m, item.beyond_range) == (None, True)


def test_unknown_label_is_kept_unjudged():
    item = judged(box("Unicorn", 10, 20, 30, 40))
    assert (item.kept, item.class_ratio) == (True, None)
    assert item.distance_m is not None


def test_without_tags_everything_is_kept():
    _, depth = scene()
    (item,) = judge(CFG, (box("Car", 60, 50, 90, 70),), CAMERA, None, None, depth, 65.535).objects
    assert (item.kept, item.class_ratio) == (True, None)


def test_no_detections_is_a_stated_absence():
    assert judge(CFG, None, CAMERA, None, None, None, 65.5) == Absent("no detections")
