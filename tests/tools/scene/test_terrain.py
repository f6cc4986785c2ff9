import numpy as np
import pytest

from roadperc_stream.tools.scene.world import level_ground, rolling_ground


def marched(terrain, centre, dx, dz, lift):
    """The first depth at which a ray is below the ground, by small steps."""
    t = np.arange(0.5, 600.0, 0.01)
    below = centre[2] + t * dz <= terrain.height(centre[0] + t * dx) + lift
    return t[below.argmax()] if below.any() else np.inf


@pytest.mark.parametrize("start_m", [0.0, 55.3, 121.7, 190.0])
@pytest.mark.parametrize("lift", [0.0, 0.15])
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


def test_hits_lie_on_the_ground():
    terrain = rolling_ground(1500.0, 240.0, 0.08)
    centre = np.array([70.0, 0.0, terrain.height(np.array([70.0]))[0] + 1.4])
    dx, dz = np.meshgrid(np.linspace(0.3, 1.2, 40), np.linspace(-0.6, 0.05, 50))
    depth = terrain.first_hits(centre, dx, dz, 0.0)
    hit = depth < 500
    height = terrain.height(centre[0] + depth[hit] * dx[hit])
    assert centre[2] + depth[hit] * dz[hit] == pytest.approx(height, abs=1e-9)


def test_grades_reach_eight_percent_and_level_ground_is_level():
    terrain = rolling_ground(1000.0, 240.0, 0.08)
    assert np.abs(np.diff(terrain.z_m) / 2).max() == pytest.approx(0.08, abs=1e-4)
    assert level_ground().height(np.array([3.0, 4.0])).tolist() == [0.0, 0.0]
