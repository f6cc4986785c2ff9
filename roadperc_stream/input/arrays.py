"""Checks the arrays, poses and detections of an API caller and converts them for a frame."""

import operator
from collections.abc import Callable, Iterable
from math import acos, degrees, isfinite
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadperc_stream.errors import ConfigError
from roadperc_stream.geometry import Camera, Float, is_rotation, pinhole_fault
from roadperc_stream.model import Box, CameraImage, DepthImage, Detection, Image, TagImage
from roadperc_stream.model.tag_tables import TagTable

_MOST_ASIDE_DEG: Final = 80.0
"""Largest angle of the optical axis to ego's x axis; the chain needs the road ahead in the image."""
_ROTATION_TOLERANCE: Final = 1e-3
"""Tolerance for R @ R.T, so that rotations written with four digits pass."""


def checked_stamp_ns(stamp_ns: Any) -> int:
    """A stamp of any integer type, such as numpy's.

    Raises:
        TypeError: not an integer.
    """
    try:
        return operator.index(stamp_ns)
    except TypeError:
        raise TypeError(f"stamp_ns: expected whole nanoseconds, found {stamp_ns!r}") from None


def checked_camera(name: str, camera: Any) -> Camera:
    """The camera, checked.

    Raises:
        TypeError: not a Camera.
        ValueError: its size, focal lengths or principal point are impossible.
    """
    if not isinstance(camera, Camera):
        raise TypeError(f"{name}: expected a Camera, found {type(camera).__name__}")
    if camera.width < 1 or camera.height < 1:
        raise ValueError(f"{name}: expected an image of one pixel or more, found {camera.width}x{camera.height}")
    fault = pinhole_fault(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    if fault:
        raise ValueError(f"{name}: {fault}")
    return camera


def checked_mounting(ego_T_camera: ArrayLike) -> Float:
    """A copy of the (4, 4) pose of a camera that looks ahead.

    Raises:
        ValueError: another shape, not finite, not a rotation and a translation, or the optical axis is far from ego's x
            axis, as with a matrix for another convention of axes.
    """
    pose = np.array(ego_T_camera, np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError(f"ego_T_camera: expected (4, 4) finite numbers, found {pose.shape}")
    R, last = pose[:3, :3], pose[3].tolist()
    if not is_rotation(R, _ROTATION_TOLERANCE):
        raise ValueError(f"ego_T_camera: expected a rotation in its first three rows and columns, found {R.tolist()}")
    if last != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError(f"ego_T_camera: expected 0, 0, 0, 1 in its last row, found {last}")
    axis = R[:, 2]
    aside_deg = degrees(acos(max(-1.0, min(1.0, float(axis[0])))))
    if aside_deg > _MOST_ASIDE_DEG:
        names = (("ahead", "back"), ("left", "right"), ("up", "down"))
        main = int(np.argmax(np.abs(axis)))
        raise ValueError(
            f"ego_T_camera: the camera looks {names[main][int(axis[main] < 0)]}, {aside_deg:.0f} degrees from ego's x; "
            "expected a camera that looks ahead, with axes x right, y down, z forward; "
            "pass rp.mounting(x, y, z, roll, pitch, yaw)"
        )
    return pose


def camera_image(name: str, pixels: ArrayLike, camera: Camera) -> CameraImage:
    """A copy of an image of (H, W, 3) blue, green, red, or (H, W) grey, 0 to 255.

    Raises:
        ValueError: the pixels have another size or type.
    """
    found = _of_size(name, pixels, [camera.size, (*camera.size, 3)])
    if found.dtype != np.uint8:  # 0 to 255 of 65535 is nearly black
        raise ValueError(
            f"{name}: expected uint8, found {found.dtype}; scale it to 0 to 255, then pass astype(np.uint8)"
        )
    image: Image = np.array(found, order="C")
    return CameraImage(
        camera.frame_id, _converted(image, cv2.COLOR_GRAY2BGR, 2), _converted(image, cv2.COLOR_BGR2GRAY, 3)
    )


def tag_image(pixels: ArrayLike, camera: Camera, table: TagTable | None) -> TagImage:
    """A copy of (H, W) tags, 0 to 255.

    Raises:
        ConfigError: there is no table.
        ValueError: the tags have another size or type.
    """
    if table is None:
        raise ConfigError("tags: no tag table; pass one, such as Chain(camera, tag_table='0.9.15')")
    found = _of_size("tags", pixels, [camera.size])
    if not np.issubdtype(found.dtype, np.integer) or not 0 <= found.min() <= found.max() <= 255:
        raise ValueError(f"tags: expected integers of 0 to 255, found {found.dtype}, {found.min()} to {found.max()}")
    tags: Image = np.array(found, np.uint8, order="C")
    return TagImage(camera.frame_id, table, lambda: tags)


def depth_image(pixels: ArrayLike, camera: Camera) -> DepthImage:
    """A copy of (H, W) metres; 0 or less becomes NaN.

    Raises:
        ValueError: another size, or integers such as millimetres.
    """
    found = _of_size("depth_m", pixels, [camera.size])
    if not np.issubdtype(found.dtype, np.floating):
        raise ValueError(f"depth_m: expected metres as float32, found {found.dtype}: divide millimetres by 1000")
    metres = np.array(found, np.float32, order="C")
    metres[~(metres > 0)] = np.nan
    return DepthImage(camera.frame_id, lambda: (metres, np.inf))


def checked_detections(detections: Iterable[Any]) -> tuple[Detection, ...]:
    """Detections as they are.

    Raises:
        TypeError: a detection is not a Detection with a Box.
        ValueError: a box ends before it begins, or a number is not finite.
    """
    found = tuple(detections)
    for number, detection in enumerate(found):
        name = f"detections[{number}]"
        if not isinstance(detection, Detection):
            raise TypeError(f"{name}: expected a Detection, found {detection!r}")
        box = detection.box_px
        if not isinstance(box, Box):
            raise TypeError(f"{name}: expected box_px to be a Box, found {box!r}")
        if not (-np.inf < box.x_min <= box.x_max < np.inf and -np.inf < box.y_min <= box.y_max < np.inf):
            raise ValueError(f"{name}: expected x_min <= x_max and y_min <= y_max, found {box}")
        if not isfinite(detection.score):
            raise ValueError(f"{name}: expected a finite score, found {detection.score}")
    return found


def _of_size(name: str, pixels: ArrayLike, shapes: list[tuple[int, ...]]) -> NDArray[Any]:
    found = np.asarray(pixels)
    if found.shape not in shapes:
        raise ValueError(f"{name}: expected {' or '.join(map(str, shapes))} of the camera, found {found.shape}")
    return found


def _converted(image: Image, conversion: int, dimensions: int) -> Callable[[], Image]:
    """Gives the image, converted if it has that many dimensions."""
    if image.ndim != dimensions:
        return lambda: image
    return lambda: np.asarray(cv2.cvtColor(image, conversion), np.uint8)
