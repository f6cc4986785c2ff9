"""Coordinates along the road, and intersections of rays with the ground."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.tools.scene.options import SCENES, RenderOptions
from roadperc_stream.tools.scene.scenes import LEVEL_GROUND, make_scene, rolling_ground


@pytest.mark.parametrize("scene", SCENES)
@given(s=st.floats(0, 300), d=st.floats(-12, 12), ahead=st.floats(-40, 200))
def test_coordinates_undo_point(scene, s, d, ahead):
    path = make_scene(RenderOptions(scene=scene), 300.0).path
    road = path.around(s)
    x, y = path.point(np.array([s + ahead]), d)
    local = np.array([x - road.origin_m[0], y - road.origin_m[1]])
    for precision, tolerance in ((np.float64, 1e-9), (np.float32, 2e-4)):
        found_s, found_d = road.coordinates(*local.astype(precision))
        assert found_s[0] == pytest.approx(ahead, abs=tolerance * 5)
        assert found_d[0] == pytest.approx(d, abs=tolerance)
        assert found_d.dtype == precision


@pytest.mark.parametrize("scene", SCENES)
def test_headings_are_the_tangent_and_bend_by_the_curvature(scene):
    path = make_scene(RenderOptions(scene=scene), 300.0).path
    s = np.arange(0.0, 300.0, 0.5)
    x, y, heading = path.pose(s)
    dx, dy = np.diff(x), np.diff(y)
    assert np.hypot(dx, dy) == pytest.approx(0.5, abs=1e-5)
    assert np.unwrap(np.arctan2(dy, dx)) == pytest.approx((heading[:-1] + heading[1:]) / 2, abs=1e-3)


def marched(terrain, centre, dx, dz, lift):
    """Return the first depth at which a ray is below the ground, by small steps."""
    t = np.arange(0.5, 600.0, 0.01)
    below = centre[2] + t * dz <= terrain.height(centre[0] + t * dx) + lift
    return t[below.argmax()] if below.any() else np.inf


@pytest.mark.parametrize(("start_m", "lift"), [(0.0, 0.0), (55.3, 0.15), (121.7, 0.0), (190.0, 0.15)])
def test_first_hits_agree_with_marching_along_the_ray(start_m, lift):
    terrain = rolling_ground(1500.0, 240.0, 0.08)
    centre = np.array([start_m, 0.0, terrain.height(np.array([start_m]))[0] + 1.4])
    dz = np.linspace(-0.5, 0.12, 90)
    found = terrain.first_hits(centre, np.full(90, 0.9), dz, lift)
    expected = np.array([marched(terrain, centre, 0.9, z, lift) for z in dz])
    near = expected < 500
    assert near.sum() > 40
    assert found[near] == pytest.approx(expected[near], abs=0.011)
    assert (found[np.isinf(expected)] > 500).all()


def test_grades_reach_eight_percent_and_level_ground_is_level():
    terrain = rolling_ground(1000.0, 240.0, 0.08)
    assert np.abs(np.diff(terrain.z_m) / 2).max() == pytest.approx(0.08, abs=1e-4)
    assert LEVEL_GROUND.height(np.array([3.0, 4.0])).tolist() == [0.0, 0.0]


def test_town_bends_both_ways_and_stays_within_thirty_degrees():
    path = make_scene(RenderOptions(scene="town"), 500.0).path
    _, _, heading = path.pose(np.arange(0.0, 1500.0))
    assert np.degrees(heading).max() == pytest.approx(30, abs=0.5)
    assert np.degrees(heading).min() == pytest.approx(-30, abs=0.5)
