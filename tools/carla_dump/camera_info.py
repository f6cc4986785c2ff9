"""Read a camera's calibration from ROS: the YAML of ``camera_info`` that camera_calibration writes."""

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, PositiveInt, TypeAdapter

from roadperc_stream.config.calibration import Number
from roadperc_stream.errors import DumpError
from roadperc_stream.input.projections import require_pinhole

from .calibration_file import CalibrationFile
from .json_files import Document, Listed, checked, read_yaml

SUFFIXES = (".yaml", ".yml")


class _Matrix(Document):
    rows: PositiveInt
    cols: PositiveInt
    data: Listed[Number]


class _CameraInfo(Document):
    image_width: PositiveInt
    image_height: PositiveInt
    camera_matrix: _Matrix
    distortion_model: Annotated[str, Field(max_length=100)] = "plumb_bob"
    distortion_coefficients: _Matrix | None = None
    rectification_matrix: _Matrix | None = None
    projection_matrix: _Matrix | None = None


def load_camera_info(path: Path) -> CalibrationFile:
    """Read a ``camera_info`` YAML; its pixel centres are at integers, as in OpenCV.

    Raises:
        DumpError: the file cannot be read, or is not such a YAML; the message names file, key and error.
    """
    info = checked(path, TypeAdapter(_CameraInfo), read_yaml(path))
    K = _rows(f"{path}: camera_matrix", info.camera_matrix, 3)
    require_pinhole(f"{path}: camera_matrix", np.array(K))
    return CalibrationFile(
        width=info.image_width,
        height=info.image_height,
        K=K,
        D=() if info.distortion_coefficients is None else tuple(info.distortion_coefficients.data),
        distortion_model=info.distortion_model,
        R=_rows(f"{path}: rectification_matrix", info.rectification_matrix, 3),
        P=_rows(f"{path}: projection_matrix", info.projection_matrix, 4),
        pixel_origin="centre",
    )


def _rows(where: str, matrix: _Matrix | None, columns: int) -> tuple[tuple[float, ...], ...] | None:
    """Return the numbers of three rows."""
    if matrix is None:
        return None
    if (matrix.rows, matrix.cols, len(matrix.data)) != (3, columns, 3 * columns):
        found = f"{matrix.rows}x{matrix.cols} with {len(matrix.data)} numbers"
        raise DumpError(f"{where}: expected 3x{columns}, found {found}")
    return tuple(tuple(matrix.data[row * columns : (row + 1) * columns]) for row in range(3))
