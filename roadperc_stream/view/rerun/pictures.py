"""Draws images, tags, depth and cameras in Rerun."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Final

import numpy as np
import rerun as rr

from roadperc_stream.formats.images import depth_to_mm, encode_jpeg
from roadperc_stream.geometry import Camera
from roadperc_stream.input.transforms import NOTHING_LATCHED
from roadperc_stream.model import CameraImage, DepthImage, InstanceImage, TagImage
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.view.rerun.tree import Entry, SceneState, annotation_context, image_plane, new_edges

_MM_PER_M: Final = 1000.0
_COLOURED_MM: Final = (0.0, 40_000.0)
"""Colour range. Beyond it the road is only a few rows high."""
_JPEG_QUALITY: Final = 90
_PIXEL_CENTRE: Final = 0.5
"""Rerun counts pixels from the image's corner, this project from the first pixel's centre."""


def encoded(entity: str, contents: bytes, image_format: str, frame: str) -> Entry:
    """An image with the encoded bytes of the log."""
    return Entry(entity, rr.EncodedImage(contents=contents, media_type=f"image/{image_format}"), frame)


def image(entity: str, role: str, payload: CameraImage, state: SceneState) -> Iterator[Entry]:
    """Encode and draw an image of raw pixels or of another message type than foxglove.CompressedImage."""
    jpeg = encode_jpeg(payload.bgr, _JPEG_QUALITY)
    yield encoded(entity, jpeg, "jpeg", state.image_frame(role, payload.frame_id))


def tags(entity: str, role: str, payload: TagImage, state: SceneState) -> Iterator[Entry]:
    """Draw class ids, with names and colours from the tag table."""
    yield Entry(entity, annotation_context(payload.table.names, payload.table.colours))
    yield Entry(entity, rr.SegmentationImage(payload.tags), state.image_frame(role, payload.frame_id))


def instances(entity: str, role: str, payload: InstanceImage, state: SceneState) -> Iterator[Entry]:
    """Draw the numbers of objects, each in its own colour."""
    yield Entry(entity, rr.SegmentationImage(payload.ids), state.image_frame(role, payload.frame_id))


def depth(entity: str, role: str, payload: DepthImage, state: SceneState) -> Iterator[Entry]:
    """Draw depth in millimetres; unknown and saturated pixels are 0, so they give no 3D points."""
    camera = state.camera_of(role)
    borrowed = "depth_calibration" not in state.latched.cameras
    if camera and payload.frame_id not in ("", camera.frame_id):
        camera = replace(camera, frame_id=payload.frame_id)
        if borrowed:
            yield from pinhole(f"{entity}/camera", camera, state)
    known_mm = np.where(payload.depth_m < payload.limit_m, depth_to_mm(payload.depth_m), 0).astype(np.uint16)
    picture = rr.DepthImage(known_mm, meter=_MM_PER_M, colormap="turbo", depth_range=_COLOURED_MM, point_fill_ratio=0.5)
    yield Entry(entity, picture, state.plane_of(camera) if camera else image_plane(payload.frame_id))


def calibration(entity: str, role: str, payload: Camera, state: SceneState) -> Iterator[Entry]:
    """Draw a camera. The front camera determines which frame of the tree is ego."""
    state.latch(role, payload)
    yield from pinhole(entity, state.latched.cameras[role], state)
    yield from new_edges(state)


def given(roles: Mapping[str, str], state: SceneState) -> Iterator[Entry]:
    """Draw the cameras that the user gave, and the log does not have; ``roles`` are the topics of its roles."""
    for role, camera in state.given.cameras.items():
        if role not in roles:
            yield from pinhole(ROLES[role].topic, camera, state)
    yield from new_edges(state) if state.given != NOTHING_LATCHED else ()


def pinhole(entity: str, payload: Camera, state: SceneState) -> Iterator[Entry]:
    """Draw the image plane below a camera's frame, once for cameras with the same frame and pixels."""
    plane = state.plane_to_draw(entity, payload)
    if plane is None:
        return
    K = payload.K.copy()
    K[:2, 2] += _PIXEL_CENTRE
    yield Entry(
        entity,
        rr.Pinhole(
            image_from_camera=K,
            resolution=(payload.width, payload.height),
            camera_xyz=rr.ViewCoordinates.RDF,
            parent_frame=payload.frame_id,
            child_frame=plane,
            image_plane_distance=1.0,
        ),
    )
