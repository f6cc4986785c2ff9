"""The cameras of a recording: intrinsics, frames and mountings, from a calibration and the images' sizes.

CARLA (Unreal) is left-handed: x forward, y right, z up; rotations are yaw about z (to the right), then pitch (nose up),
then roll (right side down), in degrees, with the matrix of ``carla::geom::Transform::GetMatrix``. Mirroring y turns it
into ROS' x forward, y left, z up: with M = diag(1, -1, 1) the rotation becomes M R M. In angles that is roll, -pitch,
-yaw for Rz(yaw) Ry(pitch) Rx(roll), and y becomes -y in positions.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.config.calibration import CalibrationConfig, CarlaPose, Intrinsics
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import EGO_R_OPTICAL, Camera, Float, Lens, mounting, pinhole_fault, rigid
from roadperc_stream.geometry.cameras import Pinhole, pinhole_of_fov, pinhole_of_K
from roadperc_stream.geometry.rectification import lens_fault
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input.projections import ProjectionPair, decompose_pair
from roadperc_stream.model import EGO, Reason, Transform
from roadperc_stream.schemas.role_names import role_of

FRONT: Final = "camera_front"
DEPTH: Final = "camera_depth"
LEFT: Final = "camera_left"
RIGHT: Final = "camera_right"
LIDAR: Final = "lidar"
CAMERA_ROLES: Final = ("image", "segmentation", "depth", "left", "right")
"""Sensors with a camera; the first one in a dump is the front camera."""
_SAME_M: Final = 1e-6
_BASELINE_SLACK: Final = 0.01
Size = tuple[int, int]
"""Columns and rows."""


@dataclass(frozen=True)
class Rig:
    """Cameras by calibration role, the frame of each sensor, and the known transforms."""

    cameras: Mapping[str, Camera]
    frame_ids: Mapping[str, str]
    transforms: tuple[Transform, ...]
    notes: tuple[str, ...] = ()
    stated_baseline_m: float | None = None
    """Baseline of the calibration; needed for disparity images without the right camera."""

    @property
    def baseline_m(self) -> float | None:
        """Return the distance of the right camera, if it is known."""
        right = self.cameras.get("right_calibration")
        return (right and right.baseline_m) or self.stated_baseline_m

    def camera_of(self, role: str) -> Camera:
        """Return the camera of a sensor's files."""
        own = self.cameras.get(f"{role.removeprefix('truth_')}_calibration")
        return own or self.cameras["calibration"]


@dataclass(frozen=True)
class _Known:
    """The calibration by role."""

    file: CalibrationConfig
    path: Path
    sizes: Mapping[str, Size]
    pair: ProjectionPair | None
    mountings: Mapping[str, Float]
    """ego_T_camera."""
    intrinsics: Mapping[str, Intrinsics]
    ego_T_lidar: Float | None


def right_handed(pose: CarlaPose) -> Float:
    """Return (4, 4) right-handed parent_T_body of a CARLA pose, metres."""
    roll, pitch, yaw = np.deg2rad((pose.roll, -pose.pitch, -pose.yaw))
    return rigid(rotation_from_rpy(roll, pitch, yaw), np.array([pose.x, -pose.y, pose.z]))


def camera_mounting(pose: CarlaPose) -> Float:
    """Return ego_T_camera (optical frame) of a camera mounted at a CARLA pose in the ego frame."""
    return right_handed(pose) @ rigid(EGO_R_OPTICAL, np.zeros(3))


def build_rig(
    calibration: CalibrationConfig,
    path: Path,
    roles: Collection[str],
    sizes: Mapping[str, Size],
    *,
    front_name: str = "image",
) -> Rig:
    """Return the cameras of a dump's sensors.

    Args:
        calibration: calibration of the dump, with the options of the command line.
        path: file of the calibration, for messages.
        roles: sensors in the dump.
        sizes: columns and rows of the sensors' images, if their headers give them.
        front_name: name of the front camera in ``calibration``: ``left`` if it is the left camera of a pair.

    Raises:
        DumpError: a camera has no intrinsics or size, or a mounting contradicts the baseline.
    """
    known = _known(calibration, path, sizes, front_name)
    front_role = next(role for role in CAMERA_ROLES if role in roles)
    front = _camera(known, FRONT, front_role)
    front_T = known.mountings.get(front_role, known.mountings.get("image"))
    depth_T = known.mountings.get("depth", front_T)
    has_depth = bool({"depth", "truth_depth"} & set(roles)) and front_role != "depth"
    depth_frame = DEPTH if has_depth and not _same(depth_T, front_T) else FRONT
    cameras, transforms = {"calibration": front}, _edge(EGO, FRONT, front_T)
    if has_depth:
        depth = _camera(known, depth_frame, "depth")
        if depth.lens is not None and depth.lens.R != Lens.R:
            raise DumpError(f"{path}: R turns the image, but depth along its axis cannot be turned: remove R")
        cameras |= {} if depth.same_view(front) else {"depth_calibration": depth}
    transforms += _edge(EGO, DEPTH, depth_T) if depth_frame == DEPTH else ()
    if "left" in roles:
        cameras["left_calibration"] = _camera(known, LEFT, "left")
        transforms += _edge(EGO, LEFT, known.mountings.get("left"))
    if "right" in roles and front_role != "right":
        base, base_T = (LEFT, known.mountings.get("left")) if "left" in roles else (FRONT, front_T)
        baseline_m = _baseline(known, base_T)
        cameras["right_calibration"] = replace(_camera(known, RIGHT, "right"), baseline_m=baseline_m)
        transforms += _right_edge(known, base, base_T, baseline_m)
    transforms += _edge(EGO, LIDAR, known.ego_T_lidar) if LIDAR in roles else ()
    frame_ids = {"depth": depth_frame, "truth_depth": depth_frame, "left": LEFT, "right": RIGHT, "lidar": LIDAR}
    return Rig(cameras, frame_ids, transforms, tuple(_notes(known, front_T, cameras, roles)), _stated(known))


NO_RIG: Final = Rig({}, {}, ())


@dataclass(frozen=True)
class LogSensor:
    """A sensor of a log: the frame and, for a camera, the size of its first readable message."""

    topic: str
    frame_id: str
    size: Size | None = None


def replacing_rig(calibration: CalibrationConfig, sensors: Mapping[str, LogSensor], front: str) -> Rig:
    """The cameras and mountings that a calibration gives to the sensors of a log, by role; others stay.

    K, a field of view or a pair at the top are those of the front camera, whose role is ``front``.

    Raises:
        DumpError: the calibration is wrong, incomplete, or of images of another size.
    """
    sizes = {role: sensor.size for role, sensor in sensors.items() if sensor.size}
    known = _known(calibration, Path("calibration"), sizes, front)
    named = {role for role in sensors if role in known.intrinsics or (known.pair and role in ("left", "right"))}
    file, front_T = known.file, known.mountings.get(front, known.mountings.get("image"))
    baseline_m = _baseline(known, known.mountings.get("left", front_T))
    at_top = bool(file.K or file.fov_deg or known.pair)
    named |= {front} if at_top else set()
    named |= {"right"} if at_top and baseline_m and "right" in sensors else set()
    cameras = {own_calibration(role): _camera(known, sensors[role].frame_id, role) for role in sorted(named)}
    if "right" in named:
        cameras["right_calibration"] = replace(cameras["right_calibration"], baseline_m=baseline_m)
    for role in named:
        _require_size(sensors[role], cameras[own_calibration(role)])
    mountings = {**known.mountings, front: front_T, LIDAR: known.ego_T_lidar}
    placed: dict[str, Transform] = {}
    for role, sensor in sensors.items():
        for edge in _edge(EGO, sensor.frame_id, mountings.get(role)):
            if not np.array_equal(placed.setdefault(edge.child, edge).parent_T_child, edge.parent_T_child):
                raise DumpError(f"calibration: two mountings of the frame {edge.child!r}, also of {role}; remove one")
    return Rig(cameras, {}, tuple(placed.values()))


def own_calibration(role: str) -> str:
    """The role of the calibration of a sensor's camera."""
    return "calibration" if role in ("image", "segmentation") else f"{role}_calibration"


def calibration_role(reference: str, cameras: Mapping[str, Camera]) -> str:
    """The role of the calibration of the frames' camera: its own one, else that of the front camera."""
    own = own_calibration(reference)
    return own if own in cameras else "calibration"


def _require_size(sensor: LogSensor, camera: Camera) -> None:
    if sensor.size is not None and sensor.size != (camera.width, camera.height):
        found, expected = f"{sensor.size[0]}x{sensor.size[1]}", f"{camera.width}x{camera.height}"
        raise DumpError(
            f"{sensor.topic}: images of {found}, but the given calibration is of {expected}; "
            "pass that of this resolution"
        )


def _known(calibration: CalibrationConfig, path: Path, sizes: Mapping[str, Size], front_name: str) -> _Known:
    pair = None
    if calibration.P_left is not None and calibration.P_right is not None:
        pair = decompose_pair(path, np.array(calibration.P_left), np.array(calibration.P_right))
    heights = {"image": calibration.rgb_height_m, "depth": calibration.depth_height_m}
    mountings = {role: mounting(z=height) for role, height in heights.items() if height is not None}
    mountings |= {role_of(name) or name: camera_mounting(pose) for name, pose in calibration.mounting.items()}
    of_lidar = [right_handed(pose) for name, pose in calibration.mounting.items() if role_of(name) == LIDAR]
    intrinsics = {role_of(name) or name: camera for name, camera in calibration.cameras.items()}
    if front_name in mountings:
        mountings["image"] = mountings[front_name]
    if front_name in intrinsics:
        intrinsics["image"] = intrinsics[front_name]
    return _Known(calibration, path, sizes, pair, mountings, intrinsics, of_lidar[0] if of_lidar else None)


def _camera(known: _Known, frame_id: str, role: str) -> Camera:
    own = known.intrinsics.get(role)
    source: Intrinsics = own or known.file
    width, height = _size(known, frame_id, role, source)
    of_pair = None
    if known.pair and own is None:
        of_pair = known.pair.K_right if role == "right" else known.pair.K_left
    K = of_pair if source.K is None else np.array(source.K)
    if source.fov_deg is not None and source.K is None:
        return Camera(frame_id, width, height, *pinhole_of_fov(source.fov_deg, width, height))
    if K is None:
        raise DumpError(
            f"{frame_id} has no calibration: pass --fov DEGREES (horizontal field of view) or --calibration FILE "
            f"(camera_info YAML of ROS, or JSON), or write K or fov_deg into {known.path}"
        )
    return _with_lens(known, Camera(frame_id, width, height, *_pinhole(known, K)), source)


def _pinhole(known: _Known, K: Float) -> Pinhole:
    return pinhole_of_K(K, known.file.pixel_origin)


def _with_lens(known: _Known, camera: Camera, source: Intrinsics) -> Camera:
    """Return the camera with its distortion; P gives the intrinsics of the rectified image, else K.

    Raises:
        DumpError: the lens is impossible or unknown.
    """
    P = None if source.P is None or not source.P[0][0] else np.array(source.P)
    target = _pinhole(known, P[:, :3]) if P is not None else (camera.fx, camera.fy, camera.cx, camera.cy)
    turn = Lens.R if source.R is None else tuple(value for row in source.R for value in row)
    lens = Lens(camera.fx, camera.fy, camera.cx, camera.cy, turn, source.distortion_model)
    fx, fy, cx, cy = target
    distorted = replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=source.D, lens=lens)
    if not any(source.D) and turn == Lens.R and camera.same_view(distorted):
        return camera
    fault = lens_fault(distorted) or pinhole_fault(camera.width, camera.height, *target)
    if fault:
        text = fault if isinstance(fault, str) else Reason("", fault[0], ("front", *fault[1])).text
        raise DumpError(f"{known.path}: {text}")
    return distorted


def _size(known: _Known, frame_id: str, role: str, source: Intrinsics) -> Size:
    if source.width and source.height:
        return source.width, source.height
    seen = known.sizes.get(role) or next(iter(known.sizes.values()), None)
    if seen is None:
        raise DumpError(f"{frame_id}: its image size is unknown; add width and height to {known.path}")
    return seen


def _same(a: Float | None, b: Float | None) -> bool:
    return a is b if a is None or b is None else bool(np.allclose(a, b, atol=_SAME_M))


def _edge(parent: str, child: str, parent_T_child: Float | None) -> tuple[Transform, ...]:
    return () if parent_T_child is None else (Transform(parent, child, parent_T_child),)


def _right_edge(known: _Known, base: str, base_T: Float | None, baseline_m: float | None) -> tuple[Transform, ...]:
    """Return the transform from ego if a mounting is known, else from the other camera of the pair."""
    if "right" in known.mountings:
        return _edge(EGO, RIGHT, known.mountings["right"])
    if baseline_m is None:
        return ()
    shift = rigid(np.eye(3), np.array([baseline_m, 0.0, 0.0]))
    return _edge(base, RIGHT, shift) if base_T is None else _edge(EGO, RIGHT, base_T @ shift)


def _baseline(known: _Known, base_T: Float | None) -> float | None:
    """Return the baseline in metres from the calibration or the mountings, which must agree."""
    stated = _stated(known)
    right_T = known.mountings.get("right")
    if base_T is None or right_T is None:
        return stated
    offset = base_T[:3, :3].T @ (right_T[:3, 3] - base_T[:3, 3])
    mounted = float(np.linalg.norm(offset))
    if mounted == 0 or offset[0] < (1 - _BASELINE_SLACK) * mounted:
        raise DumpError(
            f"{known.path}: mounting: the right camera is not to the right of the other camera, along its rows"
        )
    if stated is not None and abs(stated - mounted) > _BASELINE_SLACK * stated:
        raise DumpError(
            f"{known.path}: baseline {stated:g} m, but the mountings are {mounted:g} m apart; correct one of them"
        )
    return stated or mounted


def _stated(known: _Known) -> float | None:
    return known.file.baseline_m or (known.pair.baseline_m if known.pair else None)


def _notes(
    known: _Known, front_T: Float | None, cameras: Mapping[str, Camera], roles: Collection[str]
) -> Iterator[str]:
    """Yield notes about unused, contradictory or missing entries of the calibration."""
    for name in dict.fromkeys((*known.file.mounting, *known.file.cameras)):
        if role_of(name) is None:
            yield f"{known.path.name}: {name!r} is not a known sensor: left out"
    if "segmentation" in known.mountings and not _same(known.mountings["segmentation"], front_T):
        yield "the segmentation camera is not mounted where the front camera is: tags and image do not align"
    skewed = {(camera.fx, camera.fy): camera for camera in cameras.values() if not camera.square_pixels}
    for camera in skewed.values():
        yield (
            f"{camera.frame_id}: fx {camera.fx:g} and fy {camera.fy:g} of {known.path.name} differ by more than 5 %. "
            "Nearly all cameras have square pixels. If one value is wrong, heights and pitch are wrong"
        )
    yield from _stereo_notes(known, cameras)
    if LIDAR in roles and known.ego_T_lidar is None:
        yield f'the mounting of the lidar is unknown, so its points are not used; add "mounting" to {known.path.name}'


def _stereo_notes(known: _Known, cameras: Mapping[str, Camera]) -> list[str]:
    right = cameras.get("right_calibration")
    if right is None:
        return []
    if right.baseline_m is None:
        return [f'stereo baseline unknown; add "baseline_m" or "mounting" to {known.path.name}']
    if known.pair is None or known.pair.along_rows:
        return []
    return [
        "the centres of the projection matrices differ along another axis than the image's rows. The pair counts as "
        f"rectified along rows with their distance {known.pair.baseline_m:g} m as baseline "
        f"(right P = -fx * {right.baseline_m:g})"
    ]
