"""Distances from the ground contact of boxes, on cars whose boxes and distances can be computed by hand."""

from dataclasses import replace
from math import hypot, radians

import numpy as np
import pytest

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages.objects.contact import contacts, ground_of, with_distances
from roadperc_stream.chain.stages.objects.tracker import ObjectsState, step
from roadperc_stream.chain.stages.surface.road import known_surface
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.model import Box, Detection, Object
from tests.analytic import STEP_NS, VEHICLE, Road
from tests.scenes import scene_of

CFG = ObjectsConfig()
ROAD = Road(width=1280, height=960)
UP = g.Plane.of(np.array([0.0, 0.0, 1.0]), 0.0)
LEVEL = known_surface("estimated", ROAD.camera, ROAD.ego_T_camera, UP)
GROUND = ground_of(LEVEL, radians(0.2), mounted=True)


def back(ahead_m, label="Pedestrian", left_m=0.0, width_m=1.8, height_m=1.5, road=ROAD):
    """The detection of an upright face on the road, at right angles to the camera's axis."""
    corners = np.array(
        [[ahead_m, left_m + side * width_m / 2, z] for side in (1, -1) for z in (0.0, height_m)], np.float64
    )
    pixels = g.project(road.camera, g.transform(g.inverse(road.ego_T_camera), corners)) + 0.5
    return Detection(label, Box(*pixels.min(axis=0), *pixels.max(axis=0)), 0.9)


def measured(*detections, ground=GROUND, camera=ROAD.camera, tags=None):
    objects = [Object(detection, kept=True) for detection in detections]
    return with_distances(camera, objects, contacts(scene_of(camera, tags=tags), ground, objects))


@pytest.mark.parametrize("ahead_m", [5.0, 12.0, 25.0])
@pytest.mark.parametrize("pitch", [0.0, 0.03])
def test_the_distance_is_that_of_the_nearest_point(ahead_m, pitch):
    road = replace(ROAD, pitch=pitch)
    ground = replace(GROUND, plane=road.plane)
    (item,) = measured(back(ahead_m, left_m=4.0, road=road), ground=ground)
    assert item.distance_m == pytest.approx(hypot(ahead_m, 3.1), rel=0.012)
    assert item.distance_source == "ground"


def test_a_vehicle_is_nearer_than_its_tyres():
    pedestrian, car = measured(back(12.0)) + measured(back(12.0, "Car"))
    assert pedestrian.distance_m - car.distance_m == pytest.approx(0.4)


@pytest.mark.parametrize("distance_m", [7.5, 15.0])
def test_a_box_that_ends_at_the_bumper_disagrees_with_the_tags(distance_m):
    """The box ends 0.3 m above the ground; the tags show the tyres at its ends, and road between them."""
    whole = back(distance_m, "Car").box_px
    rows_per_m = (whole.y_max - whole.y_min) / 1.5
    cut = replace(whole, y_max=whole.y_max - 0.3 * rows_per_m)
    tags = np.zeros(ROAD.camera.size, np.uint8)
    x0, y0, x1, y1 = whole.rounded(ROAD.camera.width, ROAD.camera.height)
    tags[y0:y1, x0:x1] = VEHICLE
    middle = (x1 - x0) // 4
    tags[y1 - round(0.2 * rows_per_m) : y1, x0 + middle : x1 - middle] = 0
    sure, agreed, doubtful = (
        measured(Detection("Car", box, 0.9), tags=seen)[0] for box, seen in ((cut, None), (whole, tags), (cut, tags))
    )
    off_m = doubtful.distance_m - distance_m
    assert agreed.distance_std_m == measured(back(distance_m, "Car"))[0].distance_std_m
    assert sure.distance_std_m < 0.5 * off_m < doubtful.distance_std_m


def test_the_cars_own_bonnet_has_no_distance():
    """Its box ends a few pixels above the image's lower border; a car farther ahead ends well above."""
    bonnet, car = (Detection("Car", Box(300, bottom - 160, 900, bottom), 0.9) for bottom in (956, 920))
    assert measured(bonnet)[0].distance_m is None
    assert measured(car)[0].distance_m < 4


def test_standard_deviations_grow_with_the_square_of_the_distance():
    ground = replace(GROUND, height_std=0.0)
    near, far = measured(back(10.0), ground=ground)[0], measured(back(20.0), ground=ground)[0]
    slope = radians(0.1)
    for item, z, rows in ((near, 10.0, 48.0), (far, 20.0, 24.0)):
        row = max(0.03 * 2 * rows, 1.0) / ROAD.camera.fy
        expected = z / 1.4 * hypot(z * row, z * radians(0.2), z * slope * (z / 3) ** 0.5, 0.1)
        assert item.distance_std_m == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("source", ["assumed", "held"])
def test_a_plane_that_is_not_estimated_has_a_larger_deviation(source):
    surface = replace(LEVEL, source=source)
    assert ground_of(surface, radians(0.2), mounted=True).pitch_std >= radians(0.3)
    assert ground_of(surface, 0.0, mounted=False).height_std == pytest.approx(0.1)


@pytest.mark.parametrize(
    "box",
    [
        Box(0.0, 400.0, 90.0, 600.0),
        Box(1200.0, 400.0, 1280.0, 600.0),
        Box(500.0, 300.0, 800.0, 960.0),
        Box(600.0, 400.0, 640.0, 470.0),
        Box(600.0, 460.0, 640.0, 490.0),
    ],
    ids=["left border", "right border", "lower border", "above the horizon", "too near to the horizon"],
)
def test_without_a_sure_contact_there_is_no_distance(box):
    (item,) = measured(Detection("Car", box, 0.9))
    assert (item.distance_m, item.distance_std_m) == (None, None)


@pytest.mark.parametrize(("left_m", "hidden"), [(0.2, True), (1.3, False), (5.0, False)])
def test_a_lower_edge_behind_nearer_boxes_is_no_contact(left_m, hidden):
    far, near = measured(back(20.0), back(15.0, left_m=left_m))
    assert (far.distance_m is None) == hidden
    assert near.distance_m is not None


def test_a_dropped_detection_hides_nothing():
    far, near = Object(back(20.0), kept=True), Object(back(15.0), kept=False)
    assert contacts(scene_of(ROAD.camera), GROUND, [far, near]).keys() == {0, 1}
    assert contacts(scene_of(ROAD.camera), GROUND, [far, replace(near, kept=True)]).keys() == {1}


def drive(speed_mps, frames=40, start_m=30.0, noise_px=0.5, pitch_error=0.0, seed=0, left_m=0.0):
    """The objects of a drive towards a car, with a constant error of the plane's pitch; the true distance at last."""
    rng, state, seen, ahead_m = np.random.default_rng(seed), ObjectsState(), [], start_m
    road = replace(ROAD, pitch=pitch_error)
    ground = replace(GROUND, plane=road.plane, pitch_std=radians(0.3))
    for frame in range(1, frames + 1):
        ahead_m -= speed_mps * STEP_NS / 1e9
        detection = back(ahead_m, "Car", left_m)
        noisy = np.array(
            [detection.box_px.x_min, detection.box_px.y_min, detection.box_px.x_max, detection.box_px.y_max]
        )
        detection = replace(detection, box_px=Box(*(noisy + rng.normal(0, noise_px, 4))))
        scene = scene_of(ROAD.camera, ROAD.ego_T_camera, stamp_ns=frame * STEP_NS, detections=(detection,))
        state, objects = step(CFG, state, scene, ground=ground)
        seen += objects.objects
    return seen, ahead_m - 0.4


def test_an_approach_has_a_time_to_impact_with_a_fitting_deviation():
    errors = []
    for seed in range(12):
        seen, distance_m = drive(10.0, seed=seed)
        errors.append((seen[-1].time_to_impact_s - (distance_m + 0.4) / 10.0) / seen[-1].time_to_impact_std_s)
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_growth_keeps_the_time_to_impact_right_under_a_wrong_pitch():
    """A pitch that is 0.4 degrees wrong makes the distance 8 % wrong, but not the growth."""
    seen, distance_m = drive(10.0, frames=20, pitch_error=radians(-0.4))
    item = seen[-1]
    assert abs(item.distance_m - distance_m) > 1.5
    assert item.time_to_impact_s == pytest.approx(distance_m / 10.0, rel=0.2)


def test_a_car_at_a_constant_distance_or_beside_the_path_has_no_time_to_impact():
    assert drive(0.0)[0][-1].time_to_impact_s is None
    beside = drive(10.0, left_m=4.0)[0][-1]
    assert (beside.in_path, beside.time_to_impact_s) == (False, None)
    assert beside.lateral_m == pytest.approx(4.0, abs=1.2)


def test_depth_ends_what_the_ground_began():
    state = ObjectsState()
    for frame, ground in ((1, GROUND), (2, GROUND), (3, None)):
        depth_m = np.full(ROAD.camera.size, 19.0, np.float32) if ground is None else None
        scene = scene_of(
            ROAD.camera, ROAD.ego_T_camera, stamp_ns=frame * STEP_NS, detections=(back(20.0, "Car"),), depth_m=depth_m
        )
        state, objects = step(CFG, state, scene, ground=ground)
        (track,) = state.tracks
        (item,) = objects.objects
        assert (track.growth is None, track.ground_share is None) == (ground is None, ground is None)
        assert item.distance_source == ("depth" if ground is None else "ground")


def test_a_box_that_a_nearer_one_touches_is_whole_but_not_clear():
    objects = [Object(d, kept=True) for d in (back(20.0), back(15.0, left_m=1.3), back(20.0, left_m=-6.0))]
    found = contacts(scene_of(ROAD.camera), GROUND, objects)
    assert {k: at.clear for k, at in found.items()} == {0: False, 1: True, 2: True}
