"""The cameras and mountings that a calibration file or the options give.

CARLA (Unreal) is left-handed: x forward, y right, z up; rotations are yaw about z (to the right), then pitch (nose up),
then roll (right side down), in degrees, with the matrix of ``carla::geom::Transform::GetMatrix``. Mirroring y turns it
into ROS' x forward, y left, z up: with M = diag(1, -1, 1) the rotation becomes M R M. In angles that is roll, -pitch,
-yaw for Rz(yaw) Ry(pitch) Rx(roll), and y becomes -y in positions.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.config.calibration import CalibrationConfig, CarlaPose, Intrinsics
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import EGO_R_OPTICAL, Camera, Float, Lens, mounting, pinhole_fault, rigid
from roadperc_stream.geometry.cameras import pinhole_of_fov, pinhole_of_K
from roadperc_stream.geometry.rectification import lens_fault
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input.projections import ProjectionPair, decompose_pair
from roadperc_stream.model import Reason
from roadperc_stream.schemas.role_names import role_of

LIDAR: Final = "lidar"
_BASELINE_SLACK: Final = 0.01
Size = tuple[int, int]
"""Columns and rows."""


def right_handed(pose: CarlaPose) -> Float:
    """Return (4, 4) right-handed parent_T_body of a CARLA pose, metres."""
    roll, pitch, yaw = np.deg2rad((pose.roll, -pose.pitch, -pose.yaw))
    return rigid(rotation_from_rpy(roll, pitch, yaw), np.array([pose.x, -pose.y, pose.z]))


def camera_mounting(pose: CarlaPose) -> Float:
    """Return ego_T_camera (optical frame) of a camera mounted at a CARLA pose in the ego frame."""
    return right_handed(pose) @ rigid(EGO_R_OPTICAL, np.zeros(3))


@dataclass(frozen=True)
class GivenCalibration:
    """A calibration by the roles of its sensors. ``path`` names it in messages."""

    file: CalibrationConfig
    path: Path
    sizes: Mapping[str, Size]
    """Columns and rows of the sensors' images."""
    pair: ProjectionPair | None
    mountings: Mapping[str, Float]
    """ego_T_camera, and ego_T_lidar."""
    intrinsics: Mapping[str, Intrinsics]

    @classmethod
    def of(
        cls, calibration: CalibrationConfig, path: Path, sizes: Mapping[str, Size], front_name: str
    ) -> "GivenCalibration":
        """The calibration; ``front_name`` is the name of the front camera in it.

        Raises:
            DumpError: the projection matrices are no pair.
        """
        pair = None
        if calibration.P_left is not None and calibration.P_right is not None:
            pair = decompose_pair(path, np.array(calibration.P_left), np.array(calibration.P_right))
        heights = {"image": calibration.rgb_height_m, "depth": calibration.depth_height_m}
        mountings = {role: mounting(z=height) for role, height in heights.items() if height is not None}
        for name, pose in calibration.mounting.items():
            role = role_of(name) or name
            mountings[role] = right_handed(pose) if role == LIDAR else camera_mounting(pose)
        intrinsics = {role_of(name) or name: camera for name, camera in calibration.cameras.items()}
        if front_name in mountings:
            mountings["image"] = mountings[front_name]
        if front_name in intrinsics:
            intrinsics["image"] = intrinsics[front_name]
        return cls(calibration, path, sizes, pair, mountings, intrinsics)

    @property
    def stated_baseline_m(self) -> float | None:
        """The baseline that is written in the calibration."""
        return self.file.baseline_m or (self.pair.baseline_m if self.pair else None)

    def baseline_m(self, base_T: Float | None) -> float | None:
        """The baseline from the calibration or the mountings; ``base_T`` is the mounting of the left camera.

        Raises:
            DumpError: they do not agree.
        """
        stated, right_T = self.stated_baseline_m, self.mountings.get("right")
        if base_T is None or right_T is None:
            return stated
        offset = base_T[:3, :3].T @ (right_T[:3, 3] - base_T[:3, 3])
        mounted = float(np.linalg.norm(offset))
        if mounted == 0 or offset[0] < (1 - _BASELINE_SLACK) * mounted:
            raise DumpError(
                f"{self.path}: mounting: the right camera is not to the right of the other camera, along its rows"
            )
        if stated is not None and abs(stated - mounted) > _BASELINE_SLACK * stated:
            raise DumpError(
                f"{self.path}: baseline {stated:g} m, but the mountings are {mounted:g} m apart; correct one of them"
            )
        return stated or mounted

    def camera(self, frame_id: str, role: str) -> Camera:
        """The camera of a role.

        Raises:
            DumpError: it has no intrinsics or size, or an impossible lens.
        """
        own = self.intrinsics.get(role)
        source: Intrinsics = own or self.file
        width, height = self._size(frame_id, role, source)
        if source.fov_deg is not None and source.K is None:
            return Camera(frame_id, width, height, *pinhole_of_fov(source.fov_deg, width, height))
        K = None if source.K is None else np.array(source.K)
        if K is None and self.pair and own is None:
            K = self.pair.K_right if role == "right" else self.pair.K_left
        if K is None:
            raise DumpError(
                f"{frame_id} has no calibration: pass --fov DEGREES (horizontal field of view) or --calibration FILE "
                f"(camera_info YAML of ROS, or JSON), or write K or fov_deg into {self.path}"
            )
        pinhole = pinhole_of_K(K, self.file.pixel_origin)
        return self._with_lens(Camera(frame_id, width, height, *pinhole), source)

    def _size(self, frame_id: str, role: str, source: Intrinsics) -> Size:
        if source.width and source.height:
            return source.width, source.height
        seen = self.sizes.get(role) or next(iter(self.sizes.values()), None)
        if seen is None:
            raise DumpError(f"{frame_id}: its image size is unknown; add width and height to {self.path}")
        return seen

    def _with_lens(self, camera: Camera, source: Intrinsics) -> Camera:
        """The camera with its distortion; P gives the intrinsics of the rectified image, else K."""
        fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
        turn = Lens.R if source.R is None else tuple(value for row in source.R for value in row)
        lens = Lens(fx, fy, cx, cy, turn, source.distortion_model)
        if source.P is not None and source.P[0][0]:
            fx, fy, cx, cy = pinhole_of_K(np.array(source.P)[:, :3], self.file.pixel_origin)
        distorted = replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=source.D, lens=lens)
        if not any(source.D) and turn == Lens.R and camera.same_view(distorted):
            return camera
        fault = lens_fault(distorted) or pinhole_fault(camera.width, camera.height, fx, fy, cx, cy)
        if fault:
            text = fault if isinstance(fault, str) else Reason("", fault[0], ("front", *fault[1])).text
            raise DumpError(f"{self.path}: {text}")
        return distorted


def own_calibration(role: str) -> str:
    """The role of the calibration of a sensor's camera."""
    return "calibration" if role in ("image", "segmentation") else f"{role}_calibration"


def calibration_role(reference: str, cameras: Mapping[str, Camera]) -> str:
    """The role of the calibration of the frames' camera: its own one, else that of the front camera."""
    own = own_calibration(reference)
    return own if own in cameras else "calibration"
