"""Heights of the road and intersections with rays: planes, grids of planes, hills."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream import geometry as g
from roadperc_stream.geometry import ground
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.model import HeightGrid
from tests.hills import Hill

HILL = Hill(width=320, height=240)
FLAT = replace(HILL.surface(), height_grid=None)


def sloped(a, b, d):
    """A plane as surface, and the same as a height grid on it."""
    ego_plane = g.Plane.of(np.array([a, b, 1.0]), -d)
    surface = replace(FLAT, ego_plane=ego_plane, plane=g.transform_plane(g.inverse(HILL.ego_T_camera), ego_plane))
    x, y = np.meshgrid(np.arange(41.0), np.arange(-6.0, 7.0))
    return surface, replace(surface, height_grid=HeightGrid(0.0, -6.0, 1.0, (d - a * x - b * y).astype(np.float32)))


def pixels_of(points):
    return g.project(HILL.camera, g.transform(g.inverse(HILL.ego_T_camera), points))


@settings(max_examples=25)
@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.5, 0.5), st.integers(0, 2**32 - 1))
def test_a_grid_of_a_plane_has_the_planes_heights_everywhere(a, b, d, seed):
    plane, field = sloped(a, b, d)
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-50, 150, 50), rng.uniform(-50, 50, 50)
    np.testing.assert_allclose(ground.height_at(field, x, y), ground.height_at(plane, x, y), atol=2e-4)
    pixels = rng.uniform((0, 125), (320, 240), (50, 2))
    expected = ground.ground_points(plane, HILL.camera, HILL.ego_T_camera, pixels)
    found = ground.ground_points(field, HILL.camera, HILL.ego_T_camera, pixels)
    near = expected[:, 0] < 30
    np.testing.assert_allclose(found[near], expected[near], atol=5e-3)


@pytest.mark.parametrize("hill", [HILL, replace(HILL, grade=-0.08), replace(HILL, bank=0.03)])
def test_pixels_of_points_on_the_hill_give_the_points_back(hill):
    x, y = (values.ravel() for values in np.meshgrid(np.arange(3.0, 26.0), np.arange(-3.0, 4.0)))
    points = np.stack((x, y, ground.height_at(hill.surface(), x, y)), axis=-1)
    np.testing.assert_allclose(points[:, 2], hill.z(x, y), atol=1e-6)
    found = ground.ground_points(hill.surface(), hill.camera, hill.ego_T_camera, pixels_of(points))
    np.testing.assert_allclose(found, points, atol=0.01)


def test_a_crest_hides_the_road_behind_it():
    crest = replace(HILL, grade=0.2, wave_m=60.0)
    behind = np.array([[45.0, 0.0, float(crest.z(45.0, 0.0))]])
    (found,) = ground.ground_points(crest.surface(), HILL.camera, HILL.ego_T_camera, pixels_of(behind))
    assert found[0] < 31
    assert found[2] == pytest.approx(crest.z(found[0], found[1]), abs=0.01)


def test_rays_into_the_sky_meet_nothing():
    found = ground.ground_points(HILL.surface(), HILL.camera, HILL.ego_T_camera, np.array([[160.0, 20.0], [5.0, 0.0]]))
    assert np.isnan(found).all()
    assert ground.ground_points(HILL.surface(), HILL.camera, HILL.ego_T_camera, np.empty((0, 2))).shape == (0, 3)


def test_extrapolation_without_twist_unknown_positions_and_single_heights():
    twisted = replace(FLAT, height_grid=HeightGrid(0.0, 0.0, 1.0, np.array([[0, 0], [0, 1]], np.float32)))
    height = ground.height_at(twisted, np.array([0.5, 1.0, 11.0, 11.0, -5.0]), np.array([0.5, 1.0, 1.0, 11.0, -5.0]))
    np.testing.assert_allclose(height, [0.25, 1.0, 11.0, 21.0, 0.0])
    assert np.isnan(ground.height_at(HILL.surface(), np.array([np.nan]), np.array([0.0]))).all()
    one = replace(FLAT, height_grid=HeightGrid(0.0, 0.0, 1.0, np.full((1, 1), 0.3, np.float32)))
    np.testing.assert_allclose(ground.height_at(one, np.array([-9.0, 40.0]), np.array([3.0, 0.0])), 0.3, atol=1e-6)


@pytest.mark.parametrize(("top", "step"), [(0, 1), (51, 3)])
def test_ego_points_of_a_part_of_the_image(top, step):
    turned = g.rigid(rotation_from_rpy(0.02, 0.05, 0.1) @ g.EGO_R_OPTICAL, np.array([1.2, 0.3, 1.5]))
    depth = np.random.default_rng(0).uniform(1, 50, (240, 320)).astype(np.float32)
    rows, columns = np.indices(depth.shape, dtype=float)
    expected = g.transform(turned, g.unproject(HILL.camera, np.stack((columns, rows), axis=-1), depth))
    visible = ground.part(HILL.camera, step, step)
    assert visible.size == depth[::step, ::step].shape
    found = np.stack(ground.ego_points(visible, turned, depth[::step, ::step][top:], top), axis=-1)
    np.testing.assert_allclose(found, expected[::step, ::step][top:], atol=1e-4)


def test_heights_above_the_road():
    x, y = np.meshgrid(np.linspace(1, 70, 30, dtype=np.float32), np.linspace(-20, 20, 9, dtype=np.float32))
    z = np.full_like(x, 2.0)
    z[0, 0] = np.nan
    for surface in (FLAT, HILL.surface()):
        expected = 2.0 - ground.height_at(surface, x.astype(float), y.astype(float))
        expected[0, 0] = np.nan
        np.testing.assert_allclose(ground.height_above(surface, x, y, z), expected, atol=3e-3)
