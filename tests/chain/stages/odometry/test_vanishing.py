"""The pitch by the vanishing point of lines, and where it is refused."""

import cv2
import numpy as np
import pytest

from roadperc_stream.chain.stages.odometry.camera_pitch import LINES_STD, pitch_by_lines
from roadperc_stream.geometry import project
from tests.chain.stages.odometry.street import CAMERA, CFG, EGO_T_CAMERA, Shot, run

_SUBPIXEL_BITS = 6


def picture(stripes_px):
    """White polygons on grey."""
    image = np.full(CAMERA.size, 90, np.uint8)
    for corners in stripes_px:
        fixed = np.rint(np.array(corners) * 2**_SUBPIXEL_BITS).astype(np.int32)
        cv2.fillConvexPoly(image, fixed, 220, cv2.LINE_AA, _SUBPIXEL_BITS)
    return cv2.GaussianBlur(image, (0, 0), 0.8)


def stripe(start, end, end_width=1.0):
    """Corners of a stripe eight pixels wide at its start, and so many times that at its end."""
    start, end = np.array(start, float), np.array(end, float)
    half = np.array([4.0, 0.0]) if abs(end[1] - start[1]) > 1 else np.array([0.0, 4.0])
    return start - half, start + half, end + end_width * half, end - end_width * half


def stripes_to(point, sides=(-300, -200, -100, -40, 60, 140, 220, 310)):
    """Markings from the image's lower edge towards a point, which they do not reach."""
    bottom = [np.array([320.0 + side, 470.0]) for side in sides]
    return [stripe(start, start + 0.7 * (np.array(point) - start), 0.3) for start in bottom]


def point_at(elevation_deg, bearing=0.0):
    """The pixel of a direction so far above the horizon."""
    return project(CAMERA, np.array([bearing, -np.tan(np.deg2rad(elevation_deg)), 1.0]))


@pytest.mark.parametrize("elevation_deg", [-2.0, 0.0, 3.0])
@pytest.mark.parametrize("bearing", [0.0, 0.2])
def test_the_point_where_the_lines_meet_is_on_the_horizon(elevation_deg, bearing):
    pitch, variance = pitch_by_lines(CAMERA, EGO_T_CAMERA, picture(stripes_to(point_at(elevation_deg, bearing))), None)
    assert np.rad2deg(pitch) == pytest.approx(elevation_deg, abs=0.2)
    assert LINES_STD**2 <= variance < (2 * LINES_STD) ** 2


@pytest.mark.parametrize(
    "segments",
    [
        pytest.param([], id="no lines"),
        pytest.param(stripes_to(point_at(0.0), (-200, 200)), id="two lines"),
        pytest.param(stripes_to(point_at(15.0)), id="a point high above the horizon"),
        pytest.param([stripe((20, y), (620, y)) for y in range(260, 460, 25)], id="lines across the view"),
        pytest.param([stripe((x, 470), (x + 150, 300)) for x in range(10, 450, 50)], id="parallel in the image"),
    ],
)
def test_thin_support_is_refused(segments):
    assert pitch_by_lines(CAMERA, EGO_T_CAMERA, picture(segments), None) is None


def test_lines_that_cross_anywhere_are_refused():
    rng = np.random.default_rng(3)
    places, angles = rng.uniform((60, 60), (560, 400), (24, 2)), rng.uniform(0.3, 2.8, 24)
    segments = [stripe(p, p + 140 * np.array([np.cos(a), np.sin(a)])) for p, a in zip(places, angles, strict=True)]
    assert pitch_by_lines(CAMERA, EGO_T_CAMERA, picture(segments), None) is None


def test_lines_on_what_moves_do_not_count():
    image = picture(stripes_to(point_at(2.0)))
    assert pitch_by_lines(CAMERA, EGO_T_CAMERA, image, np.zeros(CAMERA.size, np.uint8)) is not None
    assert pitch_by_lines(CAMERA, EGO_T_CAMERA, image, np.ones(CAMERA.size, np.uint8)) is None


def test_the_first_frame_hears_the_lines_but_does_not_believe_them_alone():
    shot = Shot(picture(stripes_to(point_at(2.0))), np.full(CAMERA.size, 10.0, np.float32))
    (state,), _ = run([shot], depth=False)
    assert 0.8 * 2.0 < np.rad2deg(state.pitch.offset) < 2.2
    assert state.pitch.variance < LINES_STD**2
    assert not state.pitch.measured
    (with_depth,), _ = run([shot])
    assert with_depth.pitch.offset == 0.0
    (believed,), _ = run([shot], CFG.model_copy(update={"pitch_std_deg": 0.0}), depth=False)
    assert believed.pitch.offset == 0.0
