"""The layout of a CARLA dump: one folder per sensor with one file per frame, and documents such as poses.json."""

import re
from collections.abc import Mapping
from math import gcd
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.model import Detection

from ..carla_dump.calibration_file import CALIBRATION_NAME, CalibrationFile, load_calibration
from ..carla_dump.camera_info import SUFFIXES, load_camera_info
from ..carla_dump.detection_files import load_detections, load_kitti_labels
from ..carla_dump.frame_stamps import DEFAULT_RATE_HZ, mean_rate, stamps_of_file, stamps_of_names, stamps_of_rate
from ..carla_dump.layout import DumpLayout, find_layout
from ..carla_dump.survey import SensorSurvey, front_sensors, points_fault, reference_of, surveyed
from ..carla_dump.truth_file import NO_TRUTH, load_poses, load_truth
from ..carla_dump.yolo_files import is_yolo, load_yolo_labels
from ..rig import CAMERA_ROLES, build_rig
from .drive import ConvertOptions, Drive

_KITTI_IMAGES: Final = re.compile(r"image_0?[0-3]")
"""KITTI's folders: image_2 of objects, image_0 of odometry, image_02/data of raw data."""


def detect(_: Path) -> bool:
    """Return True: a folder that fits no other layout is a dump."""
    return True


def read(folder: Path, options: ConvertOptions) -> Drive:
    """Read a dump.

    Raises:
        DumpError: the dump cannot be converted.
    """
    options.refuse(folder, ["--sequence"], "chooses among the sequences of a dataset, and this is none")
    layout = find_layout(folder, options.roles)
    notes = list(layout.notes)
    document = layout.documents.get("calibration", folder / CALIBRATION_NAME)
    said, calibration_path = calibration_of(document, options)
    calibration = _with_pixel_origin(layout, said)
    surveys = _surveys(layout, options, notes)
    sizes = {role: found.size for role, found in surveys.items() if found.size}
    left_is_front = "image" in surveys and "image" not in layout.sensors
    front_name = "left" if left_is_front else "image"
    rig = build_rig(calibration, calibration_path, list(surveys), sizes, front_name=front_name)
    notes += rig.notes
    stamps_ns, timing, is_by_name = _stamps(layout, options, calibration.rate_hz, notes)
    camera = rig.cameras["calibration"]
    detections, detections_source = _detections(layout, (camera.width, camera.height), notes)
    truth = layout.documents.get("truth")
    return Drive(
        folder=folder,
        title="",
        surveys=surveys,
        stamps_ns=stamps_ns,
        timing=timing,
        rig=rig,
        stamps_of_sensors=is_by_name,
        detections=detections,
        detections_source=detections_source,
        poses=load_poses(layout.documents["poses"]) if "poses" in layout.documents else {},
        truth=load_truth(truth, rig.frame_ids["truth_depth"]) if truth else NO_TRUTH,
        tag_table=calibration.carla_tags,
        pixel_origin=_origin_in_words(layout, calibration_path, said, calibration),
        notes=tuple(notes),
    )


def calibration_of(beside: Path, options: ConvertOptions) -> tuple[CalibrationFile, Path]:
    """Return the calibration and its path, with the options of the command line.

    Args:
        beside: the ``calibration.json`` of the input, which may not exist.
        options: a field of view replaces K and the lens; a height mounts a level camera.

    Raises:
        DumpError: a file is wrong, or both the file and the options give the mounting.
    """
    path = options.calibration or beside
    calibration = calibration_in(path) if options.calibration or path.is_file() else CalibrationFile()
    return calibration.with_options(path, options.fov_deg, options.height_m), path


def calibration_in(path: Path) -> CalibrationFile:
    """Return the calibration of a file: ``camera_info`` YAML of ROS, or JSON.

    Raises:
        DumpError: the file is wrong.
    """
    return load_camera_info(path) if path.suffix.lower() in SUFFIXES else load_calibration(path)


def _with_pixel_origin(layout: DumpLayout, calibration: CalibrationFile) -> CalibrationFile:
    """Return the calibration with its format's pixel origin: the first pixel's centre in KITTI, its corner in CARLA."""
    if "pixel_origin" in calibration.model_fields_set or not _is_kitti(layout):
        return calibration
    return calibration.model_copy(update={"pixel_origin": "centre"})


def _is_kitti(layout: DumpLayout) -> bool:
    first = [layout.sensors[role].first for role in ("image", "left") if role in layout.sensors]
    return any(_KITTI_IMAGES.fullmatch(folder.name) for path in first for folder in path.parents[:2])


def _origin_in_words(layout: DumpLayout, path: Path, said: CalibrationFile, used: CalibrationFile) -> str:
    matrices = [said.P_left, said.K, *(camera.K for camera in said.cameras.values())]
    if all(matrix is None for matrix in matrices):
        return ""
    stated = "pixel_origin" in said.model_fields_set
    source = f"{path.name} says" if stated else f"{'KITTI' if _is_kitti(layout) else 'CARLA'} has it"
    return f"the first pixel's {used.pixel_origin}, as {source}"  # part of the log: its bytes must not change


def _surveys(layout: DumpLayout, options: ConvertOptions, notes: list[str]) -> dict[str, SensorSurvey]:
    """Return the surveys of all sensors except detections, in the order of ``ROLES``.

    An unreadable lidar folder is left out with a note, unless the user chose it with ``--role``.
    """
    sensors, note = front_sensors({role: s for role, s in layout.sensors.items() if role != "detections"})
    notes += [note] if note else []
    guessed = sensors.get(LIDAR) if LIDAR not in options.roles else None
    if guessed and (fault := points_fault(guessed, set(_frames(layout)))):
        notes.append(f"{guessed.source} is left out: {fault}")
        del sensors[LIDAR]
    return surveyed(sensors)


def _frames(layout: DumpLayout) -> list[int]:
    """Return the frame numbers of all cameras, sorted."""
    return sorted({number for role, s in layout.sensors.items() if role in CAMERA_ROLES for number in s.files})


def _stamps(
    layout: DumpLayout, options: ConvertOptions, calibrated_hz: float | None, notes: list[str]
) -> tuple[dict[int, int], str, bool]:
    """Return the stamp of each frame number, their source, and True if the files' names are stamps."""
    frames = _frames(layout)
    path = layout.documents.get("timestamps") or _stamps_beside(layout)
    if path is not None:
        stamps = stamps_of_file(path, frames)
        return stamps, f"stamps of {path.name}{mean_rate(list(stamps.values()))}", False
    if (stamps_in_names := stamps_of_names(frames)) is not None:
        if options.rate_hz:
            raise DumpError(f"--rate {options.rate_hz:g}: the names of the files are stamps; remove --rate")
        if calibrated_hz is not None:
            notes.append(f"rate_hz {calibrated_hz:g} of the calibration is not used: the names of the files are stamps")
        images_ns = [stamps_in_names[number] for number in sorted(layout.sensors[reference_of(layout.sensors)].files)]
        return stamps_in_names, f"stamps in the names of the files{mean_rate(images_ns)}", True
    rate_hz = options.rate_hz or calibrated_hz
    rate = rate_hz or DEFAULT_RATE_HZ
    stride = gcd(*(later - frames[0] for later in frames))
    if stride > 1:
        notes.append(f"frame numbers have steps of {stride}: frames are {stride / rate:g} s apart at {rate:g} Hz")
    source = "" if rate_hz else " (assumed: --rate)"
    return stamps_of_rate(frames, rate), f"{rate:g} Hz by frame number{source}", False


def _stamps_beside(layout: DumpLayout) -> Path | None:
    """Return the stamps beside a camera's ``data`` folder, as in KITTI raw and EuRoC."""
    image = layout.sensors.get("image")
    if image is None or image.first.parent.name != "data":
        return None
    paths = (image.first.parent.parent / name for name in ("timestamps.txt", "data.csv"))
    return next((path for path in paths if path.is_file()), None)


def _detections(
    layout: DumpLayout, size: tuple[int, int], notes: list[str]
) -> tuple[Mapping[int, tuple[Detection, ...]], str]:
    """Return the detections by frame number, and their source; ``size`` is columns and rows of the images."""
    if "detections" in layout.sensors:
        sensor = layout.sensors["detections"]
        if is_yolo(sensor.files.values()):
            detections, names = load_yolo_labels(sensor.files, _frames(layout), size)
            return detections, f"{sensor.source}, YOLO labels, {names}"
        return load_kitti_labels(sensor.files), f"{sensor.source}, KITTI labels"
    path = layout.documents.get("detections")
    if path is None:
        return {}, ""
    detections, kind, found = load_detections(path)
    notes += found
    return detections, f"{path.name}, {kind}"
