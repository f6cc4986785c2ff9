"""The road if the depth does not show it: the held plane of earlier frames, then the mounting's plane."""

from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages.surface.road import SurfaceState, choose_road, find_surface
from roadperc_stream.config import SurfaceConfig
from roadperc_stream.model import Absent, Reason
from tests.analytic import Road
from tests.scenes import scene_of

CFG = SurfaceConfig()
ROAD = Road(width=320, height=240, pitch=0.02, roll=-0.01)
PLANE = g.Plane.of(np.array([0.02, 0.0, 1.0]), -0.03)
STATE = SurfaceState(PLANE, 5.0)
FAILED = Reason("surface", "no_plane", (900, 0.2))
WITH_DEPTH = scene_of(ROAD.camera, ROAD.ego_T_camera, depth_m=ROAD.depth_m(), tags=ROAD.tags())


def motion(yaw=0.0, pitch=0.0, ahead_m=1.0, up_m=0.0):
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    nod = np.array([[np.cos(pitch), 0.0, np.sin(pitch)], [0.0, 1.0, 0.0], [-np.sin(pitch), 0.0, np.cos(pitch)]])
    return g.rigid(turn @ nod, np.array([ahead_m, 0.0, up_m]))


def noisy_scene(mounted=True):
    """Depth with an error of 30 %, which shows no plane."""
    factor = np.random.default_rng(0).normal(1, 0.3, ROAD.depth_m().shape).astype(np.float32)
    return replace(WITH_DEPTH, raw_depth_m=ROAD.depth_m() * factor, mounted=mounted)


def after(state, scene, last_T_this, cfg=CFG):
    same, found = find_surface(cfg, state, scene, np.random.default_rng(0))
    assert same is state
    return choose_road(cfg, state, scene, found, last_T_this)


def test_the_plane_of_a_frame_that_shows_the_road_is_kept():
    state, road, reasons = after(STATE, WITH_DEPTH, motion())
    assert (road.source, reasons) == ("depth", ())
    assert state == SurfaceState(road.ego_plane, 0.0)


@pytest.mark.parametrize(("depth_m", "cause"), [(noisy_scene().raw_depth_m, "no_plane"), (None, "no_depth")])
def test_a_plane_is_held_if_the_depth_is_missing_or_does_not_show_the_road(depth_m, cause):
    state, road, reasons = after(STATE, replace(WITH_DEPTH, raw_depth_m=depth_m), motion())
    assert (road.source, road.model, road.inlier_ratio, road.measured) == ("held", "plane", None, False)
    assert road.abd == pytest.approx((0.02, 0.0, 0.03), abs=1e-12)
    assert [(reason.code, reason.cause.code) for reason in reasons] == [("plane_held", cause)]
    assert state.driven_m == STATE.driven_m + 1.0
    assert state.ego_plane.normal == pytest.approx(PLANE.normal)
    pitch, roll = g.camera_pitch_roll(g.transform_plane(g.inverse(ROAD.ego_T_camera), PLANE))
    assert (road.pitch, road.roll) == pytest.approx((pitch, roll))


@pytest.mark.parametrize(
    ("last_T_this", "abd"),
    [(motion(yaw=np.pi / 2), (0.0, -0.02, 0.03)), (motion(pitch=0.01, up_m=0.2), (0.02, 0.0, 0.03))],
    ids=["a quarter turn", "pitch and height of a noisy step"],
)
def test_the_plane_turns_with_the_cars_yaw_only(last_T_this, abd):
    assert after(STATE, noisy_scene(), last_T_this)[1].abd == pytest.approx(abd, abs=1e-12)


@pytest.mark.parametrize(
    ("state", "last_T_this", "cfg"),
    [
        (SurfaceState(), motion(), CFG),
        (STATE, None, CFG),
        (SurfaceState(PLANE, 29.5), motion(), CFG),
        (STATE, motion(), SurfaceConfig(hold_m=0.0)),
    ],
    ids=["nothing held", "unknown motion", "too far", "hold_m is 0"],
)
def test_if_no_plane_is_held_the_mounting_gives_the_road(state, last_T_this, cfg):
    _, road, reasons = after(state, noisy_scene(), last_T_this, cfg)
    assert (road.source, road.abd) == ("assumed", pytest.approx((0.0, 0.0, 0.0)))
    assert [(reason.code, reason.values) for reason in reasons] == [("plane_assumed", ("the mounting",))]


def test_without_a_mounting_there_is_no_surface():
    state, road, reasons = after(SurfaceState(), noisy_scene(mounted=False), motion())
    assert isinstance(road, Absent)
    assert (state, reasons) == (SurfaceState(), ())
    assert after(STATE, noisy_scene(mounted=False), motion())[1].source == "held"


def test_a_standing_car_holds_the_plane_without_limit():
    state, scene = STATE, noisy_scene()
    for _ in range(200):
        state, road, _ = choose_road(CFG, state, scene, Absent(FAILED), motion(ahead_m=0.0))
        assert (state.driven_m, road.source) == (STATE.driven_m, "held")
    assert state.ego_plane.normal == pytest.approx(PLANE.normal)
