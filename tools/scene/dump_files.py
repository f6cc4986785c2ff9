"""Write the files of a dump in CARLA's formats and conventions."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, Float32
from roadperc_stream.system.files import completing_folder

from .cameras import BASELINE_M, LIDAR_Z_M, CameraPair
from .ground import FAR_M
from .options import SENSORS, RenderOptions

JPEG_QUALITY: Final = 90
CARLA_VERSION: Final = "0.9.15"
DEPTH_CODES: Final = 2**24 - 1
LIDAR: Final = "lidar"
INSTANCES: Final = "instance_segmentation"
MARK: Final = "truth.json"
"""A folder with this file is an earlier dump of this renderer."""
_FILES: Final = ("calibration.json", "detections.json", "poses.json", "timestamps.txt", MARK)
_OWN: Final = frozenset((*SENSORS, LIDAR, INSTANCES, "truth", *_FILES))


@contextmanager
def new_dump(folder: Path, *, force: bool) -> Iterator[Path]:
    """Yield a hidden folder to render into; it replaces ``folder`` when the dump is complete.

    With ``force`` it replaces the files of an earlier dump. Other files in the folder stay.

    Raises:
        DumpError: the path is a file, or the folder is not empty and ``force`` is False.
        TargetError: the folder cannot be created.
    """
    if folder.exists() and not folder.is_dir():
        raise DumpError(f"{folder}: expected a folder, found a file; choose another name")
    if folder.is_dir() and any(folder.iterdir()):
        if not force:
            raise DumpError(f"{folder}: exists and is not empty; pass --force to replace an earlier dump in it")
        if not (folder / MARK).is_file():
            raise DumpError(f"{folder}: refusing to replace it: not a dump of roadperc-render ({MARK} is missing)")
    with completing_folder(folder, keep=lambda entry: entry.name not in _OWN) as hidden:
        yield hidden


def write_file(path: Path, data: bytes) -> None:
    """Write a file of a dump and create its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def write_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture as PNG or JPEG; the suffix of the path decides."""
    settings = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if path.suffix == ".jpg" else []
    _, encoded = cv2.imencode(path.suffix, picture, settings)
    write_file(path, encoded.tobytes())


def write_points(path: Path, points: Float32) -> None:
    """Write (N, 4) x, y, z, intensity as ``carla.LidarMeasurement.save_to_disk`` does: PLY text with four decimals."""
    properties = "".join(f"property float32 {name}\n" for name in "xyzI")
    header = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{properties}end_header\n"
    lines = "%.4f %.4f %.4f %.4f\n" * len(points) % tuple(points.ravel().tolist())
    write_file(path, (header + lines).encode())


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write compact JSON; round the floats before."""
    write_file(path, (json.dumps(content, separators=(",", ":")) + "\n").encode())


def depth_picture(depth_m: Float32) -> NDArray[np.uint8]:
    """Return (H, W, 3) BGR of CARLA's 24-bit depth: metres = (R + 256 G + 65536 B) / (2^24 - 1) * 1000."""
    codes = np.rint(depth_m.astype(np.float64) * (DEPTH_CODES / FAR_M)).astype("<u4")
    bytes_low_first = codes.view(np.uint8).reshape(*depth_m.shape, 4)
    return np.asarray(cv2.cvtColor(bytes_low_first, cv2.COLOR_RGBA2BGR), np.uint8)


def tags_picture(tags: NDArray[np.uint8], ids: NDArray[np.int32] | int = 0) -> NDArray[np.uint8]:
    """Return (H, W, 3) BGR in CARLA's coding: red is the tag.

    Green and blue are the low and high byte of the instance id (H, W), 0 for no object.
    """
    low, high = (np.broadcast_to(np.asarray(byte), tags.shape) for byte in (ids & 255, ids >> 8 & 255))
    return np.dstack((high, low, tags)).astype(np.uint8)


def calibration(rig: CameraPair, options: RenderOptions) -> dict[str, Any]:
    """Return the calibration file; as in CARLA, K counts the principal point from the corner of the first pixel."""
    camera, K = rig.camera, rig.camera.K
    K[:2, 2] += 0.5
    _, _, _, roll, pitch, yaw = options.mount
    mountings = {}
    for sensor in SENSORS:
        x, y, z = (float(c) for c in (rig.ego_T_right if sensor == "right" else rig.ego_T_left)[:3, 3])
        position = {"x": round(x, 7), "y": round(0.0 - y, 7), "z": round(z, 7)}
        mountings[sensor] = {**position, "roll": roll, "pitch": pitch, "yaw": yaw}
    if options.lidar:
        mountings[LIDAR] = {"x": 0.0, "y": 0.0, "z": LIDAR_Z_M, "roll": 0.0, "pitch": 0.0, "yaw": 0.0}
    return {
        "width": camera.width,
        "height": camera.height,
        "K": K.tolist(),
        "carla_tags": CARLA_VERSION,
        "rate_hz": options.rate_hz,
        "baseline_m": BASELINE_M,
        "mounting": mountings,
    }


def carla_transform(world_T_ego: Float) -> dict[str, dict[str, float]]:
    """Return a pose as CARLA writes it: y right, degrees, pitch nose up, yaw right, roll right side down.

    Source: Unreal's FRotator. Mirroring y changes the signs of ROS's pitch and yaw, not of roll.
    """
    x, y, z = (float(c) for c in world_T_ego[:3, 3])
    yaw, pitch, roll = (float(a) for a in Rotation.from_matrix(world_T_ego[:3, :3]).as_euler("ZYX", degrees=True))
    return {
        "location": {"x": round(x, 7), "y": round(-y, 7), "z": round(z, 7)},
        "rotation": {"pitch": round(-pitch, 8), "yaw": round(-yaw, 8), "roll": round(roll, 8)},
    }
