"""Detections filtered by tags, with ratios and distances computed by hand, and the choice of regions."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.filtering import choose, filter_detections
from roadperc_stream.chain.stages.objects.regions import Measured, Region
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera
from roadperc_stream.model import Absent, Box, Reason
from tests.analytic import VEHICLE, box
from tests.scenes import scene_of

CAMERA = Camera("camera", 100, 80, 50.0, 50.0, 50.0, 40.0)
CFG = ObjectsConfig()
LECTURE = ObjectsConfig(filter="class_ratio", distance_pixels="class")


SCORES = ((0.9, 0.1, 0.5), (0.1, 0.9, 0.5), (0.5, 0.5, 0.5))


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
    return filter_detections(cfg, scene, (detection,), {}).objects[0]


@pytest.mark.parametrize(
    ("x_min", "x_max", "ratio"), [(10, 50, 1 / 2), (10, 30, 1.0), (10, 31, 20 / 21), (-30, 30, 2 / 3)]
)
def test_the_ratio_is_the_share_of_the_class_in_the_half_open_box_within_the_image(x_min, x_max, ratio):
    item = filtered(box("Car", x_min, 20, x_max, 40))
    assert item.class_ratio == pytest.approx(ratio)
    assert item.kept


@pytest.mark.parametrize(("depth_m", "beyond"), [(np.nan, False), (65.535, True)])
def test_depth_that_is_unknown_or_beyond_the_range_is_no_distance(depth_m, beyond):
    item = filtered(box("Car", 10, 20, 30, 40), depth=np.full(CAMERA.size, depth_m, np.float32))
    assert (item.distance_m, item.beyond_range, item.kept) == (None, beyond, True)


@pytest.mark.parametrize(("rows", "kept"), [(3, False), (4, True)])
def test_the_class_ratio_must_exceed_the_minimum(rows, kept):
    tags = np.zeros(CAMERA.size, np.uint8)
    tags[:rows, 0] = VEHICLE
    assert filtered(box("Car", 0, 0, 1, 10), LECTURE, tags=tags).kept == kept


def test_box_outside_the_image_is_dropped_without_a_ratio():
    item = filtered(box("Car", 150, 20, 180, 40))
    assert (item.kept, item.class_ratio, item.distance_m) == (False, None, None)


def test_distance_is_along_the_ray():
    """Pixel (87.5 - 50) / 50 = 3 / 4 to the side at z = 4 m is 5 m away."""
    camera = Camera("camera", 100, 80, 50.0, 50.0, 49.5, 40.0)
    tags = np.full(camera.size, VEHICLE, np.uint8)
    depth = np.full(camera.size, np.nan, np.float32)
    depth[40, 87] = 4.0
    scene = scene_of(camera, tags=tags, depth_m=depth, limit_m=65.535)
    (item,) = filter_detections(CFG, scene, (box("Car", 80, 30, 95, 50),), {}).objects
    assert item.distance_m == pytest.approx(5.0)


@pytest.mark.parametrize(("place", "x_max", "pixels"), [((25, 45), 50, "box"), ((25, 15), 30, "class")])
def test_a_stray_pixel_counts_only_with_quantile_0(place, x_max, pixels):
    """Outside the class only if all pixels of the box count."""
    _, depth = pictures()
    depth[place] = 1.0
    car, minimum = box("Car", 10, 20, x_max, 40), ObjectsConfig(distance_pixels=pixels, distance_quantile=0.0)
    assert filtered(car, depth=depth).distance_m > 9
    assert filtered(car, minimum, depth=depth).distance_m < 1.3


def test_unknown_label_is_kept_without_a_ratio():
    item = filtered(box("Unicorn", 10, 20, 30, 40))
    assert (item.kept, item.class_ratio) == (True, None)
    assert item.distance_m is not None


def test_without_tags_everything_is_kept():
    _, depth = pictures()
    scene = scene_of(CAMERA, depth_m=depth, limit_m=65.535)
    (item,) = filter_detections(CFG, scene, (box("Car", 60, 50, 90, 70),), {}).objects
    assert (item.kept, item.class_ratio) == (True, None)


def test_without_detections_objects_are_absent_with_a_reason():
    assert filter_detections(CFG, scene_of(CAMERA), None, {}) == Absent(Reason("objects", "no_detections"))


def two_cars():
    """A car 10 m away that covers most of one 20 m away: boxes (10, 20) to (40, 50) and (30, 15) to (70, 40)."""
    tags, depth = np.zeros(CAMERA.size, np.uint8), np.full(CAMERA.size, 60.0, np.float32)
    tags[15:40, 30:70], depth[15:40, 30:70] = VEHICLE, 20.0
    tags[20:50, 10:40], depth[20:50, 10:40] = VEHICLE, 10.0
    return tags, depth


def judged(*boxes, expected=MappingProxyType({}), cfg=CFG, **inputs):
    tags, depth = two_cars()
    scene = scene_of(CAMERA, **{"tags": tags, "depth_m": depth, "limit_m": 65.535, **inputs})
    return filter_detections(cfg, scene, tuple(box("Car", *b) for b in boxes), expected).objects


def test_the_distance_is_not_that_of_a_nearer_object():
    near, far = judged((10, 20, 40, 50), (30, 15, 70, 40))
    assert (near.kept, far.kept) == (True, True)
    assert near.distance_m == pytest.approx(10.4, abs=0.5)
    assert far.distance_m == pytest.approx(20.5, abs=0.6)
    assert judged((30, 15, 70, 40), cfg=LECTURE)[0].distance_m < 11


def test_a_hidden_cars_box_is_dropped_unlike_in_the_lecture():
    hidden = (15, 22, 30, 36)
    assert [item.kept for item in judged((10, 20, 40, 50), hidden)] == [True, False]
    assert [item.kept for item in judged((10, 20, 40, 50), hidden, cfg=LECTURE)] == [True, True]


def test_the_second_box_of_one_object_is_dropped():
    assert [item.kept for item in judged((10, 20, 40, 50), (12, 20, 40, 50))] == [True, False]
    assert [item.kept for item in judged((12, 20, 40, 50), (10, 20, 40, 50))] == [False, True]


def test_the_score_has_no_effect():
    tags, depth = two_cars()
    scene = scene_of(CAMERA, tags=tags, depth_m=depth)
    boxes = ((10, 20, 40, 50), (15, 22, 30, 36), (30, 15, 70, 40))
    scored = [tuple(replace(box("Car", *b), score=s) for b, s in zip(boxes, scores, strict=True)) for scores in SCORES]
    assert len({tuple(i.kept for i in filter_detections(CFG, scene, found, {}).objects) for found in scored}) == 1


def test_beyond_the_depths_range_the_share_of_the_class_decides():
    """Beyond the range cars cannot be separated: they form one region, larger than any box."""
    tags, depth = np.zeros(CAMERA.size, np.uint8), np.full(CAMERA.size, 65.535, np.float32)
    tags[30:34, 10:60] = VEHICLE
    one, sparse = judged((20, 30, 28, 34), (40, 24, 48, 50), tags=tags, depth_m=depth)
    assert (one.kept, one.beyond_range, one.distance_m) == (True, True, None)
    assert not sparse.kept
    assert not judged((20, 30, 28, 34), tags=tags, depth_m=np.minimum(depth, 60.0))[0].kept


def test_a_car_before_the_depths_limit_is_separate_from_those_beyond():
    tags, depth = np.zeros(CAMERA.size, np.uint8), np.full(CAMERA.size, 65.535, np.float32)
    tags[30:36, 10:60], depth[30:36, 20:30] = VEHICLE, 64.5
    (item,) = judged((20, 30, 30, 36), tags=tags, depth_m=depth)
    assert item.kept
    assert 64.5 * np.hypot(1, 0.4) < item.distance_m < 64.5 * np.hypot(1, 0.6)


def test_a_new_object_needs_enough_pixels_of_its_class():
    tags, depth = pictures()
    assert judged((10, 20, 30, 40), tags=tags, depth_m=depth)[0].kept
    tags[21:], tags[20, 18:] = 0, 0
    assert not judged((10, 20, 30, 40), tags=tags, depth_m=depth)[0].kept


@pytest.mark.parametrize(("depth_m", "kept"), [(20.0, True), (60.0, False), (55.0, False)])
def test_an_object_with_displaced_tags_stands_out_in_depth(depth_m, kept):
    """Not if it is as far as its surroundings, or as high as a house."""
    tags, depth = np.zeros(CAMERA.size, np.uint8), np.full(CAMERA.size, 60.0, np.float32)
    tags[24:28, 35:41], depth[24:28, 30:36] = VEHICLE, depth_m
    item, hidden = judged((30, 24, 36, 28), (31, 24, 37, 28), tags=tags, depth_m=depth)
    assert (item.kept, hidden.kept) == (kept, False)
    assert item.distance_m == pytest.approx(21.0, abs=1.0) or not kept


def test_an_expected_object_needs_a_lower_fit():
    too_small = (15, 22, 30, 36)
    assert not judged(too_small)[0].kept
    assert judged(too_small, expected={0: Measured()})[0].kept


def test_instances_override_the_depth():
    """One instance contains both cars, which the depth would divide."""
    ids = np.full(CAMERA.size, 5, np.uint16)
    (item,) = judged((10, 15, 70, 50), instances=ids)
    assert item.kept
    assert item.distance_m == pytest.approx(10.4, abs=0.5)


@pytest.mark.parametrize("nothing", [np.nan, np.inf, 0.0])
def test_missing_depth_behind_an_object_keeps_its_deviation_finite(nothing):
    """A sensor without a return gives infinity (REP 118), NaN or 0."""
    ids = np.zeros(CAMERA.size, np.uint16)
    ids[20:50, 10:40] = 1
    tags, depth = two_cars()
    depth[tags == 0] = nothing
    depth[20:22, 10:40] = nothing
    (item,) = judged((10, 20, 40, 50), instances=ids, depth_m=depth, limit_m=np.inf)
    assert item.distance_m == pytest.approx(10.4, abs=0.5)
    assert 0 < item.distance_std_m < 1


def test_without_depth_the_share_of_the_class_decides():
    kept = [item.kept for item in judged((10, 20, 40, 50), (15, 22, 30, 36), (60, 45, 90, 70), depth_m=None)]
    assert kept == [True, True, False]


def test_the_deviation_grows_with_the_depths_noise():
    _, depth = two_cars()
    rng = np.random.default_rng(1)
    noisy = (depth * (1 + 0.02 * rng.standard_normal(depth.shape))).astype(np.float32)
    (clear,), (uncertain,) = judged((30, 15, 70, 40)), judged((30, 15, 70, 40), depth_m=noisy)
    assert uncertain.distance_std_m > 1.5 * clear.distance_std_m


PLACE = Box(10, 10, 30, 30)
NOTHING = (0.0, None)


def candidate(owner, fit, distance_m, box=PLACE):
    """A region whose number is its distance."""
    return Region(owner, box, fit, None, distance_m)


def measure(region):
    return Measured(region.number, 0.1)


def chosen(labels, *candidates):
    return [(fit, measured.distance_m) for fit, measured in choose(labels, candidates, measure, {})]


def test_each_detection_gets_its_best_region():
    ours, theirs = [candidate(0, 0.9, 10.0), candidate(0, 0.5, 20.0)], [candidate(1, 0.8, 20.0)]
    assert chosen(["Car", "Car"], ours, theirs) == [(0.9, 10.0), (0.8, 20.0)]


def test_a_chosen_region_is_not_chosen_again():
    hidden = [candidate(1, 0.8, 10.1), candidate(1, 0.4, 25.0)]
    assert chosen(["Car", "Car"], [candidate(0, 0.9, 10.0)], hidden) == [(0.9, 10.0), (0.4, 25.0)]
    assert chosen(["Car", "Car"], [candidate(0, 0.9, 10.0)], hidden[:1]) == [(0.9, 10.0), NOTHING]


def test_regions_differ_by_place_distance_or_kind():
    first = [candidate(0, 0.9, 10.0)]
    assert chosen(["Car", "Car"], first, [candidate(1, 0.8, 10.0, Box(40, 10, 60, 30))])[1] != NOTHING
    assert chosen(["Car", "Car"], first, [candidate(1, 0.8, 11.0)])[1] != NOTHING
    assert chosen(["Car", "Pedestrian"], first, [candidate(1, 0.8, 10.0)])[1] != NOTHING
    assert chosen(["Car", "Truck"], first, [candidate(1, 0.8, 10.0)])[1] == NOTHING


def test_regions_without_distances_are_all_different():
    assert chosen(["Car", "Car"], [candidate(0, 0.9, None)], [candidate(1, 0.8, None)]) == [(0.9, None), (0.8, None)]
    assert chosen([]) == []
    assert chosen(["Car"], []) == [NOTHING]


@pytest.mark.parametrize(("expected_m", "chosen_m"), [(None, 16.5), (12.5, 12.6), (16.0, 16.5), (30.0, 30.0)])
def test_the_expected_distance_decides_between_poor_fits(expected_m, chosen_m):
    regions = [candidate(0, 0.65, 16.5), candidate(0, 0.63, 12.6), candidate(0, 0.4, 30.0)]
    ((_, measured),) = choose(["Car"], [regions], measure, {0: Measured(expected_m)})
    assert measured.distance_m == chosen_m


def test_a_good_fit_outweighs_the_expected_distance():
    regions = [candidate(0, 0.95, 16.5), candidate(0, 0.6, 12.6)]
    ((_, measured),) = choose(["Car"], [regions], measure, {0: Measured(12.5)})
    assert measured.distance_m == 16.5
    assert measured.std_m > 1.0


def test_an_uncertain_region_gives_way_to_one_near_the_expected_distance():
    regions = [candidate(0, 0.66, 16.5), candidate(0, 0.63, 12.6)]
    stds_m = {16.5: 5.0, 12.6: 0.9}
    ((_, measured),) = choose(
        ["Car"], [regions], lambda region: replace(measure(region), std_m=stds_m[measure(region).distance_m]),
        {0: Measured(11.0, 1.0)},
    )  # fmt: skip
    assert measured.distance_m == 12.6


def test_the_deviation_covers_other_likely_regions():
    """The weights are the twelfth powers of the fits; a region that fits much worse does not count."""
    regions = [candidate(0, 0.72, 36.0), candidate(0, 0.70, 45.0), candidate(0, 0.4, 10.0)]
    ((_, measured),) = choose(["Car"], [regions], measure, {})
    share = 0.7**12 / (0.7**12 + 0.72**12)
    assert (measured.distance_m, measured.std_m) == (36.0, pytest.approx(share**0.5 * (45 - 36), rel=0.02))
    theirs = [candidate(1, 0.9, 45.0)]
    assert choose(["Car", "Car"], [regions, theirs], measure, {})[0][1] == Measured(36.0, 0.1)


def test_a_person_before_a_far_car_does_not_give_the_car_its_distance():
    """Wrong tags leave a part of the person in the car's box."""
    near = (12, 24, 20, 30)
    (car,) = judged((8, 22, 24, 34), expected={0: Measured(20.0, 0.2)}, tags=tags_of_part(near))
    assert (car.kept, car.distance_m, car.distance_std_m) == (True, None, None)
    (car,) = judged((8, 22, 24, 34), expected={0: Measured(12.0, 0.2)}, tags=tags_of_part(near))
    assert car.distance_m == pytest.approx(12.0, abs=0.5)


def tags_of_part(part):
    x0, y0, x1, y1 = part
    tags = np.zeros(CAMERA.size, np.uint8)
    tags[y0:y1, x0:x1] = VEHICLE
    return tags
