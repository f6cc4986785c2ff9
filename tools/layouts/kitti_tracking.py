"""KITTI's tracking benchmark: ``image_02/NNNN``, ``label_02``, ``calib``, ``velodyne`` and ``oxts``.

They are below ``training`` or ``testing``. The stamp of a frame is its number over 10 Hz.
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

from roadperc_stream.geometry import Float
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.model import Object, Objects

from ..carla_dump.calibration_file import CALIBRATION_NAME
from ..carla_dump.frame_stamps import stamps_of_rate
from ..carla_dump.json_files import read_lines
from ..carla_dump.truth_file import NO_TRUTH
from .drive import ConvertOptions, Drive, choose_sequence
from .kitti_benchmark import Calibration, read_calibration, read_labels, splits_of, surveys_of
from .kitti_calibration import PIXEL_ORIGIN, height_of
from .kitti_oxts import packet, poses_of

_IMAGES: Final = "image_02"
_LABELS: Final = "label_02"
_FOLDERS: Final = {"image": _IMAGES, "right": "image_03", LIDAR: "velodyne"}
_RATE_HZ: Final = 10.0


def detect(folder: Path) -> bool:
    """Return True if the folder, or ``training`` or ``testing`` in it, has sequences in ``image_02``, and ``calib``."""
    return bool(_sequences(folder)) and not (folder / CALIBRATION_NAME).exists()


def read(folder: Path, options: ConvertOptions) -> Drive:
    """Read one sequence.

    Raises:
        DumpError: the folder holds no or several sequences, or a file is wrong; the message names file and line.
    """
    options.require_only(folder, "--sequence", "--height")
    name, images = choose_sequence(folder, _sequences(folder), options.sequence)
    split, sequence = images.parent.parent, images.name
    notes: list[str] = []
    surveys = surveys_of(split, {role: f"{top}/{sequence}" for role, top in _FOLDERS.items()})
    calibration = read_calibration(split / "calib" / f"{sequence}.txt", surveys, height_of(options, notes))
    numbers = sorted(surveys["image"].sensor.files)
    objects = _objects(split / _LABELS / f"{sequence}.txt", numbers, calibration, notes)
    return Drive(
        folder=folder,
        title=f"KITTI tracking, sequence {name}",
        surveys=surveys,
        stamps_ns={n: ns for n, ns in stamps_of_rate([0, *numbers], _RATE_HZ).items() if n in set(numbers)},
        timing=f"{_RATE_HZ:g} Hz by frame number (KITTI)",
        rig=calibration.rig,
        detections={number: tuple(item.detection for item in found) for number, found in objects.items()},
        detections_source=f"{_LABELS}, 2D boxes of the labels",
        poses=_poses(split / "oxts" / f"{sequence}.txt", numbers, calibration, notes),
        truth=replace(NO_TRUTH, objects={number: Objects(tuple(found)) for number, found in objects.items()}),
        pixel_origin=PIXEL_ORIGIN,
        notes=tuple(notes),
    )


def _sequences(folder: Path) -> dict[str, Path]:
    """Return the folders of images by sequence, or by split and sequence if there are two splits."""
    splits = splits_of(folder, _IMAGES)
    return {
        f"{name}/{path.name}" if len(splits) > 1 else path.name: path
        for name, split in splits.items()
        for path in sorted((split / _IMAGES).iterdir())
        if path.name.isdecimal() and path.is_dir()
    }


def _objects(path: Path, numbers: list[int], calibration: Calibration, notes: list[str]) -> dict[int, list[Object]]:
    """Return the labelled objects of each image; empty without the file."""
    if not path.is_file():
        notes.append(f"no labels: {path} does not exist")
        return {}
    objects: dict[int, list[Object]] = {number: [] for number in numbers}
    for number, found in read_labels(path, calibration, before=2):
        objects.get(number, []).append(found)
    return objects


def _poses(path: Path, numbers: list[int], calibration: Calibration, notes: list[str]) -> dict[int, Float]:
    """Return odom_T_ego of each image with a line in ``oxts``; adds a note if there are none."""
    if not path.is_file() or calibration.ego_T_imu is None:
        notes.append(f"no true poses: no {path if not path.is_file() else 'Tr_imu_velo in calib'}")
        return {}
    lines = read_lines(path)
    packets = {n: packet(f"{path}: line {n + 1}", lines[n]) for n in numbers if n < len(lines)}
    return poses_of(packets, calibration.ego_T_imu)
