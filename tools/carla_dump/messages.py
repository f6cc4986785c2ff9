"""The messages of a planned conversion, in the order of the log: a few frames in memory at a time."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from roadperc_stream.errors import DumpError
from roadperc_stream.formats.images import encode_indices
from roadperc_stream.log import Channel, Message
from roadperc_stream.model import EGO
from roadperc_stream.output import encoding
from roadperc_stream.output.encoding import encode_points
from roadperc_stream.schemas.record import TAG_TABLE_KEY
from roadperc_stream.schemas.registry import schema
from roadperc_stream.schemas.roles import ROLES

from .camera_rig import FRONT
from .depth_files import depth_metres
from .image_files import UnreadableFrameError, read_bytes, require_whole
from .pixel_files import Pixels, load_pixels
from .plan import Plan
from .point_files import load_points
from .survey import require_size
from .tag_files import tags_of

T = TypeVar("T")
Encode = Callable[[int, int], bytes | None]
"""A frame's message from its number and stamp in nanoseconds; None where the frame has none."""

ODOM = "odom"
_WORKERS = 2
"""Threads; one frame more than these is in memory."""


def channels(plan: Plan) -> dict[str, Channel]:
    """Channels of the roles the plan fills, in the order of the contract's table."""
    filled = {role for role, _ in _static(plan)} | set(_encoders(plan))
    return {role: _channel(plan, role) for role in ROLES if role in filled}


def _channel(plan: Plan, role: str) -> Channel:
    definition = schema(ROLES[role].schema)
    tagged = ROLES[role].kind == "tags" and plan.tag_table is not None
    return Channel(
        ROLES[role].topic,
        definition.message_encoding,
        definition.name,
        definition.schema_encoding,
        definition.data,
        ((TAG_TABLE_KEY, plan.tag_table.name),) if tagged and plan.tag_table else (),
    )


def messages(plan: Plan, unreadable: list[str]) -> Iterator[tuple[str, Message]]:
    """Role and message, calibrations and mountings first, then frame by frame.

    Args:
        plan: what to write.
        unreadable: takes the faults of files that turn out to be no frames only when they are decoded.

    Raises:
        DumpError: a file that contradicts the plan: other size, other encoding, unknown tags.

    """
    by_role = channels(plan)
    first_ns = next(iter(plan.stamps_ns.values()))
    for role, data in _static(plan):
        yield role, Message(by_role[role], first_ns, first_ns, 0, data)
    for sequence, (stamp_ns, frame) in enumerate(zip(plan.stamps_ns.values(), _frames_ahead(plan), strict=True)):
        for role, content in frame.contents:
            yield role, Message(by_role[role], stamp_ns, stamp_ns, sequence, content)
        unreadable.extend(frame.unreadable)


@dataclass(frozen=True)
class _Frame:
    """One frame's encoded messages in the order of the contract's table, and the faults of its files."""

    contents: tuple[tuple[str, bytes], ...]
    unreadable: tuple[str, ...]


def _frames_ahead(plan: Plan) -> Iterator[_Frame]:
    """Frames in order, a few of them decoded and encoded ahead in threads: the libraries release the GIL."""
    encoders = _encoders(plan)
    pending: deque[Future[_Frame]] = deque()
    with ThreadPoolExecutor(_WORKERS) as pool:
        for number, stamp_ns in plan.stamps_ns.items():
            pending.append(pool.submit(_frame, encoders, number, stamp_ns))
            if len(pending) > _WORKERS:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


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
    return _Frame(tuple(contents), tuple(unreadable))


def _static(plan: Plan) -> list[tuple[str, bytes]]:
    """Calibrations and transforms: once, at the first frame."""
    first_ns = next(iter(plan.stamps_ns.values()))
    cameras = plan.rig.cameras
    found = [(role, encoding.encode_calibration(first_ns, cameras[role])) for role in ROLES if role in cameras]
    if plan.rig.transforms:
        found.append(("tf", encoding.encode_transforms(first_ns, plan.rig.transforms)))
    return found


def _encoders(plan: Plan) -> dict[str, Encode]:
    """What makes a frame's messages, in the order of the contract's table."""
    cameras = {"image": _image, "left": _image, "right": _image}
    depths = {"depth": _depth, "truth_depth": _depth}
    tags = {"segmentation": _tags, "truth_segmentation": _tags}
    of_files = {**cameras, **depths, **tags, "instances": _instances, "lidar": _points}
    found: dict[str, Encode] = {role: of_files[role](plan, role) for role in plan.surveys}
    if plan.detections:
        found["detections"] = _each(plan.detections, lambda ns, d: encoding.encode_detections(ns, FRONT, d))
    if plan.poses:
        found["truth_pose"] = _each(plan.poses, lambda ns, pose: encoding.encode_pose(ns, ODOM, pose))
    if plan.truth.surfaces:
        found["truth_surface"] = _each(plan.truth.surfaces, encoding.encode_surface)
    if plan.truth.lanes:
        found["truth_lanes"] = _each(plan.truth.lanes, lambda ns, lanes: encoding.encode_lanes(ns, EGO, lanes))
    if plan.truth.objects:
        found["truth_objects"] = _each(plan.truth.objects, lambda ns, o: encoding.encode_objects(ns, FRONT, o))
    return {role: found[role] for role in ROLES if role in found}


def _each(entries: Mapping[int, T], encode: Callable[[int, T], bytes]) -> Encode:
    return lambda number, stamp_ns: encode(stamp_ns, entries[number]) if number in entries else None


def _image(plan: Plan, role: str) -> Encode:
    """Camera images pass through byte for byte."""
    files = plan.surveys[role].sensor.files
    frame_id = plan.rig.frame_ids.get(role, FRONT)

    def encode(number: int, stamp_ns: int) -> bytes | None:
        if number not in files:
            return None
        data = read_bytes(files[number])
        return encoding.encode_image(stamp_ns, frame_id, require_whole(files[number], data), data)

    return encode


def _instances(plan: Plan, role: str) -> Encode:
    """Masks pass through byte for byte: they are PNG, as colours with eight bits each."""
    files = plan.surveys[role].sensor.files

    def encode(number: int, stamp_ns: int) -> bytes | None:
        pixels = _pixels(plan, role, number)
        if pixels is None:
            return None
        if pixels.container != "png" or pixels.channels not in (3, 4) or pixels.values.dtype != np.uint8:
            raise DumpError(f"{pixels.path}: expected masks as a PNG of red, green and blue, as CARLA saves them")
        return encoding.encode_image(stamp_ns, FRONT, "png", read_bytes(files[number]))

    return encode


def _depth(plan: Plan, role: str) -> Encode:
    frame_id = plan.rig.frame_ids[role]
    found, as_float = plan.depth_encodings[role], plan.options.depth_as_float

    def encode(number: int, stamp_ns: int) -> bytes | None:
        pixels = _pixels(plan, role, number)
        if pixels is None:
            return None
        return encoding.encode_depth(stamp_ns, frame_id, depth_metres(pixels, found), as_float=as_float)

    return encode


def _tags(plan: Plan, role: str) -> Encode:
    found, table, lossy = plan.tag_encodings[role], plan.tag_table, plan.options.allow_lossy_tags

    def encode(number: int, stamp_ns: int) -> bytes | None:
        pixels = _pixels(plan, role, number)
        if pixels is None or table is None:
            return None
        tags = tags_of(pixels, found, table, allow_lossy=lossy)
        return encoding.encode_image(stamp_ns, FRONT, "png", encode_indices(tags, table.colours))

    return encode


def _points(plan: Plan, role: str) -> Encode:
    files, frame_id = plan.surveys[role].sensor.files, plan.rig.frame_ids[role]

    def encode(number: int, stamp_ns: int) -> bytes | None:
        return encode_points(stamp_ns, frame_id, load_points(files[number])) if number in files else None

    return encode


def _pixels(plan: Plan, role: str, number: int) -> Pixels | None:
    path = plan.surveys[role].sensor.files.get(number)
    if path is None:
        return None
    pixels, camera = load_pixels(path), plan.rig.camera_of(role)
    require_size(path, pixels.size, (camera.width, camera.height))
    return pixels
