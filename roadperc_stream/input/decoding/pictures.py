"""Decodes images, tags, instance masks and depth from raw pixels or image files."""

import struct
from functools import partial
from typing import Any, Final

import numpy as np

from roadperc_stream.config import LimitsConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import images
from roadperc_stream.formats.raster import PALETTE_TABLE, Raster, tags_of_colours
from roadperc_stream.geometry import Float32
from roadperc_stream.input.decoding.payload import Contents, Context, frame_of
from roadperc_stream.model import CameraImage, DepthImage, Image, InstanceImage, TagImage, VideoFrame
from roadperc_stream.model.tag_tables import TagTable
from roadperc_stream.schemas.roles import Kind

CONVERT_VIDEO: Final = "store its frames as images with: roadperc-convert LOG IMAGES.mcap"
_COLOUR_TYPE: Final = 25
"""Position of a PNG's colour type."""
_TRUE_COLOURS: Final = (b"\x02", b"\x06")
_DEPTH_HEADER: Final = struct.Struct("<iff")
"""Header of compressedDepth: an unused number, and both quantisation parameters of 32FC1."""


Picture = CameraImage | TagImage | InstanceImage | DepthImage
FILE_KINDS: Final[tuple[Kind, ...]] = ("image", "tags", "instances")
RASTER_KINDS: Final[tuple[Kind, ...]] = (*FILE_KINDS, "depth")


def raw(kind: Kind) -> Contents:
    """The contents of messages with raw pixels, of ROS or Foxglove: an image, tags, instance masks or depth.

    They raise ``DecodeError`` if it exceeds the limits, or the table of numeric tags is unknown.
    """

    def contents(message: Any, context: Context) -> Picture:
        frame_id, raster = frame_of(message), Raster.of(message)
        if raster.width * raster.height <= len(raster.data):  # decoding reports too few data
            images.require_pixels(kind, raster.width, raster.height, context.limits)
        match kind:
            case "image":
                return CameraImage(frame_id, raster.bgr, raster.grey, raster.size, coding=raster.encoding)
            case "depth":
                return DepthImage(frame_id, raster.depth, raster.size, raster.encoding)
            case "instances":
                return InstanceImage(frame_id, raster.ids)
        table = _table_of(context.tag_table, indexed=raster.indexed)
        return TagImage(frame_id, table, lambda: raster.tags(table), raster.size, raster.encoding)

    return contents


def file(kind: Kind) -> Contents:
    """The contents of messages with an image file, of ROS or Foxglove.

    They raise ``DecodeError`` if the format is another one than an image's, or as ``_of_file``.
    """

    def contents(message: Any, context: Context) -> Picture:
        if kind == "image" and "compressedDepth" in message.format:
            raise DecodeError(f"image of format {message.format!r}: that is depth, expected jpeg or png")
        if images.video_codec(message.format):
            raise DecodeError(
                f"image of format {message.format!r}: a frame of video, expected jpeg or png; {CONVERT_VIDEO}"
            )
        return _of_file(kind, frame_of(message), _data_of(message), context)

    return contents


def video(message: Any, _: Context) -> VideoFrame:
    """A frame of a video."""
    return VideoFrame(frame_of(message), message.format, _data_of(message))


def depth_file(message: Any, context: Context) -> DepthImage:
    """Depth of a PNG with 16 bits a pixel.

    The format is ``16UC1; compressedDepth``, ``32FC1; compressedDepth png`` or ``16UC1; png``.
    """
    layout, content = message.format, _data_of(message)
    file_at = _DEPTH_HEADER.size if "compressedDepth" in layout else 0
    return DepthImage(
        frame_of(message),
        lambda: _decoded_depth(layout, content, context.limits),
        lambda: images.image_size(content[file_at:], context.limits),
        layout,
    )


def _of_file(kind: Kind, frame_id: str, content: bytes, context: Context) -> Picture:
    """An image of a file's bytes, instance masks of a PNG in CARLA's coding, or tags of a PNG.

    Tags are palette indices, grey values, or CARLA's colours.

    Raises:
        DecodeError: the table of numeric tags is unknown, or instance masks are not in a PNG.
    """
    limits = context.limits

    def bgr() -> Image:
        return images.decode_bgr(content, limits)

    def size() -> tuple[int, int]:
        return images.image_size(content, limits)

    coding = images.format_of(content).lower()
    if kind == "image":
        grey = partial(images.decode_grey, content, limits)
        return CameraImage(frame_id, bgr, grey, size, _is_png(content), coding, content)
    if kind == "instances":
        if not _is_png(content):
            raise DecodeError("instance masks: expected a lossless PNG with CARLA's coding")
        return InstanceImage(frame_id, lambda: images.instance_ids(bgr()))
    in_colours = _is_png(content) and content[_COLOUR_TYPE : _COLOUR_TYPE + 1] in _TRUE_COLOURS
    table = _table_of(context.tag_table, indexed=not in_colours)
    if in_colours:
        return TagImage(frame_id, table, lambda: tags_of_colours(bgr(), table), size, coding)
    return TagImage(frame_id, table, lambda: images.decode_indices(content, limits), size, coding)


def _is_png(content: bytes) -> bool:
    return content[: len(images.PNG_MAGIC)] == images.PNG_MAGIC


def _table_of(table: TagTable | None, *, indexed: bool) -> TagTable:
    """The table that the log or the user names. Colours need none: a colour means the same class in every version."""
    if table is not None:
        return table
    if indexed:
        raise DecodeError("the log names no tag table; set one, such as --set tag_table=0.9.15")
    return PALETTE_TABLE


def _data_of(message: Any) -> bytes:
    content = message.data  # each access to a protobuf's field copies it
    return content if isinstance(content, bytes) else bytes(content.tobytes())


def _decoded_depth(layout: str, content: bytes, limits: LimitsConfig) -> tuple[Float32, float]:
    """Metres, and the largest depth of the encoding.

    Source of the quantisation of 32FC1: image_transport_plugins' compressed_depth_image_transport.
    """
    headed = "compressedDepth" in layout
    if headed and len(content) < _DEPTH_HEADER.size:
        raise DecodeError(f"depth of format {layout!r}: {len(content)} bytes, expected a header of 12 bytes")
    pixels = images.decode_grey16(content[_DEPTH_HEADER.size :] if headed else content, limits)
    if not layout.startswith("32FC1"):
        return images.depth_from_mm(pixels), images.DEPTH_LIMIT_MM / 1000
    if not headed:
        raise DecodeError(f"depth of format {layout!r}: expected 16UC1, or compressedDepth")
    _, scale, offset = _DEPTH_HEADER.unpack_from(content)
    depth_m = np.float32(scale) / (pixels.astype(np.float32) - np.float32(offset))
    depth_m[(pixels == images.UNKNOWN_MM) | ~(depth_m > 0)] = np.nan
    return depth_m, np.inf
