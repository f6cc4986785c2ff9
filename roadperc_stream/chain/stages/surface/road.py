"""The road of one frame: its surface, its drivable pixels, and the plane held while the depth does not show it."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from roadperc_stream.chain.stages.surface.plane import first_row, leaves_plane, pixels_near, road_plane, usable_pixels
from roadperc_stream.chain.stages.surface.spline import fit_height_grid, road_cells
from roadperc_stream.config import SurfaceConfig
from roadperc_stream.geometry import Camera, Float, inverse, project, rigid, transform
from roadperc_stream.geometry.ground import ego_points, height_above, height_at, tilted_ground
from roadperc_stream.geometry.planes import Plane, transform_plane
from roadperc_stream.model import Absent, Mask, Reason, Surface, SurfaceSource
from roadperc_stream.model.frame import Frame

_UP_EGO = np.array([0.0, 0.0, 1.0])
_DRIVABLE_M = 0.15
"""Largest distance of a drivable pixel to the surface: three times an inlier's, because far depth has larger errors."""
_FIELD_SAMPLES_M = np.arange(0.0, 201.0, 10.0), np.arange(-80.0, 81.0, 20.0)
"""Ego x and y at which a height field's highest row in the image is searched."""


@dataclass(frozen=True)
class KnownPitch:
    """The pitch of the front camera beyond its mounting, radians, nose down, its variance, and what shows it."""

    offset: float
    variance: float
    source: str


@dataclass(frozen=True)
class SurfaceState:
    """The plane of the last frame whose depth showed the road, in the ego frame of the last frame.

    ``driven_m`` is the distance driven since. The plane is None without such a frame, or if the motion is unknown.
    """

    ego_plane: Plane | None = None
    driven_m: float = 0.0


def find_surface(
    cfg: SurfaceConfig, state: SurfaceState, frame: Frame, rng: np.random.Generator
) -> tuple[SurfaceState, Surface | Absent]:
    """Fit the road to the frame's depth; without depth, take it from the camera's mounting.

    Returns:
        The same state, and the surface with its plane in the frame of the depth's camera; absent if the depth does not
        show the road.
    """
    if frame.raw_depth_m is None:
        return state, assumed_surface(frame.depth_camera, frame.ego_T_depth_camera)
    labels = frame.labels_of_depth(cfg.classes)
    return state, fit_surface(cfg, frame, None if labels is None else labels.view(bool), rng)


def or_assumed(frame: Frame, found: Surface | Absent) -> Surface | Absent:
    """The found surface; if the depth does not show the road, that of the mounting.

    Dense depth without a mounting gives ``Absent``.
    """
    if isinstance(found, Surface) or (frame.has_dense_depth and not frame.mounted):
        return found
    return assumed_surface(frame.depth_camera, frame.ego_T_depth_camera)


def fit_surface(cfg: SurfaceConfig, frame: Frame, drivable: Mask | None, rng: np.random.Generator) -> Surface | Absent:
    """The road from a frame's depth: its plane, and a height field with model ``spline``, or ``auto`` if it is better.

    ``drivable`` (H, W) are the pixels of a drivable class in the depth's image. Without segmentation it is None: the
    lower image is used, and the surface's source is ``lower_image``. The camera's mounting gives a rough upward
    direction. If too few points support a height field, the surface is the plane.
    """
    camera, ego_T_camera, depth_m = frame.depth_camera, frame.ego_T_depth_camera, frame.raw_depth_m
    assert depth_m is not None
    source = frame.depth_source if drivable is not None else "lower_image"
    usable = usable_pixels(cfg, camera, depth_m, drivable)
    found = road_plane(cfg, camera, depth_m, usable, inverse(ego_T_camera)[:3, :3] @ _UP_EGO, rng)
    if isinstance(found, Absent):
        return found
    plane, inlier_ratio, search = found
    surface = Surface.of(source, camera, ego_T_camera, plane, inlier_ratio, search.seen_from(ego_T_camera))
    if cfg.model == "plane":
        return surface
    points, certainty = road_cells(cfg, surface, camera, ego_T_camera, depth_m, usable)
    if cfg.model == "auto" and not leaves_plane(points):
        return surface
    grid = fit_height_grid(cfg, surface, points, certainty)
    return surface if grid is None else replace(surface, model="spline", height_grid=grid)


def assumed_surface(camera: Camera, ego_T_camera: Float) -> Surface:
    """The ground by the mounting alone: the ego plane z = 0, with the source ``assumed``."""
    return known_surface("assumed", camera, ego_T_camera, Plane.of(_UP_EGO, 0.0))


def known_surface(source: SurfaceSource, camera: Camera, ego_T_camera: Float, ego_plane: Plane) -> Surface:
    """The surface with a known plane, given in the ego frame."""
    return Surface.of(source, camera, ego_T_camera, transform_plane(inverse(ego_T_camera), ego_plane))


def drivable_mask(cfg: SurfaceConfig, frame: Frame, surface: Surface | Absent) -> Mask | Absent:
    """(H, W) pixels of a drivable class near the surface.

    The distance to a plane is perpendicular, the distance to a height field vertical. On a slope of 10 % they differ by
    half a percent. Without dense depth, or if it does not show the road, only the class counts. Without segmentation,
    only the surface counts. The plane of ``surface`` is in the frame of the front camera.
    """
    drivable, depth_m, camera = frame.labels(cfg.classes), frame.dense_depth_m, frame.camera
    if depth_m is None and drivable is not None:
        return drivable.view(bool)
    if depth_m is None:
        has_depth = frame.raw_depth_m is not None
        return Absent(Reason("drivable", "no_segmentation_sparse_depth" if has_depth else "no_depth_no_segmentation"))
    if isinstance(surface, Absent):
        return Absent(Reason("drivable", "no_surface", cause=surface.reason))
    if not surface.measured:
        return Absent(Reason("drivable", "depth_misses_road")) if drivable is None else drivable.view(bool)
    among = np.ones(camera.size, bool) if drivable is None else drivable.view(bool)
    if surface.height_grid is None:
        return pixels_near(camera, depth_m, surface.plane, _DRIVABLE_M, among)
    top = max(first_row(among), _horizon_row(surface, camera, frame.ego_T_camera))
    mask = np.zeros(camera.size, bool)
    off_m = height_above(surface, *ego_points(camera, frame.ego_T_camera, depth_m[top:], top))
    # Unknown depth is never drivable: a comparison with NaN is False, in OpenCV, too.
    near = np.asarray(cv2.inRange(off_m, -_DRIVABLE_M, _DRIVABLE_M), np.uint8)
    mask[top:] = near & among[top:].view(np.uint8)
    return mask


def _horizon_row(surface: Surface, camera: Camera, ego_T_camera: Float) -> int:
    """A row above which no pixel lies within a metre of the surface; at most the image's last row."""
    x, y = np.meshgrid(*_FIELD_SAMPLES_M)
    points = np.stack((x, y, height_at(surface, x, y) + 1.0), axis=-1)
    rows = project(camera, transform(inverse(ego_T_camera), points))[..., 1]
    return int(np.clip(np.floor(np.nanmin(rows, initial=camera.height)), 0, camera.height - 1))


def choose_road(
    cfg: SurfaceConfig,
    state: SurfaceState,
    frame: Frame,
    found: Surface | Absent,
    last_T_this: Float | None,
    pitch: KnownPitch | None = None,
) -> tuple[SurfaceState, Surface | Absent, tuple[Reason, ...]]:
    """Keep the plane of a frame whose depth shows the road; otherwise use the held plane.

    Args:
        cfg: with ``hold_m``, the distance for which a plane is held.
        state: the state after the last frame.
        frame: the frame.
        found: fitted to the frame's depth, or taken from the mounting without depth; absent if the depth does not show
            the road.
        last_T_this: (4, 4) motion of the ego frame since the last frame, metres; None if unknown.
        pitch: of the front camera; None if unknown.

    Returns:
        The new state, the road, and the reason if the road does not come from the depth.
    """
    if isinstance(found, Surface) and found.measured:
        return SurfaceState(found.ego_plane), found, ()
    failed, road = found.reason if isinstance(found, Absent) else None, or_assumed(frame, found)
    state = _moved(state, last_T_this)
    if state.ego_plane is not None and state.driven_m <= cfg.hold_m:
        cause = Reason("surface", "no_depth") if failed is None else failed
        held = known_surface("held", frame.depth_camera, frame.ego_T_depth_camera, state.ego_plane)
        return state, held, (Reason("surface", "plane_held", cause=cause),)
    if isinstance(road, Absent):
        return state, road, ()
    if pitch is not None:
        tilted = tilted_ground(frame.ego_T_camera, pitch.offset)
        road = known_surface("estimated", frame.depth_camera, frame.ego_T_depth_camera, tilted)
    if failed is None:
        return state, road, ()
    if pitch is None:
        return state, road, (Reason("surface", "plane_assumed", (frame.plane_source,), failed),)
    return state, road, (Reason("surface", "plane_estimated", (frame.plane_source, pitch.source), failed),)


def _moved(state: SurfaceState, last_T_this: Float | None) -> SurfaceState:
    """The held plane in the ego frame of the moved car. Only distance and yaw of the motion count.

    If the depth is too noisy to show the road, the pitch of a step has a bias of a tenth of a degree or more. After a
    few metres that would tilt the plane by more than the error of the mounting.
    """
    if state.ego_plane is None or last_T_this is None:
        return SurfaceState()
    turn = np.arctan2(last_T_this[1, 0], last_T_this[0, 0])
    cos, sin = np.cos(turn), np.sin(turn)
    turned = rigid(np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3))
    plane = transform_plane(inverse(turned), state.ego_plane)
    return SurfaceState(plane, state.driven_m + float(np.linalg.norm(last_T_this[:2, 3])))
