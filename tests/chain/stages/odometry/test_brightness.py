"""Images at another exposure."""

from functools import cache

import numpy as np
import pytest

from roadperc_stream.chain.stages.odometry.brightness import equalised, shows_nothing
from roadperc_stream.model import Reason
from tests.chain.stages.odometry.street import Shot, drive, photograph, run

POSES = drive(12, step_m=0.3)


@cache
def photographed():
    return [photograph(p) for p in POSES]


def exposed(grey, gain, offset=0.0):
    return np.clip(np.rint(grey * gain + offset), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("gain", "offset"), [(0.5, 10.0), (0.7, -8.0), (2.0, 5.0)])
def test_gain_and_offset_are_found_also_where_pixels_are_clipped(gain, offset):
    grey = photographed()[0].grey
    wanted = exposed(grey, gain, offset)
    for pair in ((grey, wanted), (wanted, grey)):
        before, after = equalised(*pair)
        assert np.quantile(np.abs(before.astype(int) - after), 0.99) <= 3
    slightly = exposed(grey, 1.0, 3.0)
    assert equalised(grey, slightly)[0] is grey


def test_only_images_without_levels_show_nothing():
    grey = photographed()[0].grey
    noise = np.clip(np.random.default_rng(0).normal(0, 2, grey.shape), 0, 255).astype(np.uint8)
    assert all(map(shows_nothing, (np.zeros_like(grey), np.full_like(grey, 255), noise)))
    assert not shows_nothing(exposed(grey, 0.3, -10.0))


@pytest.mark.parametrize("gains", [(1.0, 0.55), (2.0, 0.5)], ids=["dark", "both"])
def test_alternating_exposures_lose_no_frame_and_no_distance(gains):
    shots = [Shot(exposed(shot.grey, gains[k % 2]), shot.depth_m) for k, shot in enumerate(photographed())]
    _, results = run(shots)
    assert [out.status for out in results] == ["first"] + ["tracked"] * 11
    assert np.linalg.norm(results[-1].odom_T_ego[:3, 3] - POSES[-1][:3, 3]) < 0.02


def test_black_images_are_bridged():
    shots = [Shot(np.zeros_like(s.grey), s.depth_m) if 4 <= k < 7 else s for k, s in enumerate(photographed())]
    states, results = run(shots)
    assert [out.status for out in results[3:8]] == ["tracked", "lost", "lost", "lost", "tracked"]
    assert results[4].reason == Reason("odometry", "image_uniform")
    assert states[6] is states[3]
    assert np.linalg.norm(results[-1].odom_T_ego[:3, 3] - POSES[-1][:3, 3]) < 0.02
