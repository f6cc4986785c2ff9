"""Images, tags and depth of a message's pixels: raw ones, and files such as PNG and JPEG."""

import struct
from typing import Final

import numpy as np

from roadperc_stream.config import LimitsConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import images
from roadperc_stream.formats.raster import PALETTE_TABLE, Content, Raster, tags_of_colours
from roadperc_stream.geometry import Float32
from roadperc_stream.input.decoding.payload import Context
from roadperc_stream.model import CameraImage, DepthImage, InstanceImage, TagImage
from roadperc_stream.model.tag_tables import TagTable

_COLOUR_TYPE: Final = 25
"""Where a PNG says how its pixels are coloured."""
_TRUE_COLOURS: Final = (b"\x02", b"\x06")
_DEPTH_HEADER: Final = struct.Struct("<iff")
"""Of compressedDepth: a number nobody uses, and both parameters of the quantisation of 32FC1."""


def encoded_image(frame_id: str, content: Content, context: Context) -> CameraImage:
    """A camera's image of a file's bytes."""
    limits = context.limits
    return CameraImage(
        frame_id,
        lambda: images.decode_bgr(bytes(content), limits),
        lambda: images.decode_grey(bytes(content), limits),
        lambda: images.image_size(bytes(content), limits),
    )


def raw_image(frame_id: str, raster: Raster, context: Context) -> CameraImage:
    """A camera's image of raw pixels.

    Raises:
        DecodeError: it is beyond the limits.
    """
    _require_pixels("image", raster, context.limits)
    return CameraImage(frame_id, raster.bgr, raster.grey, raster.size)


def raw_depth(frame_id: str, raster: Raster, context: Context) -> DepthImage:
    """Depth of raw pixels.

    Raises:
        DecodeError: it is beyond the limits.
    """
    _require_pixels("depth", raster, context.limits)
    return DepthImage(frame_id, raster.depth)


def raw_tags(frame_id: str, raster: Raster, context: Context) -> TagImage:
    """Tags of raw pixels, numbers or CARLA's colours.

    Raises:
        DecodeError: numbers, and nobody says which table is theirs; or beyond the limits.
    """
    _require_pixels("tags", raster, context.limits)
    known = _table_of(context.tag_table, indexed=raster.indexed)
    return TagImage(frame_id, known, lambda: raster.tags(known))


def _require_pixels(what: str, raster: Raster, limits: LimitsConfig) -> None:
    """Refuse too many pixels; of a size that the data do not have, decoding says so."""
    if raster.width * raster.height <= len(raster.data):
        images.require_pixels(what, raster.width, raster.height, limits)


def encoded_tags(frame_id: str, content: Content, context: Context) -> TagImage:
    """Tags of a PNG: palette indices, grey values, or CARLA's colours.

    Raises:
        DecodeError: numbers, and nobody says which table is theirs.
    """
    limits = context.limits
    if _is_png(content) and content[_COLOUR_TYPE : _COLOUR_TYPE + 1] in _TRUE_COLOURS:
        known = _table_of(context.tag_table, indexed=False)
        return TagImage(frame_id, known, lambda: tags_of_colours(images.decode_bgr(bytes(content), limits), known))
    known = _table_of(context.tag_table, indexed=True)
    return TagImage(frame_id, known, lambda: images.decode_indices(bytes(content), limits))


def encoded_instances(frame_id: str, content: Content, context: Context) -> InstanceImage:
    """Masks of a PNG in CARLA's coding.

    Raises:
        DecodeError: another file, whose numbers are not exact.
    """
    if not _is_png(content):
        raise DecodeError("instance masks that are no PNG: expected CARLA's coding, which no lossy file keeps")
    return InstanceImage(frame_id, lambda: images.instance_ids(images.decode_bgr(bytes(content), context.limits)))


def _is_png(content: Content) -> bool:
    return content[: len(images.PNG_MAGIC)] == images.PNG_MAGIC


def raw_instances(frame_id: str, raster: Raster, context: Context) -> InstanceImage:
    """Masks of raw pixels in CARLA's coding.

    Raises:
        DecodeError: beyond the limits.
    """
    _require_pixels("instances", raster, context.limits)
    return InstanceImage(frame_id, lambda: images.instance_ids(raster.bgr()))


def _table_of(table: TagTable | None, *, indexed: bool) -> TagTable:
    """The table a log or the user names; colours need none, for each names its class in every version."""
    if table is not None:
        return table
    if indexed:
        raise DecodeError("the log does not say its tag table; set tag_table, such as --set tag_table=0.9.15")
    return PALETTE_TABLE


def encoded_depth(frame_id: str, layout: str, content: bytes, context: Context) -> DepthImage:
    """Depth of a PNG with 16 bits a pixel.

    Args:
        frame_id: of the camera.
        layout: the message's ``format``: ``16UC1; compressedDepth``, ``32FC1; compressedDepth png`` or ``16UC1; png``.
        content: the message's data.
        context: has the limits of its size.
    """
    return DepthImage(frame_id, lambda: _decoded_depth(layout, content, context.limits))


def _decoded_depth(layout: str, content: bytes, limits: LimitsConfig) -> tuple[Float32, float]:
    """Metres, and where the encoding ends.

    Source of the quantisation of 32FC1: image_transport_plugins' compressed_depth_image_transport.
    """
    headed = "compressedDepth" in layout
    if headed and len(content) < _DEPTH_HEADER.size:
        raise DecodeError(f"depth of format {layout!r}: {len(content)} bytes, expected a header of 12 bytes")
    pixels = _png16(layout, content[_DEPTH_HEADER.size :] if headed else content, limits)
    if not layout.startswith("32FC1"):
        return images.depth_from_mm(pixels), images.DEPTH_LIMIT_MM / 1000
    if not headed:
        raise DecodeError(f"depth of format {layout!r}: expected 16UC1, or compressedDepth")
    _, scale, offset = _DEPTH_HEADER.unpack_from(content)
    depth_m = np.float32(scale) / (pixels.astype(np.float32) - np.float32(offset))
    depth_m[(pixels == images.UNKNOWN_MM) | ~(depth_m > 0)] = np.nan
    return depth_m, np.inf


def _png16(layout: str, content: bytes, limits: LimitsConfig) -> np.ndarray[tuple[int, int], np.dtype[np.uint16]]:
    pixels = images.decode_unchanged(content, limits) if _is_png(content) else None
    if pixels is None:
        raise DecodeError(f"depth of format {layout!r}: expected a whole PNG, it starts with {content[:4].hex()}")
    if pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise DecodeError(f"depth of format {layout!r}: {pixels.shape} {pixels.dtype}, expected 16 bits a pixel")
    return pixels
