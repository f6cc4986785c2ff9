"""The layout of a CARLA dump: one folder per sensor with one file per frame, and documents such as poses.json."""

import re
from collections.abc import Mapping
from dataclasses import replace
from math import gcd
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.schemas.roles import REFERENCE_ROLES

from ..readers.calibration_file import CalibrationFile
from ..readers.detection_files import Detections, load_detections, load_labels
from ..readers.frame_stamps import DEFAULT_RATE_HZ, mean_rate, stamps_of_file, stamps_of_names, stamps_of_rate
from ..readers.image_files import read_bytes
from ..readers.sensor_folders import Sensor, points_fault, with_headers
from ..readers.truth_file import TruthTables, load_poses, load_truth
from ..rig import CAMERA_ROLES, build_rig
from .dataset import DatasetSequence, Layout, Request
from .dump_folder import DumpFolder, find_dump

_KITTI_IMAGES: Final = re.compile(r"image_0?[0-3]")
"""KITTI's folders: image_2 of objects, image_0 of odometry, image_02/data of raw data."""


def _read(request: Request) -> DatasetSequence:
    options, notes = request.options, request.notes
    dump = find_dump(request.folder, options.roles)
    notes += dump.notes
    document = dump.documents.get("calibration")
    said, calibration_path = options.calibration_of(document.parent if document else request.folder)
    calibration = _with_pixel_origin(dump, said)
    sensors = _sensors(request, dump)
    sizes = {role: sensor.size for role, sensor in sensors.items() if sensor.size}
    left_is_front = "image" in sensors and "image" not in dump.sensors
    front_name = "left" if left_is_front else "image"
    rig = build_rig(calibration, calibration_path, list(sensors), sizes, front_name=front_name)
    notes += rig.notes
    stamps_ns, timing, is_by_name = _stamps(request, dump, calibration.rate_hz)
    camera = rig.cameras["calibration"]
    detections, detections_source = _detections(request, dump, (camera.width, camera.height))
    truth, poses = dump.documents.get("truth"), dump.documents.get("poses")
    return DatasetSequence(
        title="",
        sensors=sensors,
        stamps_ns=stamps_ns,
        timing=timing,
        rig=rig,
        stamps_of_sensors=is_by_name,
        detections=detections,
        detections_source=detections_source,
        poses=load_poses(poses) if poses else {},
        truth=load_truth(truth, rig.frame_ids["truth_depth"]) if truth else TruthTables(),
        tag_table=calibration.carla_tags,
        pixel_origin=_origin_in_words(dump, calibration_path, said, calibration),
    )


LAYOUT: Final = Layout(
    _read,
    ("--role", "--tags", "--fov", "--rate", "--allow-lossy-tags", "--depth-coding", "--calibration", "--height"),
    detect=lambda _: True,
    refusal="chooses a sequence of a dataset, and this is a dump",
)


def _with_pixel_origin(dump: DumpFolder, calibration: CalibrationFile) -> CalibrationFile:
    """Return the calibration with its format's pixel origin: the first pixel's centre in KITTI, its corner in CARLA."""
    if "pixel_origin" in calibration.model_fields_set or not _is_kitti(dump):
        return calibration
    return calibration.model_copy(update={"pixel_origin": "centre"})


def _is_kitti(dump: DumpFolder) -> bool:
    first = [dump.sensors[role].first for role in ("image", "left") if role in dump.sensors]
    return any(_KITTI_IMAGES.fullmatch(folder.name) for path in first for folder in path.parents[:2])


def _origin_in_words(dump: DumpFolder, path: Path, said: CalibrationFile, used: CalibrationFile) -> str:
    matrices = [said.P_left, said.K, *(camera.K for camera in said.cameras.values())]
    if all(matrix is None for matrix in matrices):
        return ""
    stated = "pixel_origin" in said.model_fields_set
    source = f"{path.name} says" if stated else f"{'KITTI' if _is_kitti(dump) else 'CARLA'} has it"
    return f"the first pixel's {used.pixel_origin}, as {source}"  # part of the log: its bytes must not change


def _sensors(request: Request, dump: DumpFolder) -> dict[str, Sensor]:
    """Return all sensors except detections.

    An unreadable lidar folder is left out with a note, unless the user chose it with ``--role``.
    """
    sensors = {role: sensor for role, sensor in dump.sensors.items() if role != "detections"}
    if not any(role in sensors for role in CAMERA_ROLES):
        found = ", ".join(sensor.source for sensor in sensors.values())
        raise DumpError(f"no camera found, only {found}; add one or pass --role")
    left = sensors.get("left")
    if left is not None and "image" not in sensors:
        sensors = {"image": replace(left, role="image"), **sensors}
        request.notes.append(f"{left.source}: the left camera is the front camera")
        del sensors["left"]
    elif left is not None and _same_files(sensors["image"].files, left.files):
        request.notes.append(f"{left.source} holds the same images as {sensors['image'].source}: not stored twice")
        del sensors["left"]
    lidar = sensors.get(LIDAR) if LIDAR not in request.options.roles else None
    if lidar and (fault := points_fault(lidar, set(_frames(dump)))):
        request.notes.append(f"{lidar.source} is left out: {fault}")
        del sensors[LIDAR]
    return with_headers(sensors)


def _same_files(a: Mapping[int, Path], b: Mapping[int, Path]) -> bool:
    """Return True if all files have the same sizes, and the first files have the same bytes."""
    if a.keys() != b.keys() or any(a[number].stat().st_size != b[number].stat().st_size for number in a):
        return False
    return read_bytes(a[min(a)]) == read_bytes(b[min(b)])


def _frames(dump: DumpFolder) -> list[int]:
    """Return the frame numbers of all cameras, sorted."""
    return sorted({number for role, s in dump.sensors.items() if role in CAMERA_ROLES for number in s.files})


def _stamps(request: Request, dump: DumpFolder, calibrated_hz: float | None) -> tuple[dict[int, int], str, bool]:
    """Return the stamp of each frame number, their source, and True if the files' names are stamps."""
    frames, asked_hz = _frames(dump), request.options.rate_hz
    path = dump.documents.get("timestamps") or _stamps_beside(dump)
    if path is not None:
        stamps = stamps_of_file(path, frames)
        return stamps, f"stamps of {path.name}{mean_rate(list(stamps.values()))}", False
    if (stamps_in_names := stamps_of_names(frames)) is not None:
        if asked_hz:
            raise DumpError(f"--rate {asked_hz:g}: the names of the files are stamps; remove --rate")
        if calibrated_hz is not None:
            unused = f"rate_hz {calibrated_hz:g} of the calibration is not used"
            request.notes.append(f"{unused}: the names of the files are stamps")
        reference = next(role for role in REFERENCE_ROLES if role in dump.sensors)
        images_ns = [stamps_in_names[number] for number in sorted(dump.sensors[reference].files)]
        return stamps_in_names, f"stamps in the names of the files{mean_rate(images_ns)}", True
    rate_hz = asked_hz or calibrated_hz or DEFAULT_RATE_HZ
    stride = gcd(*(later - frames[0] for later in frames))
    if stride > 1:
        apart = f"frames are {stride / rate_hz:g} s apart at {rate_hz:g} Hz"
        request.notes.append(f"frame numbers have steps of {stride}: {apart}")
    source = "" if asked_hz or calibrated_hz else " (assumed: --rate)"
    return stamps_of_rate(frames, rate_hz), f"{rate_hz:g} Hz by frame number{source}", False


def _stamps_beside(dump: DumpFolder) -> Path | None:
    """Return the stamps beside a camera's ``data`` folder, as in KITTI raw and EuRoC."""
    image = dump.sensors.get("image")
    if image is None or image.first.parent.name != "data":
        return None
    paths = (image.first.parent.parent / name for name in ("timestamps.txt", "data.csv"))
    return next((path for path in paths if path.is_file()), None)


def _detections(request: Request, dump: DumpFolder, size: tuple[int, int]) -> tuple[Detections, str]:
    """Return the detections by frame number, and their source; ``size`` is columns and rows of the images."""
    if "detections" in dump.sensors:
        sensor = dump.sensors["detections"]
        detections, form = load_labels(sensor.files, _frames(dump), size)
        return detections, f"{sensor.source}, {form}"
    path = dump.documents.get("detections")
    if path is None:
        return {}, ""
    detections, form, notes = load_detections(path)
    request.notes.extend(notes)
    return detections, f"{path.name}, {form}"
