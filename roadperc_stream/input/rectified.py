"""Undoes a lens's distortion once, before the chain: a frame's images, tags, masks, depth and boxes.

The rectified image is that of the mounted camera: it has the intrinsics of P, but the rotation R of a stereo pair is
not applied, because that would turn the camera's mounting. The stereo stage gets the images as recorded, and applies R.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera
from roadperc_stream.geometry.rectification import (
    is_rectified,
    lens_fault,
    lens_of,
    not_turned,
    rectified,
    rectified_box,
    resampled,
)
from roadperc_stream.model import (
    Box,
    CameraImage,
    DepthImage,
    Detection,
    Frame,
    InstanceImage,
    Objects,
    TagImage,
    Truth,
)

P = TypeVar("P", np.uint8, np.uint16, np.float32)


def rectified_frame(frame: Frame) -> Frame:
    """The frame with rectified cameras; a lens that is impossible or unknown stays, with its images as recorded."""
    lens, of_depth = _distorted(frame.camera), _distorted(frame.depth_camera)
    if lens is not None:
        frame = _of_front(frame, lens)
    if of_depth is not None:
        depth = None if frame.depth is None else _depth(frame.depth, of_depth)
        frame = replace(frame, depth_camera=rectified(frame.depth_camera), depth=depth)
    return frame


def rectified_truth(truth: Truth, camera: Camera) -> Truth:
    """The truth in the rectified image of the front camera, whose calibration in the log is ``camera``."""
    lens = _distorted(camera)
    if lens is None:
        return truth
    depth, tags, objects = truth.depth, truth.segmentation, truth.objects
    if depth is not None and depth.frame_id in ("", camera.frame_id):
        depth = _depth(depth, lens)
    if objects is not None:
        found = (replace(item, detection=rectified_detection(item.detection, lens)) for item in objects.objects)
        objects = Objects(tuple(found))
    return replace(truth, depth=depth, objects=objects, segmentation=None if tags is None else _tags(tags, lens))


def _distorted(camera: Camera) -> Camera | None:
    """The camera with a lens to undo; None if its images are rectified, or its lens cannot be undone."""
    return None if is_rectified(camera) or lens_fault(camera) is not None else not_turned(camera)


def _of_front(frame: Frame, lens: Camera) -> Frame:
    is_left = frame.left is None and frame.left_camera == frame.camera
    image, tags, instances = frame.image, frame.segmentation, frame.instances
    detections = frame.detections
    return replace(
        frame,
        camera=rectified(lens),
        left=image if is_left else frame.left,
        image=None if image is None else _image(image, lens),
        segmentation=None if tags is None else _tags(tags, lens),
        instances=None if instances is None else _instances(instances, lens),
        detections=None if detections is None else tuple(rectified_detection(found, lens) for found in detections),
    )


def _image(image: CameraImage, lens: Camera) -> CameraImage:
    bgr, grey = _remapped(lambda: image.bgr, lens), _remapped(lambda: image.grey, lens)
    return CameraImage(image.frame_id, bgr, grey, image.read_size)


def _tags(image: TagImage, lens: Camera) -> TagImage:
    return TagImage(image.frame_id, image.table, _remapped(lambda: image.tags, lens, nearest=True))


def _instances(image: InstanceImage, lens: Camera) -> InstanceImage:
    return InstanceImage(image.frame_id, _remapped(lambda: image.ids, lens, nearest=True))


def _depth(image: DepthImage, lens: Camera) -> DepthImage:
    depth_m = _remapped(lambda: image.depth_m, lens, nearest=True)
    return DepthImage(image.frame_id, lambda: (depth_m(), image.limit_m))


def rectified_detection(detection: Detection, lens: Camera) -> Detection:
    """The detection with the box around its own in the rectified image; ``lens`` is the camera as recorded."""
    box = detection.box_px
    sides = rectified_box(lens, rectified(lens), (box.x_min, box.y_min, box.x_max, box.y_max))
    return replace(detection, box_px=Box(*sides))


def _remapped(pixels: Callable[[], NDArray[P]], lens: Camera, *, nearest: bool = False) -> Callable[[], NDArray[P]]:
    """Decodes and rectifies; an array of another size than the camera's stays, so that its size is reported."""

    def decode() -> NDArray[P]:
        found = pixels()
        if found.shape[:2] != lens.size or _is_pinhole(lens):
            return found
        return resampled(lens, rectified(lens), found, nearest=nearest)

    return decode


def _is_pinhole(camera: Camera) -> bool:
    """Whether only the rotation of its lens was left out."""
    lens = lens_of(camera)
    same = (lens.fx, lens.fy, lens.cx, lens.cy) == (camera.fx, camera.fy, camera.cx, camera.cy)
    return same and not any(camera.distortion)
