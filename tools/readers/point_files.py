"""Read a lidar's points and convert them to ROS's right-handed x forward, y left, z up.

The format of a file gives its axes:

- ``.ply``: ``carla.LidarMeasurement.save_to_disk``, text or binary_little_endian; CARLA's left-handed x forward,
  y right, z up, properties x, y, z and perhaps I.
- ``.npy``: an (N, 3) or wider array of CARLA's ``raw_data``; left-handed as well, the fourth column the intensity.
- ``.las``, ``.laz``: of CARLA's datasets; left-handed as well.
- ``.bin``: KITTI's velodyne, (N, 4) float32 little-endian x forward, y left, z up, reflectance; right-handed already.
- ``.pcd.bin``: nuScenes' lidar, (N, 5) float32 x right, y forward, z up, intensity, ring; stays in the sensor's axes.

Raises everywhere:
    UnreadableFrameError: the file is damaged or unknown; the message names file, expected and found content.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float32

from .image_files import UnreadableFrameError, first_bytes, read_bytes
from .library_formats import LAS_MAGIC, read_las
from .pixel_files import NPY_MAGIC, read_npy

_PLY_END: Final = re.compile(rb"(?<=\n)end_header\r?\n")
"""The last header line, ended by one byte, or two on Windows. The points follow directly."""
_PLY_NAMES: Final = ("char", "uchar", "short", "ushort", "int", "uint", "float", "double")
_SIZED_NAMES: Final = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")
_NUMPY_TYPES: Final = ("i1", "u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8")
_PLY_TYPES: Final = dict(zip(_PLY_NAMES + _SIZED_NAMES, _NUMPY_TYPES * 2, strict=True))
"""numpy's type by the name in a PLY header."""
_INTENSITY: Final = ("I", "intensity", "Intensity")
_LONGEST_HEADER: Final = 4096


@dataclass(frozen=True)
class PointFormat:
    """A format of points: how a file begins, its name in messages, and its reader."""

    magic: bytes
    name: str
    description: str
    read: Callable[[Path, bytes], NDArray[Any]]
    """Returns (N, 3) x, y, z, or (N, 4) with intensities, as stored."""

    @property
    def is_left_handed(self) -> bool:
        """Return True if y points to the right."""
        return self.description.endswith("left-handed")


def points_kind(path: Path) -> str:
    """Return the description of a file of points, from its name and first bytes."""
    return _format_of(path).description


def load_points(path: Path) -> Float32:
    """Return (N, 3) x forward, y left, z up in metres from the lidar, or (N, 4) with intensities; right-handed.

    Coordinates beyond the range of float32 become infinite; readers of the log skip such points.
    """
    form = _format_of(path)
    with np.errstate(over="ignore", invalid="ignore"):
        points = form.read(path, read_bytes(path)).astype(np.float32)
    if form.is_left_handed:
        points[:, 1] *= -1
    return points


def _format_of(path: Path) -> PointFormat:
    name = path.name.lower()
    suffix = ".pcd.bin" if name.endswith(".pcd.bin") else path.suffix.lower()
    if suffix not in FORMATS:
        raise UnreadableFrameError(f"{path}: expected points as .ply, .npy, .bin, .las or .laz")
    start = first_bytes(path, len(NPY_MAGIC))
    if not start:
        raise UnreadableFrameError(f"{path}: empty file")
    if not start.startswith(FORMATS[suffix].magic):
        raise UnreadableFrameError(f"{path}: starts with {start[:4].hex()}, expected a {FORMATS[suffix].name} file")
    return FORMATS[suffix]


def _floats(columns: int, path: Path, data: bytes) -> NDArray[Any]:
    if len(data) % (4 * columns):
        expected = f"points of {4 * columns} bytes (float32 x {columns})"
        raise UnreadableFrameError(f"{path}: {len(data)} bytes, expected {expected}")
    return np.frombuffer(data, "<f4").reshape(-1, columns)[:, :4]


def _npy(path: Path, data: bytes) -> NDArray[Any]:
    values = read_npy(path, data)
    if values.ndim != 2 or values.shape[1] < 3:
        raise UnreadableFrameError(f"{path}: {values.shape}, expected numbers of shape (N, 3) or wider")
    return values[:, :4]


def _ply(path: Path, data: bytes) -> NDArray[Any]:
    end = _PLY_END.search(data, 0, _LONGEST_HEADER)
    if end is None:
        raise UnreadableFrameError(f"{path}: no end_header, expected a whole PLY header")
    lines = [line.split() for line in data[: end.start()].decode("ascii", "replace").splitlines()]
    form = next((line[1] for line in lines if line[:1] == ["format"] and len(line) > 1), "none")
    if form not in _PLY_BODIES:
        raise UnreadableFrameError(f"{path}: PLY format {form}, expected {' or '.join(_PLY_BODIES)}")
    count, properties = _vertices(path, lines)
    if not {"x", "y", "z"} <= set(properties):
        raise UnreadableFrameError(f"{path}: properties {', '.join(properties) or 'none'}, expected x, y and z")
    columns = ["x", "y", "z", *[name for name in _INTENSITY if name in properties][:1]]
    records = _PLY_BODIES[form](path, data[end.end() :], count, properties)
    return np.stack([records[name].astype(np.float32) for name in columns], axis=-1)


def _vertices(path: Path, lines: list[list[str]]) -> tuple[int, dict[str, str]]:
    """Return the number of points in a PLY header, and numpy's type of each property by name."""
    elements = [k for k, line in enumerate(lines) if line[:1] == ["element"]]
    if not elements or len(lines[elements[0]]) != 3 or lines[elements[0]][1] != "vertex":
        raise UnreadableFrameError(f"{path}: expected the points (element vertex) first in the PLY file")
    count = lines[elements[0]][2]
    last = elements[1] if len(elements) > 1 else len(lines)
    found = [line[1:] for line in lines[elements[0] : last] if line[:1] == ["property"]]
    wrong = next((line for line in found if len(line) != 2 or line[0] not in _PLY_TYPES), None)
    if wrong is not None or not count.isdigit():
        what = f"property {' '.join(wrong)}" if wrong is not None else f"element vertex {count}"
        raise UnreadableFrameError(f"{path}: {what}: expected a number of points, each with plain numbers")
    return int(count), {name: _PLY_TYPES[kind] for kind, name in found}


def _text_body(path: Path, body: bytes, count: int, properties: Mapping[str, str]) -> Mapping[str, NDArray[Any]]:
    words = body.split()[: count * len(properties)]
    _require_whole(path, len(words) // len(properties), count)
    try:
        table = np.array(words, np.float64).reshape(count, len(properties))
    except ValueError as error:
        raise UnreadableFrameError(f"{path}: a coordinate is not a number: {error}") from error
    return dict(zip(properties, table.T, strict=True))


def _binary_body(path: Path, body: bytes, count: int, properties: Mapping[str, str]) -> Mapping[str, NDArray[Any]]:
    record = np.dtype(list(properties.items()))
    _require_whole(path, len(body) // record.itemsize, count)
    points = np.frombuffer(body, record, count)
    return {name: points[name] for name in properties}


def _require_whole(path: Path, found: int, count: int) -> None:
    if found < count:
        raise UnreadableFrameError(f"{path}: {found} points, its header says {count}")


_PLY_BODIES: Final = {"ascii": _text_body, "binary_little_endian": _binary_body}
_LAS: Final = PointFormat(LAS_MAGIC, "LAS", "las, left-handed", read_las)
FORMATS: Final[Mapping[str, PointFormat]] = {
    ".ply": PointFormat(b"ply", "PLY", "ply, left-handed", _ply),
    ".npy": PointFormat(NPY_MAGIC, ".npy", "npy, left-handed", _npy),
    ".las": _LAS,
    ".laz": _LAS,
    ".bin": PointFormat(b"", "", "KITTI velodyne, right-handed", partial(_floats, 4)),
    ".pcd.bin": PointFormat(b"", "", "nuScenes lidar, right-handed", partial(_floats, 5)),
}
"""The formats of points by the suffix of their files."""
