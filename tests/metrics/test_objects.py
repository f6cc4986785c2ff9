"""Detections against true objects: their pairs, and the decisions of the filter."""

from dataclasses import replace

import pytest

from roadperc_stream import metrics as m
from roadperc_stream.metrics.objects import object_columns, same_kind, true_time_to_impact_s
from roadperc_stream.model import Object, Objects
from tests.analytic import box
from tests.metrics.frames import CFG, sample_and_result


def test_objects_are_matched_best_first_and_once():
    near, far = box("Car", 0, 0, 10, 10), box("Car", 1, 0, 11, 10)
    objects = Objects((Object(far, True, distance_m=5.0), Object(near, True, distance_m=3.5)))
    truth = Objects((Object(near, True, distance_m=3.0),))
    sample, result = sample_and_result(objects=truth)
    result = replace(result, objects=objects)
    rows, _ = m.object_metrics("id", sample, result)
    assert [row.true_distance_m for row in rows] == [None, 3.0]
    assert m.frame_metrics(CFG, "id", sample, result).object_distance_error_m == pytest.approx(0.5)


def test_dropped_objects_do_not_count():
    objects = Objects(
        (Object(box("Car", 0, 0, 9, 9), False, distance_m=2.0), Object(box("Bus", 20, 0, 29, 9), True, distance_m=7.0))
    )
    sample, result = sample_and_result()
    row = m.frame_metrics(CFG, "id", sample, replace(result, objects=objects))
    assert (row.nearest_object_m, row.nearest_object_class, row.detections_kept) == (7.0, "Bus", 1)


def judged(*objects, truth):
    sample, result = sample_and_result(objects=truth)
    result = replace(result, objects=Objects(objects))
    return m.frame_metrics(CFG, "id", sample, result), m.object_metrics("id", sample, result)[0]


def test_the_filter_is_counted_over_the_detections():
    """Two cars and a walker are true; one car is dropped, the walker is missed, and a false box is kept."""
    places = [box("Car", x, 0, x + 10, 10) for x in (0, 20, 40, 60, 80)]
    truth = Objects((Object(places[0], True), Object(places[1], True), Object(box("Pedestrian", 99, 0, 103, 9), True)))
    kept, dropped, false_kept, false_dropped, carried = places
    objects = [Object(kept, True), Object(dropped, False), Object(false_kept, True), Object(false_dropped, False)]
    row, rows = judged(*objects, Object(carried, True, status="tracked"), truth=truth)
    assert (row.filter_tp, row.filter_fp, row.filter_fn, row.filter_tn) == (1, 1, 1, 1)
    assert (row.filter_precision, row.filter_recall) == (0.5, 0.5)
    assert [r.is_true for r in rows] == [True, True, False, False, False]


def test_true_objects_without_a_detection_are_in_the_row():
    car = Object(box("Car", 0, 0, 10, 10), True, distance_m=5.0, lateral_m=-1.0)
    row, _ = judged(truth=Objects((car, replace(car, distance_m=None))))
    assert row.true_object_labels == ("Car",)
    assert (row.true_object_distances_m, row.true_object_laterals_m) == ((5.0,), (-1.0,))
    row, _ = judged(truth=Objects((car, replace(car, lateral_m=None))))
    assert (row.true_object_distances_m, row.true_object_laterals_m) == ((5.0, 5.0), ())


CAR = Object(box("Car", 0, 0, 10, 10), True, distance_m=5.0)


@pytest.mark.parametrize(
    ("kept", "truth", "counts", "shares", "is_true"),
    [
        (True, Objects((CAR,)), (1, 0, 0, 0), (1.0, 1.0), True),
        (True, None, (None,) * 4, (None, None), None),
        (False, Objects(()), (0, 0, 0, 1), (None, None), False),
    ],
    ids=["right", "no truth", "a share of nothing"],
)
def test_the_filter_is_judged_by_the_true_objects(kept, truth, counts, shares, is_true):
    row, rows = judged(replace(CAR, kept=kept), truth=truth)
    assert (row.filter_tp, row.filter_fp, row.filter_fn, row.filter_tn) == counts
    assert (row.filter_precision, row.filter_recall) == shares
    assert row.object_distance_error_m == (0.0 if is_true else None)
    assert rows[0].is_true is is_true


@pytest.mark.parametrize(
    ("in_path", "counted"), [((), 0), ((True, False, None), 1), ((False, None), 0), ((None, None), None)]
)
def test_objects_at_unknown_places_are_not_counted(in_path, counted):
    kept = tuple(Object(box("Car", 0, 0, 10, 10), kept=True, in_path=known) for known in in_path)
    assert object_columns(Objects(kept, path_source="straight")).objects_in_path == counted


def test_a_pedestrian_does_not_match_a_car():
    place = (0, 0, 10, 10)
    _, rows = judged(
        Object(box("Pedestrian", *place), True),
        Object(box("Van", 1, 0, 11, 10), True),
        truth=Objects((Object(box("Car", *place), True, distance_m=12.0),)),
    )
    assert [row.is_true for row in rows] == [False, True]
    assert [row.true_distance_m for row in rows] == [None, 12.0]


@pytest.mark.parametrize(
    ("label", "other", "same"),
    [("Car", "truck", True), ("Cyclist", "person", True), ("Car", "walker", False), ("Unicorn", "unicorn ", True)],
)
def test_kinds(label, other, same):
    assert same_kind(label, other) is same_kind(other, label) is same
    assert not same_kind("Unicorn", "Car")


@pytest.mark.parametrize(
    ("closing_mps", "said_s", "impact_s"), [(5.0, None, 4.0), (-5.0, None, None), (None, None, None), (5.0, 3.0, 3.0)]
)
def test_a_true_time_to_impact_is_the_distance_over_the_closing_speed(closing_mps, said_s, impact_s):
    detection = box("Car", 0, 0, 10, 10)
    true = Object(detection, True, distance_m=20.0, closing_speed_mps=closing_mps, time_to_impact_s=said_s)
    assert true_time_to_impact_s(true) == impact_s
    _, (row,) = judged(Object(detection, True), truth=Objects((true,)))
    assert (row.true_closing_speed_mps, row.true_time_to_impact_s) == (closing_mps, impact_s)


def test_a_place_is_at_the_distance_in_the_direction_of_the_box():
    """A box in the middle of the image is straight ahead of the camera, and one on the left is to the left."""
    sample, result = sample_and_result()
    camera, mount = sample.frame.camera, sample.frame.ego_T_camera[:3, 3]
    centre = box("Car", camera.cx - 4.5, camera.cy - 4.5, camera.cx + 5.5, camera.cy + 5.5)
    left = replace(
        centre, box_px=replace(centre.box_px, x_min=centre.box_px.x_min - 100, x_max=centre.box_px.x_max - 100)
    )
    objects = Objects((Object(centre, True, distance_m=7.0), Object(left, True, distance_m=7.0), Object(left, True)))
    ahead, aside, unknown = m.object_metrics("id", sample, replace(result, objects=objects))[1].objects
    assert ahead.x_m - mount[0] == pytest.approx(7.0, abs=0.1)
    assert ahead.y_m == pytest.approx(mount[1], abs=0.01)
    assert aside.y_m - mount[1] == pytest.approx(100 / camera.fx * (aside.x_m - mount[0]), rel=0.05)
    assert (unknown.x_m, unknown.y_m) == (None, None)


def test_a_true_object_knows_whether_a_kept_detection_of_the_frame_matches_it():
    cars = [Object(box("Car", x, 0, x + 10, 10), True, distance_m=5.0, track_id=f"car {x}") for x in (0, 20, 40, 60)]
    seen, dropped, carried, _ = cars
    sample, result = sample_and_result(objects=Objects(tuple(cars)))
    found = Objects((seen, replace(dropped, kept=False), replace(carried, status="tracked")))
    places = m.object_metrics("id", sample, replace(result, objects=found))[1]
    assert [item.detected for item in places.true_objects] == [True, False, False, False]
    assert [item.id for item in places.true_objects] == ["car 0", "car 20", "car 40", "car 60"]
    without, result = sample_and_result()
    assert m.object_metrics("id", without, result)[1].true_objects is None
