"""Debug pictures show what the stages computed, where it is in the image."""

import cv2
import numpy as np
import pytest

from roadperc_stream.geometry import Camera
from roadperc_stream.model import Boundary, Correlation, Lanes, Matches, StereoDepth
from roadperc_stream.output.drawing.on_request import (
    disparity_picture,
    lanes_picture,
    matches_picture,
    template_picture,
)

WHITE, GREEN, MAGENTA, BLUE, RED = (255, 255, 255), (77, 230, 26), (255, 60, 255), (255, 204, 26), (60, 60, 255)
CAMERA = Camera("left", 320, 240, 100.0, 100.0, 159.5, 119.5)


def black(rows=240, columns=320):
    return np.zeros((rows, columns, 3), np.uint8)


def near(picture, colour):
    return (np.abs(picture.astype(int) - colour) <= 40).all(axis=-1)


def test_lines_lie_on_their_pixels_by_their_part():
    edges = np.zeros((240, 320), bool)
    edges[130, 300] = True
    lanes = Lanes(
        (Boundary("left", "measured", raw_px=(60.0, 240.0, 60.0, 120.0)), Boundary("right", "lost")),
        np.array([(200.0, 239.0, 200.0, 120.0)]),
        np.array([(240.0, 239.0, 240.0, 120.0)]),
        edges,
    )
    picture = lanes_picture(black(), lanes)
    assert near(picture, WHITE)[130, 300]
    assert near(picture, GREEN)[180, 60]
    assert near(picture, BLUE)[180, 200]
    assert near(picture, MAGENTA)[180, 240]
    assert not picture[180, [100, 150, 280]].any()


def test_lanes_without_edges_or_lines_are_the_dimmed_image():
    picture = lanes_picture(np.full((240, 320, 3), 200, np.uint8), Lanes(()))
    assert (picture[200:] == 90).all()


def test_inliers_and_outliers_end_where_they_are_now():
    px = np.array([(100, 100), (200, 200)], np.float32)
    matches = Matches(px - np.float32(40), px, np.array([True, False]))
    picture = matches_picture(black(), matches)
    assert near(picture, GREEN)[100, 100]
    assert near(picture, GREEN)[80, 80]
    assert near(picture, RED)[200, 200]
    assert near(picture, RED)[180, 180]


def search(scores):
    return Correlation(100, 60, (21, 11), np.asarray(scores, np.float32))


def test_the_heat_lies_at_the_middles_and_the_box_at_the_peak():
    scores = np.full((30, 40), -0.9)
    scores[20, 30] = 0.95
    picture = template_picture(black(), (search(scores),))
    assert (picture[65:80, 110:150] == picture[65, 110]).all()
    assert picture[85, 140, 2] > picture[65, 110, 2]
    assert not picture[60:240, :109].any()
    # The patch, 21 x 11, with its first pixel on column 130 and row 80.
    assert near(picture, WHITE)[80, 130:151].all()
    assert near(picture, WHITE)[90, 130:151].all()
    assert near(picture, WHITE)[80:91, [130, 150]].all()


def test_where_the_image_shows_nothing_there_is_no_heat_and_no_peak():
    assert not template_picture(black(), (search(np.full((30, 40), -np.inf)),))[20:].any()


def test_correlation_says_where_its_peak_is():
    scores = np.full((30, 40), -0.9)
    scores[20, 30] = 0.95
    box, score = search(scores).peak
    assert (box.x_min, box.y_min, box.x_max, box.y_max) == (130, 80, 151, 91)
    assert score == pytest.approx(0.95)
    assert search(scores).match(0.96) is None
    assert search(np.full((3, 4), -np.inf)).match(-1.0) is None


def test_disparity_is_black_where_unknown_and_the_same_colour_at_the_same_disparity():
    """With 100 px and 0.4 m the disparity is 40 px over the depth, and 20 px, of 2 m, has the last colour."""
    depth_m = np.full((240, 320), np.nan, np.float32)
    depth_m[100:120] = 4.0
    depth_m[120:140] = 2.0
    depth_m[140:160] = 1.0
    depth_m[160:180] = 40.0
    picture = disparity_picture(CAMERA, 0.4, StereoDepth("left", depth_m))
    assert not picture[50:100].any()
    assert not picture[180:].any()
    middle, last, beyond, far = (picture[row, 200] for row in (110, 130, 150, 170))
    np.testing.assert_array_equal(middle, cv2.applyColorMap(np.uint8([[128]]), cv2.COLORMAP_TURBO)[0, 0])
    np.testing.assert_array_equal(last, beyond)
    assert last[2] > 100 > last[0]
    assert far[0] > far[2]


def test_matches_must_fit_together():
    px = np.zeros((3, 2), np.float32)
    with pytest.raises(ValueError, match=r"inliers: expected bool \(3,\)"):
        Matches(px, px.copy(), np.zeros(2, bool))
