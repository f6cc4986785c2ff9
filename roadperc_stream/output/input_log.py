"""Writes frames as an input log, which a replay reads like a recorded one."""

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np

from roadperc_stream.errors import TargetError
from roadperc_stream.formats.images import encode_indices, encode_png, format_of
from roadperc_stream.log import Channel, LogWriter, Message
from roadperc_stream.model import EGO, ODOM, DepthImage, Frame, TagImage, Transform, Truth
from roadperc_stream.model.tag_tables import TagTable
from roadperc_stream.output import encoding
from roadperc_stream.schemas.protobuf import schema
from roadperc_stream.schemas.record import TAG_TABLE_KEY
from roadperc_stream.schemas.roles import ROLES

_TRUTH: Final[dict[str, tuple[str, Callable[[int, str, Any], bytes]]]] = {
    "truth_pose": ("odom_T_ego", lambda stamp_ns, _, pose: encoding.encode_pose(stamp_ns, ODOM, pose)),
    "truth_surface": ("surface", lambda stamp_ns, _, surface: encoding.encode_surface(stamp_ns, surface)),
    "truth_lanes": ("lanes", lambda stamp_ns, _, lanes: encoding.encode_lanes(stamp_ns, EGO, lanes)),
    "truth_objects": ("objects", encoding.encode_objects),
    "truth_depth": ("depth", lambda stamp_ns, _, depth: _depth(stamp_ns, depth)),
    "truth_segmentation": ("segmentation", lambda stamp_ns, _, tags: _tags(stamp_ns, tags)),
}
"""Field of ``Truth`` and encoder by role."""
_END_NS: Final = 2**64
"""End of the log times that MCAP can store."""


def write_input_log(path: Path, frames: Iterable[tuple[Frame, Truth]]) -> int:
    """Write frames with their truth in the order given; returns their number.

    Images keep their file, or become PNG. The log time of a message is its stamp. Lidar points and instance masks are
    left out.

    Raises:
        TargetError: the log cannot be written, there are no frames, or a stamp is not a log time.
    """
    count, known = 0, dict[str, bytes]()
    with LogWriter(path) as log:
        for count, (frame, truth) in enumerate(frames, 1):
            stamp_ns, tagged = frame.stamp_ns, frame.segmentation or truth.segmentation
            if not 0 <= stamp_ns < _END_NS:
                raise TargetError(f"{path}: frame with stamp {stamp_ns} ns, expected 0 to {_END_NS - 1}")
            before, known = known, known | dict(_cameras(frame, 0))
            cameras = (item for item in _cameras(frame, stamp_ns) if known[item[0]] != before.get(item[0]))
            for role, data in chain(cameras, _inputs(frame), _truth(frame, truth)):
                channel = channel_of(role, tagged.table if tagged else None)
                log.write(Message(channel, stamp_ns, stamp_ns, count - 1, data))
        if not count:
            raise TargetError(f"{path}: expected one frame or more, found none")
    return count


def _cameras(frame: Frame, stamp_ns: int) -> Iterator[tuple[str, bytes]]:
    """Calibrations and mountings, which are written when they change."""
    cameras = {"calibration": frame.camera}
    edges = {frame.camera.frame_id: frame.ego_T_camera}
    if frame.depth_image is not None:
        edges.setdefault(frame.depth_camera.frame_id, frame.ego_T_depth_camera)
        cameras |= {} if frame.depth_camera.same_view(frame.camera) else {"depth_calibration": frame.depth_camera}
    if frame.left is not None:
        cameras["left_calibration"] = frame.left_camera
        edges.setdefault(frame.left_camera.frame_id, frame.ego_T_left)
    if frame.right_camera is not None:
        cameras["right_calibration"] = frame.right_camera
    for role, camera in cameras.items():
        yield role, encoding.encode_calibration(stamp_ns, camera)
    if frame.mounted:
        transforms = [Transform(EGO, name, ego_T_camera) for name, ego_T_camera in edges.items()]
        yield "tf", encoding.encode_transforms(stamp_ns, transforms)


def _inputs(frame: Frame) -> Iterator[tuple[str, bytes]]:
    stamp_ns = frame.stamp_ns
    for role, image in (("image", frame.image), ("left", frame.left), ("right", frame.right)):
        if image is not None:
            data = image.encoded or encode_png(image.bgr)
            yield role, encoding.encode_image(stamp_ns, image.frame_id, format_of(data).lower(), data)
    if frame.depth_image is not None:
        yield "depth", _depth(stamp_ns, frame.depth_image)
    if frame.segmentation is not None:
        yield "segmentation", _tags(stamp_ns, frame.segmentation)
    if frame.detections is not None:
        yield "detections", encoding.encode_detections(stamp_ns, frame.camera.frame_id, frame.detections)


def _depth(stamp_ns: int, depth: DepthImage) -> bytes:
    """Metres as floats; whole millimetres, which have a limit, as such."""
    return encoding.encode_depth(stamp_ns, depth.frame_id, depth.depth_m, as_float=not np.isfinite(depth.limit_m))


def _tags(stamp_ns: int, image: TagImage) -> bytes:
    png = encode_indices(image.tags, image.table.colours)
    return encoding.encode_image(stamp_ns, image.frame_id, "png", png)


def _truth(frame: Frame, truth: Truth) -> Iterator[tuple[str, bytes]]:
    for role, (name, encode) in _TRUTH.items():
        if (value := getattr(truth, name)) is not None:
            yield role, encode(frame.stamp_ns, frame.camera.frame_id, value)


def channel_of(role: str, tag_table: TagTable | None = None) -> Channel:
    """Return the channel of a role; that of tags names its table."""
    definition = schema(ROLES[role].schema)
    return Channel(
        ROLES[role].topic,
        definition.message_encoding,
        definition.name,
        definition.schema_encoding,
        definition.data,
        ((TAG_TABLE_KEY, tag_table.name),) if tag_table and ROLES[role].kind == "tags" else (),
    )
