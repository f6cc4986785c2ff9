"""Read OpenEXR, HDF5 and LAS files by the libraries of the extra ``recordings``."""

import io
from collections.abc import Mapping
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
_VLRS: Final = ((100, 54), (243, 60))
"""Places of the counts of variable length records in a LAS header, and the smallest size of a record."""


def read_exr(path: Path) -> NDArray[Any]:
    """Return the (H, W) depth channel of an EXR file, or its only channel.

    Raises:
        UnreadableFrameError: the file is damaged or too large, or no channel is depth.
        DumpError: the library is not installed.
    """
    exr = _library(path, "OpenEXR")
    try:
        first, last = exr.File(str(path), header_only=True).header()["dataWindow"]
        _require_pixels(path, [int(b) - int(a) + 1 for a, b in zip(first, last, strict=True)])
        channels = {
            name: found.pixels for name, found in exr.File(str(path), separate_channels=True).channels().items()
        }
    except (RuntimeError, ValueError, KeyError, OSError) as error:
        raise UnreadableFrameError(f"{path}: damaged EXR file: {error}") from error
    by_leaf = {name.rpartition(".")[2].lower(): name for name in sorted(channels, reverse=True)}
    depth = next((by_leaf[leaf] for leaf in _DEPTH_CHANNELS if leaf in by_leaf), None)
    return np.asarray(_chosen(path, channels, [*channels] if len(channels) == 1 else [depth] if depth else []))


def read_hdf5(path: Path) -> NDArray[Any]:
    """Return the only (H, W) array of numbers of an HDF5 file, or the only one that is named after depth.

    Raises:
        UnreadableFrameError: the file is damaged or too large, or there is no such array.
        DumpError: the library is not installed.
    """
    h5py = _library(path, "h5py")
    arrays: dict[str, Any] = {}

    def collect(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and len(item.shape or ()) == 2 and item.dtype.kind in "fiu":
            arrays[name] = item

    try:
        with h5py.File(path, "r") as file:
            file.visititems(collect)
            of_depth = [name for name in arrays if "depth" in name.lower()]
            found = _chosen(path, arrays, of_depth or [*arrays])
            _require_pixels(path, found.shape)
            return np.asarray(found[()])
    except (RuntimeError, ValueError, KeyError, OSError) as error:
        raise UnreadableFrameError(f"{path}: damaged HDF5 file: {error}") from error


def read_las(path: Path, data: bytes) -> NDArray[np.float64]:
    """Return (N, 4) x, y, z and intensity of a LAS or LAZ file, as stored.

    Raises:
        UnreadableFrameError: the file is damaged or too large.
        DumpError: the library is not installed.
    """
    laspy = _library(path, "laspy")
    records = [
        int.from_bytes(data[place : place + 4], "little") * size for place, size in _VLRS[: 1 + (data[25:26] >= b"\4")]
    ]
    if max(records) > len(data):  # laspy would read each of billions of records
        raise UnreadableFrameError(f"{path}: damaged LAS file: its header states {max(records)} bytes of records")
    try:
        with laspy.open(io.BytesIO(data)) as file:
            if file.header.point_count > _LIMITS.points:
                raise UnreadableFrameError(
                    f"{path}: {file.header.point_count} points, expected at most {_LIMITS.points}"
                )
            points = file.read()
            return np.column_stack((points.xyz, points.intensity))
    except (RuntimeError, ValueError, OSError, laspy.errors.LaspyException) as error:
        raise UnreadableFrameError(f"{path}: damaged LAS file: {error}") from error


def _library(path: Path, name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise DumpError(f"{path}: {name} is not installed; pip install 'roadperc_stream[recordings]'") from error


def _chosen(path: Path, arrays: Mapping[str, Any], names: list[str]) -> Any:
    if len(names) != 1:
        found = ", ".join(names or arrays) or "none"
        raise UnreadableFrameError(f"{path}: expected one array of depth, found {found}")
    return arrays[names[0]]


def _require_pixels(path: Path, sides: Any) -> None:
    if np.prod([float(side) for side in sides]) > _LIMITS.image_pixels:
        size = "x".join(map(str, sides))
        raise UnreadableFrameError(f"{path}: {size} pixels, expected at most {_LIMITS.image_pixels}")
