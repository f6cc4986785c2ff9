"""Semantic tags from raw images, palette images and CSV text. The content decides, once for each sensor.

``TAGS`` is the table of encodings. To read another one, add its name and its function there.

Raises everywhere:
    DumpError: the content is not tags of the table, or in another encoding than the sensor's other files; the message
        names the file.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config.settings import read_toml
from roadperc_stream.errors import DumpError
from roadperc_stream.formats.raster import PALETTE_TABLE, UNKNOWN, tags_by_code
from roadperc_stream.model import Image, tag_tables
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14, TagTable

from .pixel_files import Pixels, samples_of

TagEncoding = Literal["raw in red", "raw grey", "raw numbers", "palette colours"]

LOSSY_TAGS: Final = "tags that are not exact are replaced by the nearest tag (--allow-lossy-tags)"
_LARGEST_TAG: Final = 65
"""Largest tag if no dataset's table is named; palette colours have larger values, such as a building's 70."""
_JPEG_SLACK: Final = 40
"""Largest value of the empty channels of CARLA's raw images after JPEG compression."""
_SHOWN: Final = 12


def named_table(name: str | None) -> tuple[TagTable, str] | None:
    """Return the table of a CARLA version, a dataset or a TOML file, and its source; None without a name."""
    if name is None:
        return None
    if name.endswith(".toml"):
        return tag_tables.table_of(read_toml(Path(name)), name), name
    return tag_tables.table_for_version(name), name if name in tag_tables.TABLES else f"CARLA {name}"


def tag_encoding(
    files: Sequence[Path], table: TagTable | None, *, allow_lossy: bool
) -> tuple[TagEncoding, tuple[int, ...]]:
    """Return the encoding of a sensor's files, and the raw tags in a sample (none in palette images).

    ``table`` is the one that the user names.
    """
    samples = samples_of(files)
    for pixels in samples:
        _refuse_jpeg(pixels, allow_lossy=allow_lossy)
    found = [kind for pixels in samples if (kind := _encoding(pixels, table))]
    encoding: TagEncoding = found[0] if found else "raw in red"
    if encoding == "palette colours":
        return encoding, ()
    return encoding, tuple(sorted({int(t) for pixels in samples for t in np.unique(_raw(pixels))}))


def _refuse_jpeg(pixels: Pixels, *, allow_lossy: bool) -> None:
    if pixels.container == "jpeg" and not allow_lossy:
        raise DumpError(
            f"{pixels.path}: tags as JPEG: compression changes values, so the exact tags are lost; "
            "store PNG, or pass --allow-lossy-tags to use the nearest tags"
        )


def _encoding(pixels: Pixels, table: TagTable | None) -> TagEncoding | None:
    """Return the encoding of a file; None if it is all black.

    In a dataset's palette images the indices are the tags. In BDD100K's bitmasks red is the tag, and the other channels
    are attributes and instances.
    """
    of_carla = table is None or table in tag_tables.CARLA_TABLES
    largest = _LARGEST_TAG if table is None or of_carla else len(table.names) - 1
    if pixels.channels == 1:
        return "palette colours" if of_carla and _palette_of_classes(pixels) else "raw numbers"
    if pixels.channels not in (3, 4) or pixels.values.dtype != np.uint8:
        raise DumpError(f"{pixels.path}: {pixels.shape} is not a tag image")
    blue, green, red = (pixels.values[..., c] for c in range(3))
    if not of_carla and pixels.channels == 4 and (pixels.values[..., 3] < np.iinfo(np.uint8).max).any():
        return "raw in red"
    slack = _JPEG_SLACK if pixels.container == "jpeg" else 0
    if not (blue.any() or green.any() or red.any()):
        return None
    if blue.max() <= slack and green.max() <= slack and red.max() <= largest:
        return "raw in red"
    if pixels.equal_channels() and red.max() <= largest:
        return "raw grey"
    return "palette colours"


def _palette_of_classes(pixels: Pixels) -> bool:
    """Return True if each used index has the colour of a class; then the colours give the tags, not the indices."""
    colours = CARLA_FROM_0_9_14.tag_by_colour
    return bool(pixels.palette) and all(
        i < len(pixels.palette) and pixels.palette[i] in colours for i in np.unique(pixels.values)
    )


def choose_table(encoding: TagEncoding, seen: tuple[int, ...], source: str) -> tuple[TagTable, str]:
    """Return the tag table of tags whose table is not named, and its source.

    Args:
        encoding: encoding of the tags.
        seen: raw tags in a sample of the files.
        source: the sensor's folder, for the message.
    """
    if encoding == "palette colours":
        return PALETTE_TABLE, "colours name the classes in every version"
    if seen and len(tag_tables.CARLA_BEFORE_0_9_14.names) <= max(seen) < len(CARLA_FROM_0_9_14.names):
        return CARLA_FROM_0_9_14, f"tag {max(seen)} exists only there"
    meanings = "; ".join(
        f"{table.name}: {', '.join(f'{t} {table.name_of(t)}' for t in seen[:_SHOWN])}"
        for table in tag_tables.CARLA_TABLES
    )
    raise DumpError(
        f"{source}: the CARLA version of the tags is unknown, and their numbers fit several tables: {meanings}. "
        'Pass --carla VERSION, such as --carla 0.9.15, or --tags TABLE, or add "carla_tags" to calibration.json'
    )


def tags_of(pixels: Pixels, encoding: TagEncoding, table: TagTable, *, allow_lossy: bool) -> Image:
    """Return (H, W) uint8 tags of the table."""
    _refuse_jpeg(pixels, allow_lossy=allow_lossy)
    own = _encoding(pixels, table)
    if own not in (encoding, None) and not (allow_lossy and pixels.container == "jpeg"):
        raise DumpError(f"{pixels.path}: tags are encoded as {own}, the files before as {encoding}")
    return TAGS[encoding](pixels, table, allow_lossy)


def _raw(pixels: Pixels) -> NDArray[Any]:
    values: NDArray[Any] = pixels.values
    if pixels.channels > 1:
        return values[..., 2]
    if values.dtype.kind == "f" and not (np.isfinite(values) & (values == np.rint(values))).all():
        raise DumpError(f"{pixels.path}: tags must be whole numbers")
    return values


def _tags_of_numbers(pixels: Pixels, table: TagTable, allow_lossy: bool) -> Image:
    raw, largest = _raw(pixels), len(table.names) - 1
    if table.instances_per_tag and raw.max() >= table.instances_per_tag:
        raw = np.where(raw < table.instances_per_tag, raw, raw // table.instances_per_tag)
    outside = (raw < 0) | (raw > largest)
    if table.gaps:
        outside |= np.isin(raw, list(table.gaps))
    if outside.any() and not allow_lossy:
        tag, count = int(raw[outside].flat[0]), int(np.count_nonzero(outside))
        raise DumpError(f"{pixels.path}: tag {tag} is not in {table.title} ({_tags_in_words(table)}); {count} pixels")
    tags: Image = np.clip(raw, 0, largest).astype(np.uint8)
    return tags


def _tags_in_words(table: TagTable) -> str:
    """Return the tags as ranges: ``0 to 18, 255``."""
    tags = [tag for tag in range(len(table.names)) if tag not in table.gaps]
    runs = [[tag for _, tag in run] for _, run in groupby(enumerate(tags), lambda pair: pair[1] - pair[0])]
    return ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


def _tags_of_colours(pixels: Pixels, table: TagTable, allow_lossy: bool) -> Image:
    codes = _colour_codes(pixels)
    tags: Image = tags_by_code(table)[codes]
    unknown = tags == UNKNOWN
    if not unknown.any():
        return tags
    if not allow_lossy:
        raise DumpError(_unknown_colour(pixels, codes[unknown], table))
    tags[unknown] = _nearest(codes[unknown], table)
    return tags


def _colour_codes(pixels: Pixels) -> NDArray[Any]:
    """Return (H, W) colours as red * 65536 + green * 256 + blue."""
    if pixels.palette:
        table = np.array([(r << 16) | (g << 8) | b for r, g, b in pixels.palette], np.uint32)
        return np.asarray(table[pixels.values])
    blue, green, red = (pixels.values[..., c].astype(np.uint32) for c in range(3))
    return (red << 16) | (green << 8) | blue


def _nearest(codes: NDArray[np.uint32], table: TagTable) -> Image:
    """Return the tag of the nearest palette colour by squared distance in RGB."""
    distinct, inverse = np.unique(codes, return_inverse=True)
    rgb = np.stack((distinct >> 16, distinct >> 8 & 255, distinct & 255), axis=-1).astype(np.int32)
    best = np.full(len(distinct), np.iinfo(np.int32).max)
    tags = np.zeros(len(distinct), np.uint8)
    for colour, tag in table.tag_by_colour.items():
        distance = ((rgb - np.array(colour, np.int32)) ** 2).sum(axis=1)
        tags[distance < best] = tag
        best = np.minimum(best, distance)
    return tags[inverse]


def _unknown_colour(pixels: Pixels, codes: NDArray[np.uint32], table: TagTable) -> str:
    distinct, counts = np.unique(codes, return_counts=True)
    code = int(distinct[counts.argmax()])
    colour = (code >> 16, code >> 8 & 255, code & 255)
    more = f" and {len(distinct) - 1} more colours" if len(distinct) > 1 else ""
    return (
        f"{pixels.path}: colour {colour} ({counts.max()} pixels){more} is not in the palette of {table.title}. "
        "Is it an image of instance ids, or smoothed? Pass --allow-lossy-tags to use the nearest colour"
    )


TAGS: Final[Mapping[TagEncoding, Callable[[Pixels, TagTable, bool], Image]]] = {
    "raw in red": _tags_of_numbers,
    "raw grey": _tags_of_numbers,
    "raw numbers": _tags_of_numbers,
    "palette colours": _tags_of_colours,
}
"""Tags of a file by its encoding, (H, W) uint8; the last argument allows the nearest tag instead of an error."""
