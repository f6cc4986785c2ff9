"""The road's plane from frame to frame: what stands in where a frame's depth does not show the road."""

from dataclasses import dataclass

import numpy as np

from roadperc_stream.chain.stages.surface.road import known_surface
from roadperc_stream.core.config import SurfaceConfig
from roadperc_stream.core.datatypes import Absent, Reason, Surface
from roadperc_stream.core.geometry import Float, Plane, inverse, rigid, transform_plane
from roadperc_stream.core.scene import Scene


@dataclass(frozen=True)
class SurfaceState:
    """The plane of the last frame whose depth showed the road, in the ego frame of the last frame.

    ``driven_m`` is how far the car has come since. None where there was no such frame, or the way from there is not
    known.
    """

    ego_plane: Plane | None = None
    driven_m: float = 0.0


def remember(
    cfg: SurfaceConfig,
    state: SurfaceState,
    scene: Scene,
    road: Surface | Absent,
    failed: Reason | None,
    last_T_this: Float | None,
) -> tuple[SurfaceState, Surface | Absent, tuple[Reason, ...]]:
    """Keep the plane of a frame whose depth shows the road; where it does not, the one kept stands in.

    Args:
        cfg: how far a plane is held.
        state: what the last frame left.
        scene: the frame.
        road: the frame's own, or what the mounting promises.
        failed: why the frame's depth does not show the road; None: it does, or there is no depth.
        last_T_this: (4, 4) motion of the ego frame since the last frame, metres; None where it is not known.

    Returns:
        The new state, the road, and what stands in for the depth, as a reason.
    """
    if isinstance(road, Surface) and road.measured:
        return SurfaceState(road.ego_plane), road, ()
    state = _moved(state, last_T_this)
    if state.ego_plane is not None and state.driven_m <= cfg.hold_m:
        cause = Reason("surface", "no_depth") if failed is None else failed
        return state, _held(scene, state.ego_plane), (Reason("surface", "plane_held", cause=cause),)
    if failed is None or isinstance(road, Absent):
        return state, road, ()
    return state, road, (Reason("surface", "plane_assumed", (scene.plane_source,), failed),)


def _held(scene: Scene, ego_plane: Plane) -> Surface:
    """A plane as the road in the frame of the depth's camera, without depth of the front camera."""
    if scene.depth is None:
        return known_surface("held", scene.camera, scene.ego_T_camera, ego_plane)
    return known_surface("held", scene.depth.camera, scene.depth.ego_T_camera, ego_plane)


def _moved(state: SurfaceState, last_T_this: Float | None) -> SurfaceState:
    """The plane in the ego frame of the moved car, which rides on it: of the motion its way and its turn count.

    Where depth is so noisy that it does not show the road, a step's pitch is wrong by a tenth of a degree and more, and
    always to the same side: a few metres on it would tilt the plane by more than the mounting's is off.
    """
    if state.ego_plane is None or last_T_this is None:
        return SurfaceState()
    turn = np.arctan2(last_T_this[1, 0], last_T_this[0, 0])
    cos, sin = np.cos(turn), np.sin(turn)
    turned = rigid(np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3))
    plane = transform_plane(inverse(turned), state.ego_plane)
    return SurfaceState(plane, state.driven_m + float(np.linalg.norm(last_T_this[:2, 3])))
