"""Undoes a lens's distortion once, before the chain: a frame's images, tags, masks, depth and boxes.

The rectified image is that of the mounted camera: it has the intrinsics of P, but the rotation R of a stereo pair is
not applied, because that would turn the camera's mounting. The stereo stage gets the images as recorded, and applies R.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from roadperc_stream import model
from roadperc_stream.geometry import Camera
from roadperc_stream.geometry import rectification as lenses

P = TypeVar("P", np.uint8, np.uint16, np.float32)
T = TypeVar("T")
U = TypeVar("U")


def rectified_frame(frame: model.Frame) -> model.Frame:
    """The frame with rectified cameras; a lens that is impossible or unknown stays, with its images as recorded."""
    lens, of_depth = _distorted(frame.camera), _distorted(frame.depth_camera)
    if lens is not None:
        is_left = frame.left is None and frame.left_camera == frame.camera
        boxes = _if_there(frame.detections, lambda found: tuple(rectified_detection(each, lens) for each in found))
        frame = replace(
            frame,
            camera=lenses.rectified(lens),
            left=frame.image if is_left else frame.left,
            image=_if_there(frame.image, lambda image: _image(image, lens)),
            segmentation=_if_there(frame.segmentation, lambda image: _tags(image, lens)),
            instances=_if_there(frame.instances, lambda image: _instances(image, lens)),
            detections=boxes,
        )
    if of_depth is not None:
        depth = _if_there(frame.depth, lambda image: _depth(image, of_depth))
        frame = replace(frame, depth_camera=lenses.rectified(frame.depth_camera), depth=depth)
    return frame


def rectified_truth(truth: model.Truth, camera: Camera) -> model.Truth:
    """The truth in the rectified image of the front camera, whose calibration in the log is ``camera``."""
    lens, depth = _distorted(camera), truth.depth
    if lens is None:
        return truth
    if depth is not None and depth.frame_id in ("", camera.frame_id):
        depth = _depth(depth, lens)
    tags = _if_there(truth.segmentation, lambda image: _tags(image, lens))
    return replace(truth, depth=depth, objects=_if_there(truth.objects, lambda o: _objects(o, lens)), segmentation=tags)


def rectified_detection(detection: model.Detection, lens: Camera) -> model.Detection:
    """The detection with the box around its own in the rectified image; ``lens`` is the camera as recorded."""
    box = detection.box_px
    sides = lenses.rectified_box(lens, lenses.rectified(lens), (box.x_min, box.y_min, box.x_max, box.y_max))
    return replace(detection, box_px=model.Box(*sides))


def _if_there(found: T | None, change: Callable[[T], U]) -> U | None:
    return None if found is None else change(found)


def _distorted(camera: Camera) -> Camera | None:
    """The camera with a lens to undo; None if its images are rectified, or its lens cannot be undone."""
    return None if lenses.is_rectified(camera) or lenses.lens_fault(camera) else lenses.not_turned(camera)


def _image(image: model.CameraImage, lens: Camera) -> model.CameraImage:
    bgr, grey = _remapped(lambda: image.bgr, lens), _remapped(lambda: image.grey, lens)
    return model.CameraImage(image.frame_id, bgr, grey, image.read_size)


def _tags(image: model.TagImage, lens: Camera) -> model.TagImage:
    return replace(image, decode_tags=_remapped(lambda: image.tags, lens, nearest=True))


def _instances(image: model.InstanceImage, lens: Camera) -> model.InstanceImage:
    return replace(image, decode_ids=_remapped(lambda: image.ids, lens, nearest=True))


def _depth(image: model.DepthImage, lens: Camera) -> model.DepthImage:
    depth_m = _remapped(lambda: image.depth_m, lens, nearest=True)
    return replace(image, decode_depth=lambda: (depth_m(), image.limit_m))


def _objects(objects: model.Objects, lens: Camera) -> model.Objects:
    return model.Objects(tuple(replace(o, detection=rectified_detection(o.detection, lens)) for o in objects.objects))


def _remapped(pixels: Callable[[], NDArray[P]], lens: Camera, *, nearest: bool = False) -> Callable[[], NDArray[P]]:
    """Decodes and rectifies; an array of another size than the camera's stays, so that its size is reported."""

    def decode() -> NDArray[P]:
        found = pixels()
        if found.shape[:2] != lens.size:
            return found
        return lenses.resampled(lens, lenses.rectified(lens), found, nearest=nearest)

    return decode
