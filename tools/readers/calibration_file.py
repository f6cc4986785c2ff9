"""Read the calibration of a dump: ``calibration.json``, or the ``camera_info`` YAML of ROS' camera_calibration.

Raises everywhere:
    DumpError: the file is wrong; the message names file, key and error.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import ConfigDict, Field, PositiveInt, TypeAdapter

from roadperc_stream.config.calibration import CalibrationConfig, Intrinsics, Number, PositiveNumber
from roadperc_stream.errors import DumpError
from roadperc_stream.input.projections import require_pinhole
from roadperc_stream.system.text import nearest

from .documents import Document, Listed, checked, read_json, read_yaml

CALIBRATION_NAME: Final = "calibration.json"
_YAML_SUFFIXES: Final = (".yaml", ".yml")
_MISSPELLED: Final = 0.78
"""An unknown key is an error if it is more similar to a known one: ``widht`` has 0.8, ``fov_y`` 0.75 (a note)."""


class CameraOfFile(Intrinsics):
    """A camera of ``calibration.json``; unknown keys are notes."""

    model_config = ConfigDict(extra="ignore")


class CalibrationFile(CalibrationConfig):
    """All known keys of ``calibration.json``; other keys are notes."""

    model_config = ConfigDict(extra="ignore")

    cameras: Mapping[str, CameraOfFile] = {}
    carla_tags: str | None = None
    rate_hz: PositiveNumber | None = None


def calibration_of(
    beside: Path, file: Path | None, fov_deg: float | None, height_m: float | None
) -> tuple[CalibrationFile, Path]:
    """Return the calibration of a recording and its path, with the options of the command line.

    Args:
        beside: the ``calibration.json`` of the recording, which may not exist.
        file: replaces it.
        fov_deg: replaces K and the lens.
        height_m: mounts a level camera; it is an error if the file has the mounting too.
    """
    path = file or beside
    calibration = load_calibration(path) if file or path.is_file() else CalibrationFile()
    return calibration.with_options(path, fov_deg, height_m), path


def load_calibration(path: Path) -> CalibrationFile:
    """Read a calibration: YAML of ROS by its suffix, else JSON."""
    if path.suffix.lower() in _YAML_SUFFIXES:
        return _of_camera_info(path)
    document = read_json(path)
    _refuse_misspelled(path, document)
    calibration = checked(path, TypeAdapter(CalibrationFile), document)
    for name, camera in {"": calibration, **calibration.cameras}.items():
        if camera.K is not None:
            require_pinhole(f"{path}: {f'cameras.{name}.' if name else ''}K", np.array(camera.K))
    if (calibration.P_left is None) != (calibration.P_right is None):
        raise DumpError(f"{path}: P_left and P_right: expected both or neither")
    return calibration


def _refuse_misspelled(path: Path, document: Any) -> None:
    """Check that no unknown key is similar to a known key; other unknown keys are notes."""
    cameras = _items(dict(_items(document)).get("cameras"))
    parts: list[tuple[str, Any, type[Intrinsics]]] = [("", document, CalibrationFile)]
    parts += [(f"cameras.{name}.", camera, CameraOfFile) for name, camera in cameras]
    for place, keys, model in parts:
        known = (*model.model_fields, "fov")
        for key in (key for key, _ in _items(keys) if key not in known):
            if meant := nearest(key, known, _MISSPELLED):
                raise DumpError(f"{path}: unknown key {place}{key}; did you mean {meant}?")


def _items(found: Any) -> list[tuple[str, Any]]:
    return list(found.items()) if isinstance(found, dict) else []


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


def _of_camera_info(path: Path) -> CalibrationFile:
    """Read a ``camera_info`` YAML; its pixel centres are at integers, as in OpenCV."""
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
