"""KITTI's tracking benchmark: ``image_02/NNNN``, ``label_02``, ``calib``, ``velodyne`` and ``oxts``.

They are below ``training`` or ``testing``. The stamp of a frame is its number over 10 Hz. A label begins with the
frame's number and the object's id.
"""

from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float

from ..carla_dump.calibration_file import CALIBRATION_NAME
from ..carla_dump.camera_rig import LIDAR
from ..carla_dump.frame_stamps import stamps_of_rate
from ..carla_dump.json_files import read_lines
from ..carla_dump.survey import surveyed
from ..carla_dump.truth_file import NO_TRUTH, TruthTables
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
from .kitti_oxts import packet, poses_of

_IMAGES: Final = "image_02"
_FOLDERS: Final = {"image": _IMAGES, "right": "image_03", LIDAR: "velodyne"}
_LABELS: Final = "label_02"
_RATE_HZ: Final = 10.0
_COLUMNS: Final = (17, 18)
"""Without and with a score."""


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
    surveys = surveyed(sensors_of(split, {role: f"{top}/{sequence}" for role, top in _FOLDERS.items()}))
    sizes = {role: found.size for role, found in surveys.items() if found.size}
    path = split / "calib" / f"{sequence}.txt"
    calibration = read_calibration(path, sizes, surveys, height_of(options, notes))
    numbers = sorted(surveys["image"].sensor.files)
    labels = _labels(split / _LABELS / f"{sequence}.txt", numbers, notes)
    truth = {number: objects_of(of_frame, calibration) for number, of_frame in labels.items()}
    return Drive(
        folder=folder,
        title=f"KITTI tracking, sequence {name}",
        surveys=surveys,
        stamps_ns={n: ns for n, ns in stamps_of_rate([0, *numbers], _RATE_HZ).items() if n in set(numbers)},
        timing=f"{_RATE_HZ:g} Hz by frame number (KITTI)",
        rig=calibration.rig,
        detections={number: tuple(label.detection for label in of_frame) for number, of_frame in labels.items()},
        detections_source=f"{_LABELS}, 2D boxes of the labels",
        poses=_poses(split / "oxts" / f"{sequence}.txt", numbers, calibration, notes),
        truth=TruthTables({}, {}, truth) if truth else NO_TRUTH,
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
        if path.name.isdigit() and path.is_dir()
    }


def _labels(path: Path, numbers: list[int], notes: list[str]) -> dict[int, list[Label]]:
    """Return the labels of each image, all of which have been labelled; empty without the file.

    Raises:
        DumpError: a line is wrong.
    """
    if not path.is_file():
        notes.append(f"no labels: {path} does not exist")
        return {}
    labels: dict[int, list[Label]] = {number: [] for number in numbers}
    for at, line in enumerate(read_lines(path), 1):
        where, fields = f"{path}: line {at}", line.split()
        if not fields:
            continue
        if len(fields) not in _COLUMNS or not fields[0].isdecimal():
            raise DumpError(
                f"{where}: expected {_COLUMNS[0]} columns, the frame first; found {len(fields)}: {line[:60]!r}"
            )
        label = read_label(where, fields[2:], fields[1])
        if label and int(fields[0]) in labels:
            labels[int(fields[0])].append(label)
    return labels


def _poses(path: Path, numbers: list[int], calibration: Calibration, notes: list[str]) -> dict[int, Float]:
    """Return odom_T_ego of each image from the lines of ``oxts``; adds a note if there are none."""
    if not path.is_file() or calibration.camera0_T_imu is None:
        notes.append(f"no true poses: no {path if not path.is_file() else 'Tr_imu_velo in calib'}")
        return {}
    lines = dict(enumerate(read_lines(path)))
    packets = {n: packet(f"{path}: line {n + 1}", lines[n]) for n in numbers if n in lines}
    return poses_of(packets, calibration.ego_T_camera0 @ calibration.camera0_T_imu)
