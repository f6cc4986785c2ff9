"""The pitch of a camera without depth, by the lanes of a single image."""

import cv2
import numpy as np
import pytest

from roadperc_stream.chain.road_pitch import known_pitch
from roadperc_stream.chain.stages.odometry.camera_pitch import CameraPitch
from roadperc_stream.chain.stages.odometry.keyframes import OdometryState
from roadperc_stream.chain.stages.surface.road import SurfaceState
from roadperc_stream.config import ReplayConfig
from roadperc_stream.geometry import EGO_R_OPTICAL, Camera, inverse, project, rigid, transform
from roadperc_stream.geometry.planes import Plane
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14 as TABLE
from roadperc_stream.system.time import NS_PER_S
from tests.scenes import scene_of

CFG = ReplayConfig()
CAMERA = Camera("front", 1280, 720, 1200.0, 1200.0, 639.5, 359.5)
MOUNTING = rigid(EGO_R_OPTICAL, np.array([0.0, 0.0, 1.5]))
ROAD, LINE = (TABLE.names.index(name) for name in ("road", "road_line"))


def still(pitch_deg, lines_m=(-1.75, 1.75), assumed=CAMERA):
    """A still of straight lines by a camera that looks down by ``pitch_deg``, with a level mounting."""
    looks = MOUNTING.copy()
    looks[:3, :3] = rotation_from_rpy(0.0, np.deg2rad(pitch_deg), 0.0) @ MOUNTING[:3, :3]
    tags = np.zeros(CAMERA.size, np.uint8)
    for tag, left_m, right_m in ((ROAD, 6.0, -6.0), *((LINE, y + 0.1, y - 0.1) for y in lines_m)):
        corners = np.array([(x, y, 0.0) for x, y in ((3.0, left_m), (60.0, left_m), (60.0, right_m), (3.0, right_m))])
        px = np.rint(project(CAMERA, transform(inverse(looks), corners))).astype(np.int32)
        cv2.fillPoly(tags, [px], tag)
    return scene_of(assumed, MOUNTING, tags=tags, table=TABLE)


@pytest.mark.parametrize("pitch_deg", [-9.0, -6.0, -2.5, 3.0, 6.0, 10.0])
def test_the_lanes_of_a_still_show_the_pitch(pitch_deg):
    pitch = known_pitch(CFG, SurfaceState(), OdometryState(), still(pitch_deg))
    assert np.degrees(pitch.offset) == pytest.approx(pitch_deg, abs=0.15)
    assert pitch.source == "the lanes' vanishing point"


@pytest.mark.parametrize("pitch_deg", [-1.0, 0.0, 1.2])
def test_a_pitch_within_its_uncertainty_leaves_the_mounting(pitch_deg):
    assert known_pitch(CFG, SurfaceState(), OdometryState(), still(pitch_deg)) is None


def test_one_line_shows_no_pitch():
    assert known_pitch(CFG, SurfaceState(), OdometryState(), still(2.5, lines_m=(1.75,))) is None


def test_a_certain_pitch_of_the_motion_comes_first():
    sure, unsure = (OdometryState(pitch=CameraPitch(0.01, variance, measured=True)) for variance in (1e-6, 1e-3))
    assert known_pitch(CFG, SurfaceState(), sure, still(2.5)).offset == 0.01
    of_a_single_image = known_pitch(CFG, SurfaceState(), sure, still(2.5), still(2.5).stamp_ns - 2 * NS_PER_S)
    assert np.degrees(of_a_single_image.offset) == pytest.approx(2.5, abs=0.15)
    assert np.degrees(known_pitch(CFG, SurfaceState(), unsure, still(2.5)).offset) == pytest.approx(2.5, abs=0.15)


def test_a_held_plane_or_an_exact_mounting_needs_no_pitch_of_the_lanes():
    exact = CFG.odometry.model_copy(update={"pitch_std_deg": 0.0})
    assert known_pitch(CFG.model_copy(update={"odometry": exact}), SurfaceState(), OdometryState(), still(2.5)) is None
    held = SurfaceState(Plane.of(np.array([0.0, 0.0, 1.0]), 0.0))
    assert known_pitch(CFG, held, OdometryState(), still(2.5)) is None
