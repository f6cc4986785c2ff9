"""KITTI's object benchmark: ``image_2``, ``label_2``, ``calib`` and ``velodyne`` below ``training`` or ``testing``.

The frames are unrelated. Each has its own calibration and size, and its number times 2 s as its stamp.
"""

from pathlib import Path
from typing import Final

from ..carla_dump.calibration_file import CALIBRATION_NAME
from ..carla_dump.camera_rig import LIDAR
from ..carla_dump.frame_stamps import stamps_of_rate
from ..carla_dump.json_files import read_lines
from ..carla_dump.survey import SensorSurvey, surveyed
from ..carla_dump.truth_file import TruthTables
from .drive import ConvertOptions, Drive, choose_sequence
from .kitti_benchmark import (
    Calibration,
    Label,
    objects_of,
    read_calibration,
    read_label,
    sensors_of,
    splits_of,
)
from .kitti_calibration import PIXEL_ORIGIN, height_of

_IMAGES: Final = "image_2"
_FOLDERS: Final = {"image": _IMAGES, "right": "image_3", LIDAR: "velodyne"}
_LABELS: Final = "label_2"
_RATE_HZ: Final = 0.5


def detect(folder: Path) -> bool:
    """Return True if the folder, or ``training`` or ``testing`` in it, has ``image_2`` and ``calib``."""
    return bool(splits_of(folder, _IMAGES)) and not (folder / CALIBRATION_NAME).exists()


def read(folder: Path, options: ConvertOptions) -> Drive:
    """Read one split.

    Raises:
        DumpError: the folder holds no or several splits, or a file is wrong; the message names file and line.
    """
    options.require_only(folder, "--sequence", "--height")
    name, split = choose_sequence(folder, splits_of(folder, _IMAGES), options.sequence)
    notes: list[str] = ["the frames are unrelated, 2 s apart, each with its own calibration"]
    surveys = surveyed(sensors_of(split, _FOLDERS))
    height_m = height_of(options, notes)
    numbers = sorted(surveys["image"].sensor.files)
    calibrations = {number: _calibration(split, number, surveys, height_m) for number in numbers}
    labels = _labels(split / _LABELS, numbers, notes)
    return Drive(
        folder=folder,
        title=f"KITTI object, {name}",
        surveys=surveys,
        stamps_ns={n: ns for n, ns in stamps_of_rate([0, *numbers], _RATE_HZ).items() if n in calibrations},
        timing="2 s by frame number",
        rig=calibrations[numbers[0]].rig,
        frame_rigs={number: found.rig for number, found in calibrations.items()},
        detections={number: tuple(label.detection for label in of_frame) for number, of_frame in labels.items()},
        detections_source=f"{_LABELS}, 2D boxes of the labels",
        truth=TruthTables({}, {}, {n: objects_of(of_frame, calibrations[n]) for n, of_frame in labels.items()}),
        pixel_origin=PIXEL_ORIGIN,
        notes=tuple(notes),
    )


def _calibration(split: Path, number: int, surveys: dict[str, SensorSurvey], height_m: float) -> Calibration:
    sizes = {role: found.sizes.get(number, found.size) for role, found in surveys.items() if found.size}
    return read_calibration(split / "calib" / f"{number:06d}.txt", sizes, surveys, height_m)


def _labels(folder: Path, numbers: list[int], notes: list[str]) -> dict[int, list[Label]]:
    """Return the labels of each image; adds a note if some have none.

    Raises:
        DumpError: a line is wrong.
    """
    paths = {number: path for number in numbers if (path := folder / f"{number:06d}.txt").is_file()}
    if len(paths) < len(numbers):
        notes.append(f"{folder.name}: {len(numbers) - len(paths)} of {len(numbers)} images have no labels")
    lines = {number: [line.split() for line in read_lines(path)] for number, path in paths.items()}
    return {
        number: [
            label
            for at, fields in enumerate(of_frame, 1)
            if fields and (label := read_label(f"{paths[number]}: line {at}", fields, f"{number:06d}/{at}"))
        ]
        for number, of_frame in lines.items()
    }
