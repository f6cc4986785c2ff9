"""Known answers and properties of cameras, transforms and planes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream import geometry as g
from roadperc_stream.geometry.rotations import rotation_from_rpy

CAMERA = g.Camera("camera", 640, 480, 320.0, 320.0, 319.5, 239.5)
ANGLES = st.floats(-1.0, 1.0)
METRES = st.floats(-50.0, 50.0)


def test_points_in_front_of_the_camera_have_a_pixel_and_points_behind_it_have_nan():
    np.testing.assert_allclose(g.project(CAMERA, np.array([3.0, 4.0, 5.0])), [319.5 + 192, 239.5 + 256])
    assert np.isnan(g.project(CAMERA, np.array([1.0, 1.0, -2.0]))).all()


@given(st.floats(0, 639), st.floats(0, 479), st.floats(0.1, 200))
def test_unproject_inverts_project(u, v, z):
    point = g.unproject(CAMERA, np.array([u, v]), np.array(z))
    np.testing.assert_allclose(g.project(CAMERA, point), [u, v], atol=1e-6)


@given(ANGLES, ANGLES, ANGLES, METRES, METRES)
def test_inverse_undoes_a_transform(roll, pitch, yaw, x, y):
    T = g.rigid(rotation_from_rpy(roll, pitch, yaw), np.array([x, y, 1.0]))
    np.testing.assert_allclose(g.inverse(T) @ T, np.eye(4), atol=1e-9)


@given(ANGLES, ANGLES)
def test_camera_pitch_and_roll_are_those_of_the_mounting(roll, pitch):
    ego_T_camera = g.rigid(rotation_from_rpy(roll, pitch, 0.3) @ g.EGO_R_OPTICAL, np.array([0, 0, 1.5]))
    road = g.transform_plane(g.inverse(ego_T_camera), g.Plane.of(np.array([0, 0, 1.0]), 0.0))
    assert g.camera_pitch_roll(road) == pytest.approx((pitch, roll), abs=1e-9)
    assert road.offset_m == pytest.approx(1.5)


def test_fit_plane_uses_the_chosen_points_and_needs_three():
    square = np.array([[0, 0, 0], [1, 0, 0.1], [0, 1, 0], [1, 1, 0.1]], float)
    plane = g.facing(g.fit_plane(square), np.array([0, 0, 5.0]))
    np.testing.assert_allclose(plane.n, np.array([-0.1, 0, 1]) / np.hypot(1, 0.1), atol=1e-12)
    assert plane.distance(square) == pytest.approx(0.0, abs=1e-12)
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 9]], float)
    plane = g.fit_plane(points, np.array([True, True, True, False]))
    assert abs(plane.n[2]) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="three points, got 2"):
        g.fit_plane(np.zeros((2, 3)))


def test_plane_distance_equals_that_of_the_points():
    rng = np.random.default_rng(0)
    depth = rng.uniform(1, 50, CAMERA.size).astype(np.float32)
    depth[3, 4] = np.nan
    plane = g.Plane.of(np.array([0.02, -1.0, 0.03]), 1.4)
    rows, columns = np.indices(CAMERA.size, dtype=float)
    points = g.unproject(CAMERA, np.stack((columns, rows), axis=-1), depth)
    column, row = g.distance_per_depth(CAMERA, plane)
    found = depth * (row[:, None] + column[None, :]) + np.float32(plane.offset_m)
    np.testing.assert_allclose(found, plane.distance(points), atol=1e-4)


def test_rays_meet_the_plane_in_front_only():
    road = g.Plane.of(np.array([0.0, -1.0, 0.0]), 1.5)
    below, above = g.intersect_plane(CAMERA, np.array([[319.5, 399.5], [319.5, 100.0]]), road)
    np.testing.assert_allclose(below, [0.0, 1.5, 3.0])
    assert np.isnan(above).all()


FOCALS = st.floats(50.0, 3000.0)
CENTRES = st.floats(-500.0, 2000.0)
FACTORS = st.floats(0.01, 100.0).flatmap(lambda size: st.sampled_from((size, -size)))


@given(FOCALS, FOCALS, CENTRES, CENTRES, st.floats(-20.0, 20.0), st.tuples(*(st.floats(-3.1, 3.1),) * 3), FACTORS)
def test_a_projection_matrix_is_decomposed_into_its_factors(fx, fy, cx, cy, skew, rpy, factor):
    K = np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    R = rotation_from_rpy(*rpy)
    centre = np.array([3.0, -4.0, 5.0])
    found = g.decompose_projection(factor * K @ np.column_stack((R, -R @ centre)))
    np.testing.assert_allclose(found[0], K, atol=1e-6)
    np.testing.assert_allclose(found[1], R, atol=1e-8)
    np.testing.assert_allclose(found[2], centre, atol=1e-7)
    assert np.linalg.det(found[1]) == pytest.approx(1.0)


def test_baseline_is_the_distance_of_the_centres():
    left = CAMERA.K @ np.column_stack((np.eye(3), np.zeros(3)))
    right = CAMERA.K @ np.column_stack((np.eye(3), [-3.0, 0.0, -4.0]))
    assert g.baseline_of(left, right) == pytest.approx(5.0)
    with pytest.raises(ValueError, match="one and the same centre"):
        g.baseline_of(left, -2 * left)


@pytest.mark.parametrize(
    "P",
    [
        np.zeros((3, 4)),
        np.eye(4),
        np.full((3, 4), np.nan),
        np.array([[640.0, 0, 640, 1], [0, 640, 480, 1], [640, 640, 1120, 1]]),
    ],
)
def test_an_invalid_projection_matrix_raises(P):
    with pytest.raises(ValueError, match="projection matrix"):
        g.decompose_projection(P)


@pytest.mark.parametrize(
    ("line", "inside"),
    [
        ([(10, 10), (20, 20)], [(10, 10), (20, 20)]),
        ([(-10.5, 30), (9.5, 10), (10, 5)], [(-0.5, 20), (9.5, 10), (10, 5)]),
        ([(10, 60), (10, 40), (10, 20)], [(10, 47.5), (10, 40), (10, 20)]),
        ([(-10, 30), (100, 30)], [(-0.5, 30), (63.5, 30)]),
        ([(-10, 30), (-5, 10)], []),
        ([(10, 10)], []),
        ([], []),
    ],
)
def test_a_line_is_cut_at_the_border_of_the_image(line, inside):
    camera = g.Camera("camera", width=64, height=48, fx=50, fy=50, cx=31.5, cy=23.5)
    found = g.inside_image(np.reshape(line, (-1, 2)).astype(float), camera)
    np.testing.assert_allclose(found, np.reshape(inside, (-1, 2)))
