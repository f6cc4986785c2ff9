"""The cameras of a recording: intrinsics, frames and mountings, from a calibration and the images' sizes."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np

from roadperc_stream.config.calibration import CalibrationConfig
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera, Float, Lens, pinhole_fault, rigid
from roadperc_stream.geometry.cameras import pinhole_of_K
from roadperc_stream.input.calibrations import LIDAR, GivenCalibration, Size
from roadperc_stream.input.projections import require_pinhole
from roadperc_stream.model import EGO, Transform
from roadperc_stream.schemas.role_names import role_of

FRONT: Final = "camera_front"
DEPTH: Final = "camera_depth"
LEFT: Final = "camera_left"
RIGHT: Final = "camera_right"
CAMERA_ROLES: Final = ("image", "segmentation", "depth", "left", "right")
"""Sensors with a camera; the first one in a dump is the front camera."""
_SAME_M: Final = 1e-6


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
    known = GivenCalibration.of(calibration, path, sizes, front_name)
    front_role = next(role for role in CAMERA_ROLES if role in roles)
    front = known.camera(FRONT, front_role)
    front_T = known.mountings.get(front_role, known.mountings.get("image"))
    depth_T = known.mountings.get("depth", front_T)
    has_depth = bool({"depth", "truth_depth"} & set(roles)) and front_role != "depth"
    depth_frame = DEPTH if has_depth and not _same(depth_T, front_T) else FRONT
    cameras, transforms = {"calibration": front}, _edge(EGO, FRONT, front_T)
    if has_depth:
        depth = known.camera(depth_frame, "depth")
        if depth.lens is not None and depth.lens.R != Lens.R:
            raise DumpError(f"{path}: R turns the image, but depth along its axis cannot be turned: remove R")
        cameras |= {} if depth.same_view(front) else {"depth_calibration": depth}
    transforms += _edge(EGO, DEPTH, depth_T) if depth_frame == DEPTH else ()
    if "left" in roles:
        cameras["left_calibration"] = known.camera(LEFT, "left")
        transforms += _edge(EGO, LEFT, known.mountings.get("left"))
    if "right" in roles and front_role != "right":
        base, base_T = (LEFT, known.mountings.get("left")) if "left" in roles else (FRONT, front_T)
        baseline_m = known.baseline_m(base_T)
        cameras["right_calibration"] = replace(known.camera(RIGHT, "right"), baseline_m=baseline_m)
        transforms += _right_edge(known, base, base_T, baseline_m)
    transforms += _edge(EGO, LIDAR, known.mountings.get(LIDAR)) if LIDAR in roles else ()
    frame_ids = {"depth": depth_frame, "truth_depth": depth_frame, "left": LEFT, "right": RIGHT, "lidar": LIDAR}
    notes = tuple(_notes(known, front_T, cameras, roles))
    return Rig(cameras, frame_ids, transforms, notes, known.stated_baseline_m)


def front_rig(
    where: str,
    size: Size | None,
    K: Float,
    origin: Literal["corner", "centre"],
    mountings: tuple[Float, Float | None],
) -> Rig:
    """Return the rig of a dataset with one front camera, whose depth and tags have the same view, and a lidar.

    Args:
        where: file and key of K, for messages.
        size: columns and rows of the images.
        K: (3, 3); its principal point counts from the first pixel's ``origin``.
        origin: corner or centre.
        mountings: (4, 4) ego_T_camera, and ego_T_lidar if there is a lidar.

    Raises:
        DumpError: K is not that of a camera with such images.
    """
    if K.shape != (3, 3):
        raise DumpError(f"{where}: expected 3 rows of 3 numbers, found {K.size} numbers")
    require_pinhole(where, K)
    (width, height), pinhole = size or (0, 0), pinhole_of_K(K, origin)
    if fault := pinhole_fault(width, height, *pinhole):
        raise DumpError(f"{where}: {fault}")
    edges = zip((FRONT, LIDAR), mountings, strict=True)
    transforms = tuple(Transform(EGO, frame, pose) for frame, pose in edges if pose is not None)
    return Rig({"calibration": Camera(FRONT, width, height, *pinhole)}, {"depth": FRONT, LIDAR: LIDAR}, transforms)


def _same(a: Float | None, b: Float | None) -> bool:
    return a is b if a is None or b is None else bool(np.allclose(a, b, atol=_SAME_M))


def _edge(parent: str, child: str, parent_T_child: Float | None) -> tuple[Transform, ...]:
    return () if parent_T_child is None else (Transform(parent, child, parent_T_child),)


def _right_edge(
    known: GivenCalibration, base: str, base_T: Float | None, baseline_m: float | None
) -> tuple[Transform, ...]:
    """Return the transform from ego if a mounting is known, else from the other camera of the pair."""
    if "right" in known.mountings:
        return _edge(EGO, RIGHT, known.mountings["right"])
    if baseline_m is None:
        return ()
    shift = rigid(np.eye(3), np.array([baseline_m, 0.0, 0.0]))
    return _edge(base, RIGHT, shift) if base_T is None else _edge(EGO, RIGHT, base_T @ shift)


def _notes(
    known: GivenCalibration, front_T: Float | None, cameras: Mapping[str, Camera], roles: Collection[str]
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
    if LIDAR in roles and LIDAR not in known.mountings:
        yield f'the mounting of the lidar is unknown, so its points are not used; add "mounting" to {known.path.name}'


def _stereo_notes(known: GivenCalibration, cameras: Mapping[str, Camera]) -> list[str]:
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
