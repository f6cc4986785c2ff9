"""KITTI's object benchmark: ``image_2``, ``label_2``, ``calib`` and ``velodyne`` below ``training`` or ``testing``.

The frames are unrelated. Each has its own calibration and size, and its number times 2 s as its stamp.
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.model import Objects

from ..carla_dump.calibration_file import CALIBRATION_NAME
from ..carla_dump.frame_stamps import stamps_of_rate
from ..carla_dump.truth_file import NO_TRUTH
from .drive import ConvertOptions, Drive, choose_sequence
from .kitti_benchmark import read_calibration, read_labels, splits_of, surveys_of
from .kitti_calibration import PIXEL_ORIGIN, height_of

_IMAGES: Final = "image_2"
_LABELS: Final = "label_2"
_FOLDERS: Final = {"image": _IMAGES, "right": "image_3", LIDAR: "velodyne"}
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
    notes = ["the frames are unrelated, 2 s apart, each with its own calibration"]
    surveys = surveys_of(split, _FOLDERS)
    height_m = height_of(options, notes)
    numbers = sorted(surveys["image"].sensor.files)
    calibrations = {n: read_calibration(split / f"calib/{n:06d}.txt", surveys, height_m, n) for n in numbers}
    paths = {number: path for number in numbers if (path := split / _LABELS / f"{number:06d}.txt").is_file()}
    if len(paths) < len(numbers):
        notes.append(f"{_LABELS}: {len(numbers) - len(paths)} of {len(numbers)} images have no labels")
    objects = {n: tuple(found for _, found in read_labels(path, calibrations[n])) for n, path in paths.items()}
    return Drive(
        folder=folder,
        title=f"KITTI object, {name}",
        surveys=surveys,
        stamps_ns={n: ns for n, ns in stamps_of_rate([0, *numbers], _RATE_HZ).items() if n in calibrations},
        timing="2 s by frame number",
        rig=calibrations[numbers[0]].rig,
        frame_rigs={number: found.rig for number, found in calibrations.items()},
        detections={number: tuple(item.detection for item in found) for number, found in objects.items()},
        detections_source=f"{_LABELS}, 2D boxes of the labels",
        truth=replace(NO_TRUTH, objects={number: Objects(found) for number, found in objects.items()}),
        pixel_origin=PIXEL_ORIGIN,
        notes=tuple(notes),
    )
