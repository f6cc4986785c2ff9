"""The sensors on the car: two cameras and a lidar on the roof, as CARLA's ``sensor.lidar.ray_cast`` is one.

The lidar has rings of rays at even angles, all at one instant. Its rays are those of the pixels of a camera in the
lidar's place that lie nearest to the wanted angles, so that each point is exact: it lies where the ray of its pixel
meets the scene.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from roadperc_stream.geometry import EGO_R_OPTICAL, Camera, Float, Float32, rays, rigid

from .drive import SceneMoment
from .options import RenderOptions
from .view import View

BASELINE_M: Final = 0.5


@dataclass(frozen=True)
class CameraPair:
    """The front camera and its fellow on the right: the same pinhole twice, fixed to the car."""

    camera: Camera
    ego_T_left: Float
    ego_T_right: Float


def make_rig(options: RenderOptions) -> CameraPair:
    """The cameras; their principal point is CARLA's (w / 2, h / 2), counted from the corner of the first pixel."""
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
"""Of the upper and the lower ring: CARLA's defaults."""
FIELD_DEG: Final = 90.0
"""The lidar looks ahead and covers the front camera's view."""
STEP_DEG: Final = 0.2
"""From ray to ray of a ring."""
RANGE_M: Final = 100.0
ATTENUATION_PER_M: Final = 0.004
"""CARLA's default: a point's intensity is exp(-attenuation * distance)."""
_FOCAL_PX: Final = 640.0


def scan(moment: SceneMoment) -> Float32:
    """(N, 4) x forward, y right, z up in metres and intensity, as CARLA has it: left-handed, from the lidar."""
    camera, pixels = _rays()
    world_T_camera = moment.world_T_ego @ rigid(EGO_R_OPTICAL, np.array([0.0, 0.0, LIDAR_Z_M]))
    depth_m = View(moment.scenery, camera, world_T_camera).depth_m[pixels[:, 1], pixels[:, 0]]
    right, down, forward = (rays(camera, pixels.astype(float)) * depth_m[:, None]).T
    distance_m = np.sqrt(right**2 + down**2 + forward**2)
    points = np.stack((forward, right, -down, np.exp(-ATTENUATION_PER_M * distance_m)), axis=-1)
    within: Float32 = points[distance_m <= RANGE_M].astype(np.float32)
    return within


@lru_cache(maxsize=1)
def _rays() -> tuple[Camera, NDArray[np.intp]]:
    """A camera that holds all rays, and the (N, 2) pixels nearest to them, ring by ring from above, left to right."""
    half = FIELD_DEG / 2
    azimuth = np.radians(np.arange(-half + STEP_DEG / 2, half, STEP_DEG))
    elevation = np.radians(np.linspace(*ELEVATION_DEG, CHANNELS))[:, None]
    columns = _FOCAL_PX * np.broadcast_to(np.tan(azimuth), (CHANNELS, len(azimuth)))
    rows = -_FOCAL_PX * np.tan(elevation) / np.cos(azimuth)
    pixels = np.rint(np.stack((columns, rows), axis=-1).reshape(-1, 2)).astype(np.intp)
    first, last = pixels.min(axis=0), pixels.max(axis=0)
    (width, height), (cx, cy) = last - first + 1, -first
    camera = Camera("lidar", int(width), int(height), _FOCAL_PX, _FOCAL_PX, float(cx), float(cy))
    return camera, pixels - first
