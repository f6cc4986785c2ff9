"""The length of a step from the road's image and the last speed."""

from types import SimpleNamespace

import numpy as np
import pytest

from roadperc_stream.chain.stages.odometry import road_scale
from roadperc_stream.chain.stages.odometry.camera_pitch import CameraPitch
from roadperc_stream.chain.stages.odometry.motion import Motion
from roadperc_stream.chain.stages.odometry.road_image import RoadMotion
from roadperc_stream.chain.stages.odometry.road_scale import Expected, _fused, scaled_by_road
from roadperc_stream.geometry import rigid

KNOWN = Expected(length_m=1.0, variance=0.02**2)


def found(length_m):
    """A length by the road's image."""
    return RoadMotion(length_m, variance=0.01**2, metres_per_pitch=0.0, pitch=0.0, pitch_variance=1.0)


def test_lengths_that_agree_are_fused():
    length_m, variance = _fused(found(1.03), KNOWN)
    assert 1.0 < length_m < 1.03
    assert variance < KNOWN.variance


def test_without_a_known_speed_the_roads_length_counts():
    assert _fused(found(0.7), None)[0] == 0.7


@pytest.mark.parametrize(
    ("doubts", "length_m", "std_m", "scale"),
    [((), 1.0, 0.1, "points"), ((0.7, 0.7, 1.5), 1.0, 0.1, "points"), ((0.7, 0.72, 0.71), 0.7, 0.016, "measured")],
)
def test_a_contradicting_length_counts_only_if_it_confirms_the_last_ones(monkeypatch, doubts, length_m, std_m, scale):
    monkeypatch.setattr(road_scale, "_on_road", lambda *_, **__: found(0.7))
    frame = SimpleNamespace(road=None, ego_T_camera=np.eye(4))
    keyframe = SimpleNamespace(landmarks=SimpleNamespace(doubts=doubts))
    ahead = Motion(rigid(np.eye(3), np.array([0.0, 0.0, -1.0])), np.ones(1, bool), np.zeros((1, 3)), None, scaled=True)
    pitch, steady = CameraPitch(0.0, 0.0), lambda *_: 0.0
    motion, _ = scaled_by_road(frame, keyframe, ahead, pitch, KNOWN, (0.0, 2.0), steady, parallax_px=0.0)
    assert np.linalg.norm(motion.this_T_key[:3, 3]) == pytest.approx(length_m)
    height_std_m = road_scale._HEIGHT_SHARE * length_m if scale == "points" else 0.0
    assert motion.length_variance == pytest.approx(std_m**2 + height_std_m**2, rel=0.1)
    assert motion.scale == scale
