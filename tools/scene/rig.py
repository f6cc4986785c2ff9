"""The cameras on the car."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from roadperc_stream.core.geometry import EGO_R_OPTICAL, Camera, Float, rigid

from .options import Mount

BASELINE_M: Final = 0.5


@dataclass(frozen=True)
class CameraPair:
    """The front camera and its fellow on the right: the same pinhole twice, fixed to the car."""

    camera: Camera
    ego_T_left: Float
    ego_T_right: Float
    mount: Mount

    @property
    def height_m(self) -> float:
        """Of the front camera over the ego origin."""
        return self.mount[2]


def make_rig(width: int, height: int, fov_deg: float, mount: Mount) -> CameraPair:
    """Cameras of a size in pixels; their centre is CARLA's w / 2 counted from the corner of the first pixel.

    Args:
        width: of the images.
        height: of the images.
        fov_deg: horizontal field of view.
        mount: the front camera's place as CARLA has it: x forward, y right, z up, then roll, pitch (up) and yaw (to
            the right) in degrees.
    """
    half = width / 2
    focal = half if fov_deg == 90.0 else half / float(np.tan(np.radians(fov_deg) / 2))
    camera = Camera("front", width, height, focal, focal, half - 0.5, height / 2 - 0.5)
    x, y, z, roll, pitch, yaw = mount
    axes = Rotation.from_euler("ZYX", (-yaw, -pitch, roll), degrees=True).as_matrix()
    body = rigid(axes, np.array([x, -y, z]))
    optical = rigid(EGO_R_OPTICAL, np.zeros(3))
    beside = rigid(np.eye(3), np.array([0.0, -BASELINE_M, 0.0]))
    return CameraPair(camera, body @ optical, body @ beside @ optical, mount)


def carla_mountings(rig: CameraPair) -> dict[str, dict[str, float]]:
    """Of the front camera (``front``) and the right one, as ``calibration.json`` has it."""
    _, _, _, roll, pitch, yaw = rig.mount
    return {
        name: {
            "x": round(float(ego_T_camera[0, 3]), 7),
            "y": round(0.0 - float(ego_T_camera[1, 3]), 7),
            "z": round(float(ego_T_camera[2, 3]), 7),
            "roll": roll,
            "pitch": pitch,
            "yaw": yaw,
        }
        for name, ego_T_camera in (("front", rig.ego_T_left), ("right", rig.ego_T_right))
    }
