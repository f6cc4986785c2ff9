"""Results are drawn into a camera image at their places."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.model import Absent, Boundary, Lanes, Object, Objects, Reason
from roadperc_stream.output.drawing.colours import DRIVABLE
from roadperc_stream.output.drawing.overlay import PerceivedFrame, draw_results
from tests.analytic import box

NOTHING = Absent(Reason("lanes", "not_run"))
GREEN, ORANGE, GREY = (77, 230, 26), (0, 128, 255), (165, 165, 165)


def black(rows=240, columns=320):
    return np.zeros((rows, columns, 3), np.uint8)


def lane(status, x=100.0, **more):
    line = np.array([(x, 239.0), (x, 120.0)])
    return Lanes((Boundary("left", status, line_px=line, **more),))


def draw_overlay(image, lanes, objects, drivable, width_px=None, top_px=0):
    width_px = image.shape[1] if width_px is None else width_px
    return draw_results(PerceivedFrame(image, lanes, objects, drivable), width_px, top_px)


def is_colour(drawn, colour):
    return (np.abs(drawn.astype(int) - colour) <= 2).all(axis=-1)


def test_without_results_the_image_is_unchanged():
    image = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
    drawn = draw_overlay(image, NOTHING, NOTHING, NOTHING)
    np.testing.assert_array_equal(drawn, image)
    assert not np.shares_memory(drawn, image)


def test_a_boundary_has_the_colour_of_its_status():
    for status, colour in (("measured", GREEN), ("held", ORANGE)):
        found = is_colour(draw_overlay(black(), lane(status), NOTHING, NOTHING), colour)
        rows, columns = np.nonzero(found)
        assert set(columns) <= set(range(98, 103))
        assert found[150, 100]
        assert rows.min() == pytest.approx(120, abs=2)
    assert not draw_overlay(black(), lane("lost"), NOTHING, NOTHING).any()


def test_the_raw_line_is_thin_dashed_and_on_top():
    """At one place, the smoothed line is visible between and beside the dashes of the raw line."""
    lanes = lane("measured", raw_px=(100.0, 240.0, 100.0, 120.0))
    drawn = draw_overlay(black(960, 1280), lanes, NOTHING, NOTHING)
    middle = drawn[122:236, 100].astype(int)
    dashed, smoothed = middle[:, 2] > 200, middle[:, 2] < 60
    assert dashed.sum() > 30
    assert (smoothed & (middle[:, 1] > 200)).sum() > 30
    # At least three dashes and two gaps.
    assert (np.diff(dashed.astype(int)) == 1).sum() >= 2
    in_dash = drawn[122:236, 92:109][dashed]
    assert ((in_dash[..., 1] > 150) & (in_dash[..., 2] < 60)).any(axis=1).all()


def test_labels_are_not_drawn_in_the_reserved_rows():
    objects = Objects((Object(box("Car", 80, 5, 200, 90), kept=True, class_ratio=1.0, distance_m=5.0),))
    drawn = draw_overlay(np.full((240, 320, 3), 255, np.uint8), NOTHING, objects, NOTHING, top_px=40)
    plate = is_colour(drawn, (25, 25, 25))
    assert plate.any()
    assert not plate[:40].any()


def test_a_smaller_copy_has_the_results_at_scaled_places():
    objects = Objects((Object(box("Car", 200, 80, 260, 160), kept=True, class_ratio=1.0),))
    drawn = draw_overlay(black(), lane("measured"), objects, NOTHING, width_px=160)
    assert drawn.shape == (120, 160, 3)
    found = is_colour(drawn, GREEN)
    assert found[100, 49:51].any()
    assert found[60, 100]
    assert found[60, 129] or found[60, 130]
    assert not found[60, 105:125].any()


def test_only_drivable_pixels_are_tinted():
    mask = np.zeros((240, 320), bool)
    mask[200:] = True
    drawn = draw_overlay(black(), NOTHING, NOTHING, mask)
    assert not drawn[:200].any()
    assert (drawn[200:] == drawn[-1, -1]).all()
    blue, green, red = drawn[-1, -1].astype(int)
    assert blue > green > red > 0
    np.testing.assert_allclose(np.array((red, green, blue)) / blue, np.array(DRIVABLE) / DRIVABLE[2], atol=0.03)


def test_kept_boxes_are_solid_and_dropped_ones_dashed():
    for kept, colour in ((True, GREEN), (False, GREY)):
        objects = Objects((Object(box("Car", 40, 100, 240, 200), kept=kept, class_ratio=0.5),))
        edge = is_colour(draw_overlay(black(), NOTHING, objects, NOTHING), colour)[199, 42:238]
        assert edge.all() == kept
        assert edge.any()


def test_text_is_legible_and_labels_do_not_overlap():
    """Every label has a dark plate of 11 rows or more; three boxes at one place have three separate plates."""
    same = [Object(box("Car", 80, 160, 140, 220), kept=True, class_ratio=1.0, distance_m=float(m)) for m in (5, 9, 20)]
    for rows, columns in ((240, 320), (960, 1280)):
        white = np.full((rows, columns, 3), 255, np.uint8)
        plates = is_colour(draw_overlay(white, NOTHING, Objects(tuple(same)), NOTHING), (25, 25, 25)).astype(np.uint8)
        closed = cv2.morphologyEx(plates, cv2.MORPH_CLOSE, np.ones((1, 9), np.uint8))
        count, _, stats, _ = cv2.connectedComponentsWithStats(closed)
        assert count - 1 >= 3
        assert stats[1:, cv2.CC_STAT_HEIGHT].min() >= 11


coordinates = st.floats(-1e9, 1e9) | st.just(np.nan) | st.just(np.inf)


@settings(max_examples=60)
@given(
    st.integers(1, 90),
    st.integers(1, 120),
    st.none() | st.integers(1, 200),
    st.lists(st.tuples(coordinates, coordinates), max_size=4),
    st.tuples(*[st.floats(-500, 500)] * 4),
    st.booleans(),
)
def test_any_result_is_drawn_into_any_image(rows, columns, width, points, corners, kept):
    lanes = Lanes((Boundary("right", "measured", line_px=np.array(points, float).reshape(-1, 2)),))
    objects = Objects((Object(box("Löwe <b>", *corners), kept=kept, distance_m=1.0, time_to_impact_s=2.0),))
    drawn = draw_overlay(black(rows, columns), lanes, objects, np.ones((rows, columns), bool), width_px=width)
    assert drawn.dtype == np.uint8
    assert drawn.shape[1] == (columns if width is None else width)
