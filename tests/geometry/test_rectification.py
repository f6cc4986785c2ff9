"""Maps and boxes of a lens against OpenCV's projection of points in space."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from roadperc_stream import geometry as g
from roadperc_stream.geometry import rectification as r
from roadperc_stream.geometry.rotations import rotation_from_rpy

PINHOLE = g.Camera("camera", 320, 240, 200.0, 205.0, 158.0, 121.0)
TURN = tuple(rotation_from_rpy(0.01, -0.02, 0.015).ravel().tolist())
LENSES = {
    "plumb_bob": (-0.3, 0.12, 0.001, -0.002, -0.02),
    "rational_polynomial": (0.4, -0.1, 0.001, 0.0, 0.02, 0.7, 0.05, -0.01),
    "equidistant": (-0.05, 0.01, -0.004, 0.001),
    "fisheye": (0.02, 0.0, 0.0, 0.0),
}


def behind(model, R=g.Lens.R):
    return replace(PINHOLE, distortion=LENSES[model], lens=g.Lens(190.0, 192.0, 160.0, 118.0, R, model))


def seen(camera, pixels):
    """(N, 2) pixels in the camera's image of points whose rectified pixels are given."""
    rays = g.rays(PINHOLE, np.asarray(pixels, float)) @ r.rotation_of(camera)
    project = cv2.fisheye.projectPoints if camera.lens.model in r.FISHEYE_MODELS else cv2.projectPoints
    points = np.ascontiguousarray(rays.reshape(-1, 1, 3))
    return project(points, np.zeros(3), np.zeros(3), camera.lens.K, np.array(camera.distortion))[0].reshape(-1, 2)


@pytest.mark.parametrize("R", [g.Lens.R, TURN], ids=["straight", "turned"])
@pytest.mark.parametrize("model", LENSES)
def test_maps_and_pixels_are_those_of_the_lens(model, R):
    camera = behind(model, R)
    pixels = np.array([[40.0, 30.0], [158.0, 121.0], [300.0, 200.0], [20.0, 220.0]])
    columns, rows, valid = r.rectification_maps(camera, r.rectified(camera))
    found = np.array([(columns[int(y), int(x)], rows[int(y), int(x)]) for x, y in pixels])
    np.testing.assert_allclose(found, seen(camera, pixels), atol=2e-3)
    np.testing.assert_allclose(r.rectified_pixels(camera, r.rectified(camera), seen(camera, pixels)), pixels, atol=0.05)
    inside = (columns >= 0) & (columns <= 319) & (rows >= 0) & (rows <= 239)
    np.testing.assert_array_equal(valid, inside)


def test_values_that_cannot_be_mixed_are_those_of_the_nearest_pixel():
    camera = behind("plumb_bob")
    tags = np.random.default_rng(0).choice(np.array([3, 200], np.uint8), (240, 320))
    assert set(np.unique(r.resampled(camera, r.rectified(camera), tags, nearest=True))) <= {0, 3, 200}
    wide = replace(camera, fx=50.0, fy=50.0)  # the rectified image shows more than the lens
    depth_m = r.resampled(wide, r.rectified(wide), np.full((240, 320), 7.0, np.float32), nearest=True)
    assert np.isnan(depth_m[0, 0])
    assert depth_m[120, 160] == 7.0


def test_a_box_encloses_its_curved_sides():
    camera = behind("plumb_bob")
    x_min, y_min, x_max, y_max = r.rectified_box(camera, r.rectified(camera), (60.0, 90.0, 120.0, 150.0))
    sides = [(x, y) for x in np.linspace(59.5, 119.5, 99) for y in (89.5, 149.5)]
    sides += [(x, y) for y in np.linspace(89.5, 149.5, 99) for x in (59.5, 119.5)]
    found = r.rectified_pixels(camera, PINHOLE, np.array(sides)) + 0.5
    assert (x_min, y_min) == pytest.approx(tuple(found.min(axis=0)), abs=0.02)
    assert (x_max, y_max) == pytest.approx(tuple(found.max(axis=0)), abs=0.02)


def test_without_a_lens_a_box_stays():
    assert r.rectified_box(PINHOLE, PINHOLE, (1.0, 2.0, 30.0, 40.0)) == pytest.approx((1, 2, 30, 40))
    assert r.rectified_box(PINHOLE, PINHOLE, (-9.0, 2.0, 400.0, 240.0)) == pytest.approx((0, 2, 320, 240))


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"distortion": (0.1,) * 5}, "lens_coefficient_count"),
        ({"lens": g.Lens(190, 192, 160, 118, model="division")}, "lens_model_unknown"),
        ({"lens": g.Lens(190, 192, 160, 118, (1.0,) * 9)}, "lens_rotation_invalid"),
        ({"lens": g.Lens(np.nan, 192, 160, 118)}, "lens_without_camera_matrix"),
        ({"distortion": (1e9,) * 4}, "lens_coefficient_size"),
    ],
)
def test_a_lens_that_cannot_be_undone_has_a_reason(changes, code):
    assert r.lens_fault(replace(behind("equidistant"), **changes))[0] == code


def test_a_camera_with_distortion_alone_has_the_lens_of_its_own_intrinsics():
    camera = replace(PINHOLE, distortion=LENSES["plumb_bob"])
    assert not r.is_rectified(camera)
    assert r.lens_fault(camera) is None
    assert r.lens_of(camera) == g.Lens(200.0, 205.0, 158.0, 121.0, ())
