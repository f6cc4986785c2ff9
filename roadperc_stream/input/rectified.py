"""Undoes a lens's distortion once, before the chain: a frame's images, tags, masks, depth and boxes.

The rectified image is that of the mounted camera: it has the intrinsics of P, but the rotation R of a stereo pair is
not applied, because that would turn the camera's mounting. The stereo stage gets the images as recorded, and applies R.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from roadperc_stream import model
from roadperc_stream.geometry import Camera
from roadperc_stream.geometry import rectification as lenses

P = TypeVar("P", np.uint8, np.uint16, np.float32)
T = TypeVar("T")


def rectified_frame(frame: model.Frame) -> model.Frame:
    """The frame with rectified cameras; a lens that is impossible or unknown stays, with its images as recorded."""
    camera, is_left = frame.camera, frame.left is None and frame.left_camera == frame.camera
    if _distorted(frame.depth_camera) is not None:
        depth_image = rectified(frame.depth_image, frame.depth_camera)
        frame = replace(frame, depth_camera=lenses.rectified(frame.depth_camera), depth_image=depth_image)
    if _distorted(camera) is None:
        return frame
    return replace(
        frame,
        camera=lenses.rectified(camera),
        left=frame.image if is_left else frame.left,
        image=rectified(frame.image, camera),
        segmentation=rectified(frame.segmentation, camera),
        instance_image=rectified(frame.instance_image, camera),
        detections=rectified(frame.detections, camera),
    )


def rectified_truth(truth: model.Truth, camera: Camera) -> model.Truth:
    """The truth in the rectified image of the front camera, whose calibration in the log is ``camera``."""
    is_here = truth.depth is not None and truth.depth.frame_id in ("", camera.frame_id)
    depth = rectified(truth.depth, camera) if is_here else truth.depth
    objects, tags = rectified(truth.objects, camera), rectified(truth.segmentation, camera)
    return replace(truth, depth=depth, objects=objects, segmentation=tags)


def rectified(payload: T, camera: Camera | None) -> T:
    """Images, tags, masks, depth, detections or objects in the rectified image of ``camera``.

    Other payloads stay, as do all of a camera that has no lens to undo.
    """
    lens = None if camera is None else _distorted(camera)
    changed: T = payload if lens is None else rectified_by(payload, lens)
    return changed


def _distorted(camera: Camera) -> Camera | None:
    """The camera with a lens to undo; None if its images are rectified, or its lens cannot be undone."""
    return None if lenses.is_rectified(camera) or lenses.lens_fault(camera) else lenses.not_turned(camera)


def rectified_by(payload: Any, lens: Camera) -> Any:
    """As ``rectified``, for a camera whose lens can be undone; its rotation is applied, too."""
    if isinstance(payload, tuple):
        return tuple(rectified_by(each, lens) for each in payload)
    changed: dict[str, Any] = {}
    match payload:
        case model.Objects():
            changed = {"objects": rectified_by(payload.objects, lens)}
        case model.Object():
            changed = {"detection": rectified_by(payload.detection, lens)}
        case model.Detection():
            sides = lenses.rectified_box(lens, lenses.rectified(lens), tuple(vars(payload.box_px).values()))
            changed = {"box_px": model.Box(*sides)}
        case model.CameraImage():
            bgr, grey = _remapped(lambda: payload.bgr, lens), _remapped(lambda: payload.grey, lens)
            changed = {"decode_bgr": bgr, "decode_grey": grey, "encoded": b""}
        case model.TagImage():
            changed = {"decode_tags": _remapped(lambda: payload.tags, lens, nearest=True)}
        case model.InstanceImage():
            changed = {"decode_ids": _remapped(lambda: payload.ids, lens, nearest=True)}
        case model.DepthImage():
            depth_m = _remapped(lambda: payload.depth_m, lens, nearest=True)
            changed = {"decode_depth": lambda: (depth_m(), payload.limit_m)}
    return replace(payload, **changed) if changed else payload


def _remapped(pixels: Callable[[], NDArray[P]], lens: Camera, *, nearest: bool = False) -> Callable[[], NDArray[P]]:
    """Decodes and rectifies; an array of another size than the camera's stays, so that its size is reported."""

    def decode() -> NDArray[P]:
        found = pixels()
        if found.shape[:2] != lens.size:
            return found
        return lenses.resampled(lens, lenses.rectified(lens), found, nearest=nearest)

    return decode
