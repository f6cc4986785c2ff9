import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.tools.scene.options import SCENES, RenderOptions
from roadperc_stream.tools.scene.world import make_world


@pytest.mark.parametrize("scene", SCENES)
@given(s=st.floats(0, 300), d=st.floats(-12, 12), ahead=st.floats(-40, 200))
def test_coordinates_undo_point(scene, s, d, ahead):
    path = make_world(RenderOptions(scene=scene), 300.0).path
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
    path = make_world(RenderOptions(scene=scene), 300.0).path
    s = np.arange(0.0, 300.0, 0.5)
    x, y, heading = path.pose(s)
    dx, dy = np.diff(x), np.diff(y)
    assert np.hypot(dx, dy) == pytest.approx(0.5, abs=1e-5)
    assert np.unwrap(np.arctan2(dy, dx)) == pytest.approx((heading[:-1] + heading[1:]) / 2, abs=1e-3)


def test_bend_has_the_stated_radius():
    path = make_world(RenderOptions(scene="bend"), 100.0).path
    x, y = path.point(np.linspace(0, 900, 50), 0.0)
    assert np.hypot(x, y - 150) == pytest.approx(150.0, abs=1e-9)


def test_town_bends_both_ways_and_stays_within_thirty_degrees():
    path = make_world(RenderOptions(scene="town"), 500.0).path
    _, _, heading = path.pose(np.arange(0.0, 1500.0))
    assert np.degrees(heading).max() == pytest.approx(30, abs=0.5)
    assert np.degrees(heading).min() == pytest.approx(-30, abs=0.5)
