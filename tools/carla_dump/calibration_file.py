"""Read ``calibration.json``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from roadperc_stream.config.calibration import CalibrationConfig, Intrinsics, PositiveNumber
from roadperc_stream.errors import DumpError
from roadperc_stream.input.projections import require_pinhole
from roadperc_stream.system.text import nearest

from .json_files import checked, read_json

CALIBRATION_NAME: Final = "calibration.json"


class CameraOfFile(Intrinsics):
    """A camera of ``calibration.json``; unknown keys are notes."""

    model_config = ConfigDict(extra="ignore")


class CalibrationFile(CalibrationConfig):
    """All known keys of ``calibration.json``; other keys are notes."""

    model_config = ConfigDict(extra="ignore")

    cameras: Mapping[str, CameraOfFile] = {}
    carla_tags: str | None = None
    rate_hz: PositiveNumber | None = None


_CAMERA_KEYS = (*Intrinsics.model_fields, "fov")
_KEYS = (*CalibrationFile.model_fields, "fov")
_MISSPELLED = 0.78
"""An unknown key is an error if it is more similar to a known one: ``widht`` has 0.8, ``fov_y`` 0.75 (a note)."""


def load_calibration(path: Path) -> CalibrationFile:
    """Read ``calibration.json``.

    Raises:
        DumpError: the file is wrong; the message names file, key and error.
    """
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
    """Check that no unknown key is similar to a known key; other unknown keys are notes.

    Raises:
        DumpError: a key is misspelled.
    """
    if not isinstance(document, dict):
        return
    cameras = document.get("cameras")
    parts = {"": (document, _KEYS), **{f"cameras.{n}.": (c, _CAMERA_KEYS) for n, c in _items(cameras)}}
    for place, (keys, known) in parts.items():
        for key in (key for key, _ in _items(keys) if key not in known):
            if meant := nearest(key, known, _MISSPELLED):
                raise DumpError(f"{path}: unknown key {place}{key}; did you mean {meant}?")


def _items(found: Any) -> list[tuple[str, Any]]:
    return list(found.items()) if isinstance(found, dict) else []
