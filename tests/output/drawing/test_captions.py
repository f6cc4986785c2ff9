"""Captions are inside the picture without overlap; the nearest objects choose first."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.model import Box, Object
from roadperc_stream.output.drawing.captions import (
    caption_places,
    label_places,
)
from tests.analytic import Road, box

SIZE = (320, 240)
CAMERA = Road(width=320, height=240).camera


def car(distance_m, corners=(100, 60, 140, 90), *, kept=True):
    return Object(box("Car", *corners), kept=kept, distance_m=distance_m)


def places(objects, text_size=(50.0, 10.0)):
    boxes = [item.detection.box_px for item in objects]
    return caption_places(SIZE, objects, boxes, [text_size] * len(objects))


@pytest.mark.parametrize(
    ("corners", "expected"),
    [
        ((100, 4, 140, 90), Box(100, 4, 150, 14)),
        ((-20, -30, 140, 90), Box(0, 0, 50, 10)),
        ((300, 60, 320, 90), Box(270, 50, 320, 60)),
        ((100, -9, 140, 300), Box(100, 0, 150, 10)),
    ],
)
def test_a_caption_is_inside_the_picture(corners, expected):
    assert places([car(5.0, corners)]) == (expected,)


def test_the_nearest_object_chooses_first():
    far, near, nowhere, middle = car(30.0), car(4.0), car(None), car(9.0)
    above, inside, below = Box(100, 50, 150, 60), Box(100, 60, 150, 70), Box(100, 90, 150, 100)
    assert places([far, near, nowhere, middle]) == (below, above, None, inside)


def labels(*objects, top_px=0.0, text_size=(50.0, 10.0)):
    boxes = [item.detection.box_px for item in objects]
    return label_places(SIZE, top_px, objects, boxes, [text_size] * len(objects))


def test_a_second_object_at_the_same_place_has_a_higher_label():
    far, near = labels(car(30.0), car(4.0))
    assert near == Box(100, 48.5, 150, 58.5)
    assert far == Box(100, 37, 150, 47)


def test_a_label_covers_only_dropped_objects():
    covered = (100, 50, 150, 59)
    assert labels(car(9.0), car(2.0, covered))[0] == Box(100, 25.5, 150, 35.5)
    assert labels(car(9.0), car(2.0, covered, kept=False))[0] == Box(100, 48.5, 150, 58.5)


def test_a_label_may_cover_a_large_object_around_its_own():
    assert labels(car(9.0), car(2.0, (20, 10, 300, 230)))[0] == Box(100, 48.5, 150, 58.5)


def test_without_space_above_the_label_is_inside_a_large_box_or_below_a_small_one():
    assert labels(car(5.0, (100, 4, 200, 90))) == (Box(101.5, 5.5, 151.5, 15.5),)
    assert labels(car(5.0, (100, 4, 120, 20))) == (Box(100, 21.5, 150, 31.5),)


def test_labels_leave_out_the_reserved_rows():
    assert labels(car(5.0), top_px=48.0) == (Box(100, 48.5, 150, 58.5),)
    assert labels(car(5.0), top_px=49.0) == (Box(100, 91.5, 150, 101.5),)


def test_a_text_too_large_for_the_picture_is_left_out():
    assert places([car(5.0)], (50.0, 241.0)) == labels(car(5.0), text_size=(50.0, 241.0)) == (None,)


coordinate = st.integers(-50, 350)


@given(st.lists(st.tuples(st.none() | st.floats(0, 100), *[coordinate] * 4, st.booleans()), max_size=12))
def test_captions_and_labels_are_inside_the_picture_without_overlap(rows):
    objects = [car(distance_m, corners, kept=kept) for distance_m, *corners, kept in rows]
    for top_px, placed in ((0, places(objects)), (30, labels(*objects, top_px=30.0))):
        found = [place for place in placed if place is not None]
        for index, place in enumerate(found):
            assert 0 <= place.x_min < place.x_max <= SIZE[0]
            assert top_px <= place.y_min < place.y_max <= SIZE[1]
            assert not any(place.overlap(other) for other in found[:index])
