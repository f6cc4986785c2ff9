"""The messages of a dataset's frames, one function for each role."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import DecodeError, DumpError
from roadperc_stream.formats.images import decode_bgr, encode_indices, encode_jpeg
from roadperc_stream.geometry import Camera
from roadperc_stream.geometry.rectification import is_rectified
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.input.rectified import rectified_by
from roadperc_stream.model import EGO
from roadperc_stream.model.tag_tables import TagTable
from roadperc_stream.output import encoding
from roadperc_stream.schemas.roles import ROLES

from .layouts.dataset import DatasetSequence
from .readers.depth_files import DepthEncoding, depth_metres
from .readers.image_files import UnreadableFrameError, read_bytes, require_whole
from .readers.pixel_files import Pixels, load_pixels
from .readers.point_files import load_points
from .readers.sensor_folders import require_size
from .readers.tag_files import TagEncoding, tags_of
from .recording import JPEG_QUALITY, straightened
from .rig import FRONT, Rig

ODOM: Final = "odom"


@dataclass(frozen=True)
class Codings:
    """The encodings of a dataset's depth and tags by role, the tags' table, and what the user chose."""

    depth: Mapping[str, DepthEncoding]
    tags: Mapping[str, TagEncoding]
    tag_table: TagTable | None
    depth_as_float: bool
    allow_lossy_tags: bool


@dataclass(frozen=True)
class _File:
    """A file of a role in the frame with a number."""

    dataset: DatasetSequence
    codings: Codings
    role: str
    path: Path
    number: int

    @property
    def stamp_ns(self) -> int:
        return self.dataset.stamps_ns[self.number]

    @property
    def rig(self) -> Rig:
        return self.dataset.rig_of(self.number)

    @property
    def camera(self) -> Camera:
        return self.rig.camera_of(self.role)

    def pixels(self) -> Pixels:
        """Return the numbers of the file, those of the middle camera of several side by side."""
        pixels = load_pixels(self.path)
        pixels = replace(pixels, values=_middle(self.dataset, pixels.values))
        require_size(self.path, pixels.size, (self.camera.width, self.camera.height))
        return pixels


def roles_of(dataset: DatasetSequence) -> list[str]:
    """Return the roles that get messages in the frames of a dataset, in the order of ``ROLES``."""
    of_frames = {role for role, (entries, _) in _OF_FRAMES.items() if entries(dataset)}
    return [role for role in ROLES if role in of_frames or role in dataset.sensors]


def encoded(dataset: DatasetSequence, codings: Codings, role: str, number: int) -> bytes | None:
    """Return the message of a role in a frame; None if the frame has none.

    Raises:
        UnreadableFrameError: the file cannot be decoded.
        DumpError: it contradicts the others: another encoding, or unknown tags.
    """
    if role in _OF_FRAMES:
        entries, encode = _OF_FRAMES[role]
        entry = entries(dataset).get(number)
        return None if entry is None else encode(dataset, number, entry)
    path = dataset.sensors[role].files.get(number)
    return None if path is None else _OF_FILES[role](_File(dataset, codings, role, path, number))


def _image(file: _File) -> bytes:
    """Encode a camera image; its bytes stay unchanged unless a lens is undone or cameras are side by side."""
    data = read_bytes(file.path)
    form = require_whole(file.path, data)
    if not is_rectified(file.camera) or file.dataset.side_by_side > 1:
        try:
            pixels = _middle(file.dataset, decode_bgr(data))
            form, data = "jpeg", encode_jpeg(straightened(file.camera, pixels), JPEG_QUALITY)
        except DecodeError as error:
            raise UnreadableFrameError(f"{file.path}: {error}") from error
    return encoding.encode_image(file.stamp_ns, file.rig.frame_ids.get(file.role, FRONT), form, data)


def _middle(dataset: DatasetSequence, pixels: NDArray[Any]) -> NDArray[Any]:
    """Return the columns of the middle camera of those side by side."""
    width = pixels.shape[1] // dataset.side_by_side
    first = dataset.side_by_side // 2 * width
    return pixels[:, first : first + width]


def _instances(file: _File) -> bytes:
    """Encode an instance mask, a PNG with 8-bit colours; its bytes stay unchanged unless a lens is undone."""
    pixels = file.pixels()
    if pixels.container != "png" or pixels.channels not in (3, 4) or pixels.values.dtype != np.uint8:
        expected = "masks as a PNG of red, green and blue as CARLA saves them"
        raise DumpError(f"{file.path}: expected {expected}, found {pixels.shape}")
    if is_rectified(file.camera):
        return encoding.encode_image(file.stamp_ns, FRONT, "png", read_bytes(file.path))
    _, found = cv2.imencode(".png", straightened(file.camera, pixels.values, nearest=True))
    return encoding.encode_image(file.stamp_ns, FRONT, "png", found.tobytes())


def _depth(file: _File) -> bytes:
    focal_baseline = file.camera.fx * (file.rig.baseline_m or np.nan)
    measured_m = depth_metres(file.pixels(), file.codings.depth[file.role], focal_baseline)
    depth_m = straightened(file.camera, measured_m, nearest=True)
    frame_id, as_float = file.rig.frame_ids[file.role], file.codings.depth_as_float
    return encoding.encode_depth(file.stamp_ns, frame_id, depth_m, as_float=as_float)


def _tags(file: _File) -> bytes:
    table = file.codings.tag_table
    assert table is not None  # a dataset with tags has their table
    lossy = file.codings.allow_lossy_tags
    found = tags_of(file.pixels(), file.codings.tags[file.role], table, allow_lossy=lossy)
    tags = straightened(file.camera, found, nearest=True)
    return encoding.encode_image(file.stamp_ns, FRONT, "png", encode_indices(tags, table.colours))


def _points(file: _File) -> bytes:
    return encoding.encode_points(file.stamp_ns, file.rig.frame_ids[file.role], load_points(file.path))


_OF_FILES: Final[Mapping[str, Callable[[_File], bytes]]] = {
    "image": _image,
    "left": _image,
    "right": _image,
    "depth": _depth,
    "truth_depth": _depth,
    "segmentation": _tags,
    "truth_segmentation": _tags,
    "instances": _instances,
    LIDAR: _points,
}
"""The message of a file by its role."""


def _detections(dataset: DatasetSequence, number: int, detections: Any) -> bytes:
    camera = dataset.rig_of(number).camera_of("image")
    if not is_rectified(camera):
        detections = rectified_by(detections, camera)
    return encoding.encode_detections(dataset.stamps_ns[number], FRONT, detections)


_Entries = Callable[[DatasetSequence], Mapping[int, Any]]
_Encode = Callable[[DatasetSequence, int, Any], bytes]
_OF_FRAMES: Final[Mapping[str, tuple[_Entries, _Encode]]] = {
    "detections": (lambda data: data.detections, _detections),
    "truth_pose": (
        lambda data: data.poses,
        lambda data, number, pose: encoding.encode_pose(data.stamps_ns[number], ODOM, pose),
    ),
    "truth_surface": (
        lambda data: data.truth.surfaces,
        lambda data, number, surface: encoding.encode_surface(data.stamps_ns[number], surface),
    ),
    "truth_lanes": (
        lambda data: data.truth.lanes,
        lambda data, number, lanes: encoding.encode_lanes(data.stamps_ns[number], EGO, lanes),
    ),
    "truth_objects": (
        lambda data: data.truth.objects,
        lambda data, number, objects: encoding.encode_objects(data.stamps_ns[number], FRONT, objects),
    ),
}
"""The entries by frame number, and the message of an entry, by its role."""
