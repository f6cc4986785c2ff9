"""Read a camera's calibration from ROS: the YAML of ``camera_info`` that camera_calibration writes."""

from pathlib import Path
from typing import Annotated

import numpy as np
import yaml
from pydantic import ConfigDict, Field, FiniteFloat, PositiveInt, TypeAdapter

from roadperc_stream.errors import DumpError

from .calibration_file import CalibrationFile, require_pinhole
from .json_files import Document, checked

SUFFIXES = (".yaml", ".yml")


class _Matrix(Document):
    """A matrix as OpenCV and ROS write it: ``{rows: 3, cols: 3, data: [...]}``."""

    rows: PositiveInt
    cols: PositiveInt
    data: list[FiniteFloat]

    def rows_of(self, path: Path, name: str, rows: int, columns: int) -> tuple[tuple[float, ...], ...]:
        """Return the numbers row by row.

        Raises:
            DumpError: the matrix has another size.
        """
        if (self.rows, self.cols, len(self.data)) != (rows, columns, rows * columns):
            found = f"{self.rows}x{self.cols} with {len(self.data)} numbers"
            raise DumpError(f"{path}: {name}: expected {rows}x{columns}, found {found}")
        return tuple(tuple(self.data[k * columns : (k + 1) * columns]) for k in range(rows))


class _CameraInfo(Document):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

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
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DumpError(f"{path}: {error.strerror or error}") from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise DumpError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    info = checked(path, TypeAdapter(_CameraInfo), document)
    matrices = {"K": ("camera_matrix", 3, 3), "R": ("rectification_matrix", 3, 3), "P": ("projection_matrix", 3, 4)}
    found = {
        key: matrix.rows_of(path, name, rows, columns)
        for key, (name, rows, columns) in matrices.items()
        if (matrix := getattr(info, name)) is not None
    }
    require_pinhole(f"{path}: camera_matrix", np.array(found["K"]))
    D = info.distortion_coefficients
    return CalibrationFile(
        width=info.image_width,
        height=info.image_height,
        distortion_model=info.distortion_model,
        D=tuple(D.data) if D else (),
        pixel_origin="centre",
        **found,
    )
