"""The sensors on the car: two cameras, and a lidar on the roof like CARLA's ``sensor.lidar.ray_cast``.

The lidar has rings of rays at even angles, all at one instant. A camera at the lidar's position renders the scene. The
lidar uses the pixels nearest to its ray angles, so each point is exact: the ray of its pixel meets the scene there.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from roadperc_stream.geometry import EGO_R_OPTICAL, Camera, Float, Float32, rays, rigid

from .options import RenderOptions
from .view import Snapshot, View

BASELINE_M: Final = 0.5


@dataclass(frozen=True)
class CameraPair:
    """The front camera and the right camera: the same pinhole twice, fixed to the car."""

    camera: Camera
    ego_T_left: Float
    ego_T_right: Float


def make_rig(options: RenderOptions) -> CameraPair:
    """Return the cameras; as in CARLA, the principal point is (w / 2, h / 2) from the corner of the first pixel."""
    half = options.width / 2
    focal = half if options.fov_deg == 90.0 else half / float(np.tan(np.radians(options.fov_deg) / 2))
    camera = Camera("front", options.width, options.height, focal, focal, half - 0.5, options.height / 2 - 0.5)
    x, y, z, roll, pitch, yaw = options.mount
    axes = Rotation.from_euler("ZYX", (-yaw, -pitch, roll), degrees=True).as_matrix()
    body = rigid(axes, np.array([x, -y, z]))
    optical = rigid(EGO_R_OPTICAL, np.zeros(3))
    beside = rigid(np.eye(3), np.array([0.0, -BASELINE_M, 0.0]))
    return CameraPair(camera, body @ optical, body @ beside @ optical)


LIDAR_Z_M: Final = 2.4
"""Height of the lidar above the ego origin."""
CHANNELS: Final = 64
ELEVATION_DEG: Final = (10.0, -30.0)
"""Elevation of the upper and the lower ring: CARLA's defaults."""
FIELD_DEG: Final = 90.0
"""Horizontal field of view; it covers the view of the front camera."""
STEP_DEG: Final = 0.2
"""Angle between two rays of a ring."""
RANGE_M: Final = 100.0
ATTENUATION_PER_M: Final = 0.004
"""CARLA's default; the intensity of a point is exp(-attenuation * distance)."""
_FOCAL_PX: Final = 640.0


def scan(snapshot: Snapshot) -> Float32:
    """Return (N, 4) x forward, y right, z up in metres from the lidar, and intensity; left-handed as in CARLA."""
    camera, pixels = _rays()
    world_T_camera = snapshot.world_T_ego @ rigid(EGO_R_OPTICAL, np.array([0.0, 0.0, LIDAR_Z_M]))
    depth_m = View(snapshot, camera, world_T_camera).depth_m[pixels[:, 1], pixels[:, 0]]
    right, down, forward = (rays(camera, pixels.astype(float)) * depth_m[:, None]).T
    distance_m = np.sqrt(right**2 + down**2 + forward**2)
    points = np.stack((forward, right, -down, np.exp(-ATTENUATION_PER_M * distance_m)), axis=-1)
    return np.asarray(points[distance_m <= RANGE_M], np.float32)


@lru_cache(maxsize=1)
def _rays() -> tuple[Camera, NDArray[np.intp]]:
    """Return a camera for all rays, and (N, 2) the nearest pixels: rings from top to bottom, left to right."""
    half = FIELD_DEG / 2
    azimuth = np.radians(np.arange(-half + STEP_DEG / 2, half, STEP_DEG))
    elevation = np.radians(np.linspace(*ELEVATION_DEG, CHANNELS))[:, None]
    columns = _FOCAL_PX * np.broadcast_to(np.tan(azimuth), (CHANNELS, len(azimuth)))
    rows = -_FOCAL_PX * np.tan(elevation) / np.cos(azimuth)
    pixels = np.rint(np.stack((columns, rows), axis=-1).reshape(-1, 2)).astype(np.intp)
    first, last = pixels.min(axis=0), pixels.max(axis=0)
    (width, height), (cx, cy) = last - first + 1, -first
    return Camera("lidar", int(width), int(height), _FOCAL_PX, _FOCAL_PX, float(cx), float(cy)), pixels - first
