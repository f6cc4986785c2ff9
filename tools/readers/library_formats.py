"""Read OpenEXR, HDF5 and LAS files by the libraries of the extra ``recordings``.

Raises everywhere:
    UnreadableFrameError: the file is damaged or too large, or it holds no array or several arrays of depth.
    DumpError: the library is not installed.
"""

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import LimitsConfig
from roadperc_stream.errors import DumpError

from .image_files import UnreadableFrameError

EXR_MAGIC: Final = b"\x76\x2f\x31\x01"
HDF5_MAGIC: Final = b"\x89HDF\r\n\x1a\n"
LAS_MAGIC: Final = b"LASF"
_DEPTH_CHANNELS: Final = ("depth", "z", "v", "y", "r")
"""Channels of EXR files that hold depth; an earlier one is preferred."""
_LIMITS: Final = LimitsConfig()


def read_exr(path: Path) -> NDArray[Any]:
    """Return the (H, W) depth channel of an EXR file, or its only channel."""
    with _library(path, "OpenEXR") as exr:
        first, last = exr.File(str(path), header_only=True).header()["dataWindow"]
        _require_at_most(path, "pixels", last - first + 1, _LIMITS.image_pixels)
        channels = exr.File(str(path), separate_channels=True).channels()
    by_leaf = {name.rpartition(".")[2].lower(): name for name in channels}
    depth = [by_leaf[leaf] for leaf in _DEPTH_CHANNELS if leaf in by_leaf]
    return np.asarray(_only(path, channels, depth[:1]).pixels)


def read_hdf5(path: Path) -> NDArray[Any]:
    """Return the (H, W) array of numbers of an HDF5 file that is named after depth, or the only one."""
    arrays: dict[str, Any] = {}

    def collect(name: str, item: Any) -> None:
        if len(getattr(item, "shape", None) or ()) == 2 and item.dtype.kind in "fiu":
            arrays[name] = item

    with _library(path, "h5py") as h5py, h5py.File(path, "r") as file:
        file.visititems(collect)
        found = _only(path, arrays, [name for name in arrays if "depth" in name.lower()])
        _require_at_most(path, "pixels", found.shape, _LIMITS.image_pixels)
        return np.asarray(found[()])


def read_las(path: Path, data: bytes) -> NDArray[np.float64]:
    """Return (N, 4) x, y, z and intensity of a LAS or LAZ file, as stored.

    The numbers of a damaged header are checked first, because laspy would end the process for want of memory.
    """
    records = [int.from_bytes(data[100:104], "little") * 54]
    records += [int.from_bytes(data[243:247], "little") * 60] * (data[25:26] >= b"\x04")  # since LAS 1.4
    _require_at_most(path, "bytes of records", [max(records)], len(data))
    with _library(path, "laspy") as laspy, laspy.open(io.BytesIO(data)) as file:
        _require_at_most(path, "points", [file.header.point_count], _LIMITS.points)
        points = file.read()
        return np.column_stack((points.xyz, points.intensity))


@contextmanager
def _library(path: Path, name: str) -> Iterator[Any]:
    """Import a library and state its errors."""
    try:
        library = import_module(name)
    except ImportError as error:
        hint = "pip install '.[recordings]' in the project's folder"
        raise DumpError(f"{path}: {name} is not installed; {hint}") from error
    own = (library.errors.LaspyException,) if name == "laspy" else ()
    try:
        yield library
    except (RuntimeError, ValueError, KeyError, OSError, MemoryError, *own) as error:
        raise UnreadableFrameError(f"{path}: {name} cannot read it: {error}") from error


def _only(path: Path, arrays: Mapping[str, Any], preferred: Sequence[str]) -> Any:
    names = preferred or list(arrays)
    if len(names) != 1:
        raise UnreadableFrameError(f"{path}: expected one array of depth, found {', '.join(names) or 'none'}")
    return arrays[names[0]]


def _require_at_most(path: Path, what: str, sides: Sequence[int] | NDArray[Any], limit: int) -> None:
    if (count := np.prod([float(side) for side in sides])) > limit:
        raise UnreadableFrameError(f"{path}: {count:.0f} {what}, expected at most {limit}")
