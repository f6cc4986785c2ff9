"""The road of one frame: its surface, the pixels that lie on it, and what is held where the depth does not show it."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from roadperc_stream.chain.stages.surface.plane import first_row, leaves_plane, pixels_near, road_plane, usable_pixels
from roadperc_stream.chain.stages.surface.spline import fit_height_grid, road_cells
from roadperc_stream.config import SurfaceConfig
from roadperc_stream.geometry import (
    Camera,
    Float,
    Plane,
    camera_pitch_roll,
    inverse,
    project,
    rigid,
    transform,
    transform_plane,
)
from roadperc_stream.geometry.ground import ego_points, height_above, height_at, tilted_ground
from roadperc_stream.model import Absent, Mask, Reason, Surface, SurfaceSource
from roadperc_stream.model.scene import DepthMap, Scene

_UP_EGO = np.array([0.0, 0.0, 1.0])
_DRIVABLE_M = 0.15
"""Largest distance of a drivable pixel to the surface: three times that of an inlier, for the far road's depth errs
more."""
_ROWS_AT_ONCE = 32
"""Rows whose distances to the surface stay in the processor's cache from one operation on them to the next."""
_FIELD_SAMPLES_M = np.arange(0.0, 201.0, 10.0), np.arange(-80.0, 81.0, 20.0)
"""Ego x and y at which a height field's highest row in the image is searched: as far as heights are sampled."""


@dataclass(frozen=True)
class SurfaceState:
    """The plane of the last frame whose depth showed the road, in the ego frame of the last frame.

    ``driven_m`` is how far the car has come since. None where there was no such frame, or the way from there is not
    known.
    """

    ego_plane: Plane | None = None
    driven_m: float = 0.0


def find_surface(cfg: SurfaceConfig, scene: Scene, rng: np.random.Generator) -> tuple[Surface | Absent, Reason | None]:
    """The road of a frame: fitted to its depth, else the one that the mounting promises.

    Returns:
        The surface, its plane in the frame of the camera the depth belongs to, or why there is none; and why the depth
        does not show the road, where it does not. Then the mounting's plane stands in; without a mounting there is
        none, but that a lidar that misses the road says no more of it than no lidar.
    """
    if scene.depth is None:
        return assumed_surface(*_depth_camera(scene)), None
    labels = scene.labels(cfg.classes)
    drivable = None
    if labels is not None:
        drivable = scene.depth.labels_from(scene.camera, scene.ego_T_camera, labels).view(bool)
    surface = fit_surface(cfg, scene.depth, drivable, rng)
    if not isinstance(surface, Absent):
        return surface, None
    if scene.depth.dense and not scene.mounted:
        return surface, surface.reason
    return assumed_surface(*_depth_camera(scene)), surface.reason


def fit_surface(
    cfg: SurfaceConfig, depth: DepthMap, drivable: Mask | None, rng: np.random.Generator
) -> Surface | Absent:
    """The road from a depth image: its plane, and its height field by the model ``spline``, or ``auto`` where it pays.

    Args:
        cfg: thresholds.
        depth: its camera's mounting says roughly where up is.
        drivable: (H, W) pixels of a drivable class in the depth's image; None where there is no segmentation,
            then the lower image stands in and the surface is marked ``lower_image``.
        rng: source of the hypotheses.

    Returns:
        The surface, or why there is none. Where too few points support a height field the plane stays.
    """
    source = depth.source if drivable is not None else "lower_image"
    camera, ego_T_camera, depth_m = depth.camera, depth.ego_T_camera, depth.depth_m
    usable = usable_pixels(cfg, camera, depth_m, drivable)
    found = road_plane(cfg, camera, depth_m, usable, inverse(ego_T_camera)[:3, :3] @ _UP_EGO, rng)
    if isinstance(found, Absent):
        return found
    surface = _surface(source, camera, ego_T_camera, *found)
    if cfg.model == "plane":
        return surface
    points, certainty = road_cells(cfg, surface, camera, ego_T_camera, depth_m, usable)
    if cfg.model == "auto" and not leaves_plane(points):
        return surface
    grid = fit_height_grid(cfg, surface, points, certainty)
    return surface if grid is None else replace(surface, model="spline", height_grid=grid)


def assumed_surface(camera: Camera, ego_T_camera: Float) -> Surface:
    """The ground by the mounting alone, for want of depth: ego's plane z = 0, marked ``assumed``."""
    return known_surface("assumed", camera, ego_T_camera, Plane.of(_UP_EGO, 0.0))


def _depth_camera(scene: Scene) -> tuple[Camera, Float]:
    """The camera of the depth and its mounting; those of the front camera without depth."""
    place = scene if scene.depth is None else scene.depth
    return place.camera, place.ego_T_camera


def known_surface(source: SurfaceSource, camera: Camera, ego_T_camera: Float, ego_plane: Plane) -> Surface:
    """The road by a plane that is known in the ego frame."""
    return _surface(source, camera, ego_T_camera, transform_plane(inverse(ego_T_camera), ego_plane), None)


def drivable_mask(cfg: SurfaceConfig, scene: Scene, surface: Surface | Absent) -> Mask | Absent:
    """(H, W) pixels of a drivable class near the surface.

    The distance to a plane is measured at right angles, that to a height field vertically: on a slope of 10 % that is
    half a percent more. Without dense depth, or where it does not show the road, the class alone decides; without
    segmentation the surface alone.

    Args:
        cfg: drivable classes.
        scene: the frame.
        surface: the road, its plane in the frame of the front camera.
    """
    drivable, depth_m, camera = scene.labels(cfg.classes), scene.dense_depth_m, scene.camera
    if depth_m is None and drivable is not None:
        return drivable.view(bool)
    if depth_m is None:
        return Absent(Reason("drivable", "no_segmentation_sparse_depth" if scene.depth else "no_depth_no_segmentation"))
    if isinstance(surface, Absent):
        return Absent(Reason("drivable", "no_surface", cause=surface.reason))
    if not surface.measured:
        return Absent(Reason("drivable", "depth_misses_road")) if drivable is None else drivable.view(bool)
    among = np.ones(camera.size, bool) if drivable is None else drivable.view(bool)
    if surface.height_grid is None:
        return pixels_near(camera, depth_m, surface.plane, _DRIVABLE_M, among)
    top = max(first_row(among), _horizon_row(surface, camera, scene.ego_T_camera))
    mask = np.zeros(camera.size, bool)
    for first in range(top, camera.height, _ROWS_AT_ONCE):
        rows = slice(first, min(first + _ROWS_AT_ONCE, camera.height))
        off_m = height_above(surface, *ego_points(camera, scene.ego_T_camera, depth_m[rows], first))
        # A comparison with NaN is False in OpenCV as in numpy: unknown depth is never drivable.
        near = np.asarray(cv2.inRange(off_m, -_DRIVABLE_M, _DRIVABLE_M), np.uint8)
        mask[rows] = near & among[rows].view(np.uint8)
    return mask


def _horizon_row(surface: Surface, camera: Camera, ego_T_camera: Float) -> int:
    """A row above which no pixel lies on the surface, with a metre to spare; the image's last row at most."""
    x, y = np.meshgrid(*_FIELD_SAMPLES_M)
    points = np.stack((x, y, height_at(surface, x, y) + 1.0), axis=-1)
    rows = project(camera, transform(inverse(ego_T_camera), points))[..., 1]
    return int(np.clip(np.floor(np.nanmin(rows, initial=camera.height)), 0, camera.height - 1))


def _surface(
    source: SurfaceSource, camera: Camera, ego_T_camera: Float, plane: Plane, inlier_ratio: float | None
) -> Surface:
    pitch, roll = camera_pitch_roll(plane)
    ego_plane = transform_plane(ego_T_camera, plane)
    return Surface(source, camera.frame_id, plane, ego_plane, plane.offset_m, pitch, roll, inlier_ratio)


def remember(
    cfg: SurfaceConfig,
    state: SurfaceState,
    scene: Scene,
    road: Surface | Absent,
    failed: Reason | None,
    last_T_this: Float | None,
    pitch: float | None = None,
) -> tuple[SurfaceState, Surface | Absent, tuple[Reason, ...]]:
    """Keep the plane of a frame whose depth shows the road; where it does not, the one kept stands in.

    Args:
        cfg: how far a plane is held.
        state: what the last frame left.
        scene: the frame.
        road: the frame's own, or what the mounting promises.
        failed: why the frame's depth does not show the road; None: it does, or there is no depth.
        last_T_this: (4, 4) motion of the ego frame since the last frame, metres; None where it is not known.
        pitch: by how much the front camera looks further down than its mounting says, radians; None: not known.

    Returns:
        The new state, the road, and what stands in for the depth, as a reason.
    """
    if isinstance(road, Surface) and road.measured:
        return SurfaceState(road.ego_plane), road, ()
    state = _moved(state, last_T_this)
    if state.ego_plane is not None and state.driven_m <= cfg.hold_m:
        cause = Reason("surface", "no_depth") if failed is None else failed
        held = known_surface("held", *_depth_camera(scene), state.ego_plane)
        return state, held, (Reason("surface", "plane_held", cause=cause),)
    if isinstance(road, Absent):
        return state, road, ()
    if pitch is not None:
        road = known_surface("estimated", *_depth_camera(scene), tilted_ground(scene.ego_T_camera, pitch))
    if failed is None:
        return state, road, ()
    code = "plane_assumed" if pitch is None else "plane_estimated"
    return state, road, (Reason("surface", code, (scene.plane_source,), failed),)


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
