"""Files that recorders of CARLA write: documents as JSON or Python literals, and left-handed matrices.

Raises everywhere:
    DumpError: a file cannot be read, or is wrong; the message names file and line or key.
"""

import ast
import gzip
import io
import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field

from roadperc_stream.config.calibration import Number, Numbers4
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.system.files import read_file

from ..readers.documents import frame_number, parsed_json, pose
from ..readers.sensor_folders import Sensor, points_fault
from .dataset import Request

Matrix4 = tuple[Numbers4, Numbers4, Numbers4, Numbers4]
_Half = Annotated[Number, Field(ge=0)]
Halves = tuple[_Half, _Half, _Half]
"""Half the length, width and height of a box, or the whole in TransFuser."""
_MOST_BYTES: Final = 16_000_000
"""Largest document of a frame; those of Bench2Drive have 100 kB."""
_MOST_LITERAL: Final = 1_000_000
"""Longest Python literal; its syntax tree takes hundreds of bytes for each character."""
_MIRROR: Final = np.diag((1.0, -1.0, 1.0, 1.0))


def read_document(path: Path) -> Any:
    """Return the content of a file with JSON or a Python literal, perhaps compressed with gzip."""
    try:
        data = read_file(path, _MOST_BYTES)
        if path.suffix == ".gz":
            data = gzip.GzipFile(fileobj=io.BytesIO(data)).read(_MOST_BYTES + 1)
        text = data.decode()
    except OSError as error:
        raise DumpError(f"{path}: {error.strerror or error}") from error
    except (EOFError, zlib.error, UnicodeDecodeError) as error:
        raise DumpError(f"{path}: {error}") from error
    if len(data) > _MOST_BYTES:
        raise DumpError(f"{path}: is larger than {_MOST_BYTES // 1_000_000} MB without compression")
    try:
        return parsed_json(path, text)
    except DumpError:
        if "'" not in text or len(text) > _MOST_LITERAL:
            raise
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, RecursionError, MemoryError) as error:
        line = getattr(error, "lineno", None) or 1
        what = f": {error.msg}" if isinstance(error, SyntaxError) else ": it holds a name or a call"
        raise DumpError(f"{path}: line {line}: neither JSON nor a Python literal{what}") from error


def numbered(folder: Path, pattern: str) -> dict[int, Path]:
    """Return the files of a folder by the number in their names, in order."""
    found = {frame_number(path.name.partition(".")[0]): path for path in folder.glob(pattern)}
    return {number: found[number] for number in sorted(key for key in found if key is not None)}


def folders_that(fits: Callable[[Path], bool], folder: Path) -> dict[str, Path]:
    """Return the folder itself by its name if it fits, else those inside it that do."""
    if fits(folder):
        return {folder.resolve().name: folder}
    with os.scandir(folder) as entries:
        inside = sorted(entry.name for entry in entries if entry.is_dir())
    return {name: folder / name for name in inside if fits(folder / name)}


def right_handed_matrix(where: Path | str, matrix: Matrix4) -> Float:
    """Return the (4, 4) right-handed transform of a matrix of ``carla.Transform.get_matrix``, or of its inverse."""
    return pose(f"{where}", _MIRROR @ np.array(matrix, np.float64) @ _MIRROR)


def laz_sensor(request: Request, images: Sensor) -> dict[str, Sensor]:
    """Return the sensor of ``lidar/*.laz`` by its role, or nothing with a note about points that cannot be read."""
    files = numbered(request.path / "lidar", "*.laz")
    if not files and not (request.path / "lidar").is_dir():
        return {}
    sensor = Sensor(LIDAR, "lidar", files)
    try:
        fault = points_fault(sensor, set(images.files)) if files else "expected points as .laz"
    except DumpError as error:  # the library is not installed
        fault = str(error)
    if fault:
        request.notes.append(f"lidar/ is left out: {fault}")
        return {}
    return {LIDAR: sensor}
