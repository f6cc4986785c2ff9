"""Compiled kernels read arrays without checks of their indices, so each refuses arrays of other sizes first."""

import numpy as np
import pytest

from roadperc_stream.kernels.lanes_plain import Following, Points, Weighing
from roadperc_stream.kernels.occupancy_plain import Cells, KnownPixels, Rays
from roadperc_stream.kernels.stereo_plain import DisparityLimits
from tests.kernels.forms import forms

FLOATS, MARKS = np.ones((4, 5), np.float32), np.ones((4, 5), np.uint8)
ROW = np.ones(4, np.float32)
FIRST, VALUES, WEIGHTS = np.zeros(5, np.intp), np.ones((5, 3)), np.ones(5)
PATCHES = MARKS, np.zeros((2, 2)), np.zeros((2, 2, 2)), MARKS, np.zeros((2, 2)), 4, 0.01
PIXELS = KnownPixels(FLOATS, None, MARKS, MARKS, np.zeros(256, np.uint8))
RAYS = Rays(np.ones((3, 5), np.float32), np.ones((3, 4), np.float32), np.ones(3, np.float32))
COUNTS = np.zeros((2, 2), np.int64), np.zeros((2, 2), np.int64)


def but(given, place, array):
    return (*given[:place], array, *given[place + 1 :])


def counting(pixels=PIXELS, rays=RAYS, counts=COUNTS):
    return Cells(0.0, -2.0, 0.5, 0.25, 2.0), pixels, rays, np.zeros(3, np.float32), *counts


def along(place, array):
    points = Points(*but((WEIGHTS, WEIGHTS, WEIGHTS, np.arange(5), WEIGHTS, WEIGHTS), place, array))
    return points, (0.0, 0.0, 0.0), Following(1.0, 12.0, 6.0, 40.0, True, 8, 3), Weighing(2.0, 24.0, 1e4)


REFUSED = {
    "surface": [
        ("median_places", (np.int32([0, 1]), np.float32([1, 2, 3]), 2)),
        ("median_places", (np.int32([0, 1, 2]), np.float32([1, 2, 3]), 2)),
        ("median_places", (np.int32([-1, 0, 1]), np.float32([1, 2, 3]), 2)),
        ("normal_equations", (FIRST, VALUES, WEIGHTS[:4], WEIGHTS, 9)),
        ("normal_equations", (FIRST - 1, VALUES, WEIGHTS, WEIGHTS, 9)),
        ("normal_equations", (FIRST + 7, VALUES, WEIGHTS, WEIGHTS, 9)),
        ("solve_band", (np.ones((1, 3)), np.ones(2))),
    ],
    "objects": [
        ("divided", (FLOATS, MARKS.T.copy(), ROW)),
        ("divided", (FLOATS[:0], MARKS[:0], ROW)),
        ("divided", (FLOATS, MARKS, ROW[:0])),
    ],
    "occupancy": [
        ("count_points", counting(PIXELS._replace(tags=MARKS[:, :2]))),
        ("count_points", counting(PIXELS._replace(drivable=MARKS[:, :2]))),
        ("count_points", counting(PIXELS._replace(height_m=FLOATS[:, 1:]))),
        ("count_points", counting(PIXELS._replace(depth_m=FLOATS[:, 1:], drivable=MARKS[:, 1:], tags=MARKS[:, 1:]))),
        ("count_points", counting(PIXELS._replace(obstacle_tags=np.zeros(9, np.uint8)))),
        ("count_points", counting(counts=(np.zeros((2, 2), np.int64), np.zeros((2, 3), np.int64)))),
    ],
    "odometry": [
        ("align_patches", but(PATCHES, place, array))
        for place, array in (
            (0, np.zeros((0, 9), np.uint8)),
            (1, np.zeros((1, 2))),
            (2, np.zeros((2, 2, 3))),
            (3, np.zeros((9, 0), np.uint8)),
            (4, np.zeros((1, 2))),
        )
    ],
    "stereo": [
        ("disparity_errors", (FLOATS, FLOATS[1:], MARKS > 0, DisparityLimits(50.0, 60.0, 3.0, 0.05))),
        ("refined_disparities", (np.zeros((4, 5), np.int16), MARKS[1:], MARKS, 3)),
        ("refined_disparities", (np.zeros((4, 5), np.int16), MARKS, MARKS[:, 1:], 3)),
        ("refined_disparities", (np.zeros((4, 5), np.int16), MARKS, MARKS, 4)),
    ],
    "lanes": [
        *(("follow", along(place, WEIGHTS[1:])) for place in (1, 2, 4, 5)),
        ("follow", along(3, np.arange(4))),
        ("follow", along(0, WEIGHTS.astype(np.float32))),
        ("follow", along(3, WEIGHTS)),
    ],
}


@pytest.mark.parametrize(
    ("room", "function", "given"), [(room, *case) for room, cases in REFUSED.items() for case in cases]
)
def test_arrays_of_other_sizes_and_types_are_refused(room, function, given):
    with pytest.raises(ValueError, match=r"expected|0 jumps|0x5 pixels|5x4 pixels|Buffer dtype mismatch"):
        getattr(forms(room)[1], function)(*given)
