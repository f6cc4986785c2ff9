"""The messages of a planned conversion in the order of the log; few frames are in memory at a time."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import DecodeError, DumpError
from roadperc_stream.formats.images import decode_bgr, encode_indices, encode_jpeg
from roadperc_stream.geometry import Camera
from roadperc_stream.geometry.rectification import is_rectified, rectified, resampled
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.input.rectified import rectified_by
from roadperc_stream.log import Channel, Message
from roadperc_stream.model import EGO
from roadperc_stream.model.tag_tables import TagTable
from roadperc_stream.output import encoding
from roadperc_stream.schemas.protobuf import schema
from roadperc_stream.schemas.record import TAG_TABLE_KEY
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.threads import in_order

from ..rig import FRONT, Rig
from .depth_files import depth_metres
from .image_files import UnreadableFrameError, read_bytes, require_whole
from .pixel_files import Pixels, load_pixels
from .plan import Plan
from .point_files import load_points
from .survey import require_size
from .tag_files import tags_of

T = TypeVar("T")
P = TypeVar("P", np.uint8, np.uint16, np.float32)
Encode = Callable[[int, int], bytes | None]
"""Makes the message of a frame from its number and stamp in nanoseconds; None for a frame without one."""
EncodeFile = Callable[[Plan, str, Path, int], bytes]
"""Makes the message of a role's file in the frame of a number."""

ODOM = "odom"
JPEG_QUALITY: Final = 95
"""99 % of the pixels of a road video keep their grey value to 2 levels; at 90 to 3, in two thirds of the bytes."""
WORKERS: Final = 2


def channels(plan: Plan) -> dict[str, Channel]:
    """Return the channels of the plan's roles, in the order of ``ROLES``."""
    rigs = (plan.drive.rig, *plan.drive.frame_rigs.values())
    filled = {role for rig in rigs for role, _ in static_messages(rig, 0)} | set(_encoders(plan))
    return {role: channel_of(role, plan.tag_table) for role in ROLES if role in filled}


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


def messages(plan: Plan, unreadable: list[str]) -> Iterator[tuple[str, Message]]:
    """Yield role and message: calibrations and mountings first, then frame by frame.

    If each frame has its own rig, that comes first in the frame.

    Appends the errors of files that cannot be decoded to ``unreadable``.

    Raises:
        DumpError: a file contradicts the plan: another size, another encoding, or unknown tags.
    """
    by_role = channels(plan)
    stamps_ns, rigs = plan.drive.stamps_ns, plan.drive.frame_rigs or {next(iter(plan.drive.stamps_ns)): plan.drive.rig}
    encoders = _encoders(plan)
    made = in_order(lambda at: _frame(encoders, *at), stamps_ns.items(), WORKERS)
    for sequence, ((number, stamp_ns), (contents, faults)) in enumerate(zip(stamps_ns.items(), made, strict=True)):
        static = static_messages(rigs[number], stamp_ns) if number in rigs else []
        for role, content in (*static, *contents):
            yield role, Message(by_role[role], stamp_ns, stamp_ns, sequence, content)
        unreadable.extend(faults)


_Frame = tuple[list[tuple[str, bytes]], list[str]]
"""Encoded messages of a frame with their roles, in the order of ``ROLES``, and the errors of its files."""


def _frame(encoders: Mapping[str, Encode], number: int, stamp_ns: int) -> _Frame:
    contents, unreadable = [], []
    for role, encode in encoders.items():
        try:
            content = encode(number, stamp_ns)
        except UnreadableFrameError as error:
            unreadable.append(str(error))
            continue
        if content is not None:
            contents.append((role, content))
    return contents, unreadable


def static_messages(rig: Rig, first_ns: int) -> list[tuple[str, bytes]]:
    """Return calibrations of the rectified images, and transforms, with their roles."""
    cameras = {role: rectified(rig.cameras[role]) for role in ROLES if role in rig.cameras}
    found = [(role, encoding.encode_calibration(first_ns, camera)) for role, camera in cameras.items()]
    if rig.transforms:
        found.append(("tf", encoding.encode_transforms(first_ns, rig.transforms)))
    return found


def _encoders(plan: Plan) -> dict[str, Encode]:
    """Return the encoders of a frame's messages by role, in the order of ``ROLES``."""
    found: dict[str, Encode] = {role: partial(_of_file, plan, role, _OF_FILES[role]) for role in plan.drive.surveys}
    truth = plan.drive.truth
    found |= {"detections": partial(_detections, plan)} if plan.drive.detections else {}
    found |= _each("truth_pose", plan.drive.poses, lambda ns, pose: encoding.encode_pose(ns, ODOM, pose))
    found |= _each("truth_surface", truth.surfaces, encoding.encode_surface)
    found |= _each("truth_lanes", truth.lanes, lambda ns, lanes: encoding.encode_lanes(ns, EGO, lanes))
    found |= _each("truth_objects", truth.objects, lambda ns, o: encoding.encode_objects(ns, FRONT, o))
    return {role: found[role] for role in ROLES if role in found}


def _each(role: str, entries: Mapping[int, T], encode: Callable[[int, T], bytes]) -> dict[str, Encode]:
    """Return the encoder of a role with one entry per frame; empty without entries."""
    if not entries:
        return {}
    return {role: lambda number, stamp_ns: encode(stamp_ns, entries[number]) if number in entries else None}


def _of_file(plan: Plan, role: str, encode: EncodeFile, number: int, _stamp_ns: int) -> bytes | None:
    path = plan.drive.surveys[role].sensor.files.get(number)
    return None if path is None else encode(plan, role, path, number)


def _image(plan: Plan, role: str, path: Path, number: int) -> bytes:
    """Encode a camera image; its bytes stay unchanged unless a lens is undone or cameras are side by side."""
    rig = plan.drive.rig_of(number)
    camera, data = rig.camera_of(role), read_bytes(path)
    form = require_whole(path, data)
    if not is_rectified(camera) or plan.drive.side_by_side > 1:
        try:
            pixels = _middle(plan, decode_bgr(data))
            form, data = "jpeg", encode_jpeg(straightened(camera, pixels), JPEG_QUALITY)
        except DecodeError as error:
            raise UnreadableFrameError(f"{path}: {error}") from error
    return encoding.encode_image(plan.drive.stamps_ns[number], rig.frame_ids.get(role, FRONT), form, data)


def straightened(camera: Camera, pixels: NDArray[P], *, nearest: bool = False) -> NDArray[P]:
    """Return pixels without the distortion of their camera's lens; ``nearest`` as in ``resampled``."""
    return pixels if is_rectified(camera) else resampled(camera, rectified(camera), pixels, nearest=nearest)


def _detections(plan: Plan, number: int, stamp_ns: int) -> bytes | None:
    detections = plan.drive.detections.get(number)
    if detections is None:
        return None
    camera = plan.drive.rig_of(number).camera_of("image")
    if not is_rectified(camera):
        detections = rectified_by(detections, camera)
    return encoding.encode_detections(stamp_ns, FRONT, detections)


def _instances(plan: Plan, role: str, path: Path, number: int) -> bytes:
    """Encode an instance mask, a PNG with 8-bit colours; its bytes stay unchanged unless a lens is undone."""
    camera, stamp_ns = plan.drive.rig_of(number).camera_of(role), plan.drive.stamps_ns[number]
    pixels = _pixels(plan, camera, path)
    if pixels.container != "png" or pixels.channels not in (3, 4) or pixels.values.dtype != np.uint8:
        raise DumpError(
            f"{path}: expected masks as a PNG of red, green and blue as CARLA saves them, found {pixels.shape}"
        )
    if is_rectified(camera):
        return encoding.encode_image(stamp_ns, FRONT, "png", read_bytes(path))
    _, found = cv2.imencode(".png", straightened(camera, pixels.values, nearest=True))
    return encoding.encode_image(stamp_ns, FRONT, "png", found.tobytes())


def _depth(plan: Plan, role: str, path: Path, number: int) -> bytes:
    rig, stamp_ns = plan.drive.rig_of(number), plan.drive.stamps_ns[number]
    camera = rig.camera_of(role)
    focal_baseline = camera.fx * (rig.baseline_m or np.nan)
    measured_m = depth_metres(_pixels(plan, camera, path), plan.depth_encodings[role], focal_baseline)
    depth_m = straightened(camera, measured_m, nearest=True)
    return encoding.encode_depth(stamp_ns, rig.frame_ids[role], depth_m, as_float=plan.options.depth_as_float)


def _tags(plan: Plan, role: str, path: Path, number: int) -> bytes:
    camera, stamp_ns = plan.drive.rig_of(number).camera_of(role), plan.drive.stamps_ns[number]
    table, lossy = plan.tag_table, plan.options.allow_lossy_tags
    assert table is not None  # a plan with tags has their table
    found = tags_of(_pixels(plan, camera, path), plan.tag_encodings[role], table, allow_lossy=lossy)
    tags = straightened(camera, found, nearest=True)
    return encoding.encode_image(stamp_ns, FRONT, "png", encode_indices(tags, table.colours))


def _points(plan: Plan, role: str, path: Path, number: int) -> bytes:
    frame_id = plan.drive.rig_of(number).frame_ids[role]
    return encoding.encode_points(plan.drive.stamps_ns[number], frame_id, load_points(path))


def _middle(plan: Plan, pixels: NDArray[P]) -> NDArray[P]:
    """Return the columns of the middle camera of those side by side."""
    cameras = plan.drive.side_by_side
    width = pixels.shape[1] // cameras
    return pixels[:, cameras // 2 * width : (cameras // 2 + 1) * width]


def _pixels(plan: Plan, camera: Camera, path: Path) -> Pixels:
    pixels = load_pixels(path)
    pixels = replace(pixels, values=_middle(plan, pixels.values))
    require_size(path, pixels.size, (camera.width, camera.height))
    return pixels


_OF_FILES: Final[Mapping[str, EncodeFile]] = {
    **dict.fromkeys(("image", "left", "right"), _image),
    **dict.fromkeys(("depth", "truth_depth"), _depth),
    **dict.fromkeys(("segmentation", "truth_segmentation"), _tags),
    "instances": _instances,
    LIDAR: _points,
}
