"""The plan of a conversion: all files are found and checked before the first message is written."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import gcd
from pathlib import Path
from typing import Final, TypeVar

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera, Float
from roadperc_stream.model import Detection
from roadperc_stream.model.tag_tables import TagTable
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.time import NS_PER_S

from .calibration_file import CALIBRATION_NAME, CalibrationFile, load_calibration
from .camera_info import SUFFIXES, load_camera_info
from .camera_rig import CAMERA_ROLES, LIDAR, Rig, build_rig
from .depth_files import GREY, DepthEncoding, GreyDepth, depth_encoding, grey_encoding
from .detection_files import load_detections, load_kitti_labels
from .frame_stamps import DEFAULT_RATE_HZ, stamps_of_file, stamps_of_names, stamps_of_rate
from .layout import DumpLayout, find_layout
from .role_names import role_of
from .survey import SensorSurvey, apart_ns, front_sensors, meeting_notes, of_size, points_fault, reference_of, survey
from .tag_files import LOSSY_TAGS, TagEncoding, choose_table, named_table, tag_encoding
from .truth_file import NO_TRUTH, TruthTables, load_poses, load_truth

T = TypeVar("T")
_TAG_ROLES: Final[tuple[str, ...]] = ("segmentation", "truth_segmentation")
_DEPTH_ROLES: Final[tuple[str, ...]] = ("depth", "truth_depth")


@dataclass(frozen=True)
class ConvertOptions:
    """The options of the command line."""

    roles: Mapping[str, Path] = field(default_factory=dict)
    tags: str | None = None
    """Table of the tags: a CARLA version, the name of a dataset's table, or a TOML file."""
    fov_deg: float | None = None
    rate_hz: float | None = None
    depth_as_float: bool = False
    allow_lossy_tags: bool = False
    grey_depth: GreyDepth | None = None
    calibration: Path | None = None
    """A file that replaces ``calibration.json``: JSON, or the camera_info YAML of ROS."""
    height_m: float | None = None


@dataclass(frozen=True)
class Plan:
    """Everything that is needed to write the log."""

    layout: DumpLayout
    options: ConvertOptions
    surveys: Mapping[str, SensorSurvey]
    stamps_ns: Mapping[int, int]
    """Stamp by frame number, in the order of frames."""
    frames: tuple[int, ...]
    """Frame numbers; if names are stamps, the numbers of the reference sensor's images."""
    missing: Mapping[str, int]
    """Number of frames without a file by role; if names are stamps, without a file within the tolerance."""
    timing: str
    rig: Rig
    depth_encodings: Mapping[str, DepthEncoding]
    tag_encodings: Mapping[str, TagEncoding]
    tag_table: TagTable | None
    tag_table_source: str
    detections: Mapping[int, tuple[Detection, ...]]
    detections_source: str
    poses: Mapping[int, Float]
    truth: TruthTables
    notes: tuple[str, ...]
    pixel_origin: str
    """Origin of the principal point, and its source; empty without a matrix."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return warnings about losses in the conversion."""
        lossy_depth = [
            f"depth is {found}, {GREY[found]}; it is converted with this precision"
            for found in dict.fromkeys(self.depth_encodings.values())
            if found in GREY
        ]
        lossy_tags = self.options.allow_lossy_tags and self.tag_table is not None
        return (*lossy_depth, *(LOSSY_TAGS,) * lossy_tags)

    @property
    def unreadable(self) -> tuple[str, ...]:
        """Return the errors of unreadable files, which are left out."""
        return tuple(fault for survey in self.surveys.values() for fault in survey.unreadable)


def make_plan(dump: Path, options: ConvertOptions) -> Plan:
    """Read a dump and plan its conversion.

    Raises:
        DumpError: the dump cannot be converted; nothing is written.
        ConfigError: the tag table is unknown.
    """
    layout = find_layout(dump, options.roles)
    notes = list(layout.notes)
    document = layout.documents.get("calibration", layout.dump / CALIBRATION_NAME)
    said, calibration_path = calibration_of(document, options)
    calibration = _with_pixel_origin(layout, said)
    surveys = _surveys(layout, options, notes)
    sizes = {role: found.size for role, found in surveys.items() if found.size}
    left_is_front = "image" in surveys and "image" not in layout.sensors
    front_name = "left" if left_is_front else "image"
    rig = build_rig(calibration, calibration_path, list(surveys), sizes, front_name=front_name)
    notes += rig.notes
    cameras = {role: rig.camera_of(role) for role in surveys}
    surveys = {role: of_size(found, (cameras[role].width, cameras[role].height)) for role, found in surveys.items()}
    stamps_ns, timing, is_by_name = _stamps(layout, options, calibration.rate_hz, notes)
    frames, missing = _frames_and_missing(surveys, stamps_ns, notes, is_by_name=is_by_name)
    if LIDAR in surveys:
        _of_frames(LIDAR, surveys[LIDAR].sensor.files, stamps_ns, notes)
    depth_encodings = {
        role: _depth_encoding(surveys[role].paths, cameras[role], options, notes)
        for role in _DEPTH_ROLES
        if role in surveys
    }
    tags, table, table_source = _tags(surveys, options, calibration.carla_tags)
    detections, detections_source = _detections(layout, notes)
    poses = load_poses(layout.documents["poses"]) if "poses" in layout.documents else {}
    truth = layout.documents.get("truth")
    return Plan(
        layout=layout,
        options=options,
        surveys={
            role: replace(found, encoding=depth_encodings.get(role) or tags.get(role) or found.encoding)
            for role, found in surveys.items()
        },
        stamps_ns=stamps_ns,
        frames=frames,
        missing=missing,
        timing=timing,
        rig=rig,
        depth_encodings=depth_encodings,
        tag_encodings=tags,
        tag_table=table,
        tag_table_source=table_source,
        detections=_of_frames("detections", detections, stamps_ns, notes),
        detections_source=detections_source,
        poses=_of_frames("poses", poses, stamps_ns, notes),
        truth=load_truth(truth, rig.frame_ids["truth_depth"]) if truth else NO_TRUTH,
        notes=tuple(notes),
        pixel_origin=_origin_in_words(layout, calibration_path, said, calibration),
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
    load = load_camera_info if path.suffix.lower() in SUFFIXES else load_calibration
    calibration = load(path) if options.calibration or path.is_file() else CalibrationFile()
    if options.fov_deg is not None:
        no_lens = {"K": None, "D": (), "R": None, "P": None}
        calibration = calibration.model_copy(update={"fov_deg": options.fov_deg, **no_lens})
    if options.height_m is not None:
        if any(role_of(name) in ("image", "left") for name in calibration.mounting):
            raise DumpError(f"{path} has the camera's mounting: remove it there, or remove --height")
        calibration = calibration.model_copy(update={"rgb_height_m": options.height_m})
    return calibration, path


def _with_pixel_origin(layout: DumpLayout, calibration: CalibrationFile) -> CalibrationFile:
    """Return the calibration with its format's pixel origin: the first pixel's centre in KITTI, its corner in CARLA."""
    if "pixel_origin" in calibration.model_fields_set or not _is_kitti(layout):
        return calibration
    return calibration.model_copy(update={"pixel_origin": "centre"})


def _is_kitti(layout: DumpLayout) -> bool:
    return any(layout.sensors[role].is_of_kitti for role in ("image", "left") if role in layout.sensors)


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
    return {role: survey(sensors[role]) for role in ROLES if role in sensors}


def _depth_encoding(files: Sequence[Path], camera: Camera, options: ConvertOptions, notes: list[str]) -> DepthEncoding:
    """Return the encoding of a sensor's depth; adds a note for 8-bit grey."""
    found = depth_encoding(files)
    if found in GREY:
        found, note = grey_encoding(files, camera, options.grey_depth)
        notes.append(note)
    return found


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
        return stamps, f"stamps of {path.name}{_mean_rate(list(stamps.values()))}", False
    if (stamps_in_names := stamps_of_names(frames)) is not None:
        if options.rate_hz:
            raise DumpError(f"--rate {options.rate_hz:g}: the names of the files are stamps; remove --rate")
        if calibrated_hz is not None:
            notes.append(f"rate_hz {calibrated_hz:g} of the calibration is not used: the names of the files are stamps")
        images_ns = [stamps_in_names[number] for number in sorted(layout.sensors[reference_of(layout.sensors)].files)]
        return stamps_in_names, f"stamps in the names of the files{_mean_rate(images_ns)}", True
    rate_hz = options.rate_hz or calibrated_hz
    rate = rate_hz or DEFAULT_RATE_HZ
    stride = gcd(*(later - frames[0] for later in frames))
    if stride > 1:
        notes.append(f"frame numbers have steps of {stride}: frames are {stride / rate:g} s apart at {rate:g} Hz")
    source = "" if rate_hz else " (assumed: --rate)"
    return stamps_of_rate(frames, rate), f"{rate:g} Hz by frame number{source}", False


def _frames_and_missing(
    surveys: Mapping[str, SensorSurvey], stamps_ns: Mapping[int, int], notes: list[str], *, is_by_name: bool
) -> tuple[tuple[int, ...], dict[str, int]]:
    """Return the frame numbers, and the number of frames without a file by role."""
    if not is_by_name:
        counts = {role: sum(number in stamps_ns for number in found.sensor.files) for role, found in surveys.items()}
        return tuple(stamps_ns), {role: len(stamps_ns) - count for role, count in counts.items()}
    frames = tuple(sorted(surveys[reference_of(surveys)].sensor.files))
    apart = apart_ns(surveys, stamps_ns)
    notes += meeting_notes(surveys, apart, len(frames))
    return frames, {role: len(apart.get(role, frames)) for role in surveys}


def _mean_rate(stamps: Sequence[int]) -> str:
    if len(stamps) < 2:
        return ""
    return f", {(len(stamps) - 1) * NS_PER_S / (stamps[-1] - stamps[0]):.4g} Hz in the mean"


def _stamps_beside(layout: DumpLayout) -> Path | None:
    """Return the stamps beside a camera's ``data`` folder, as in KITTI raw and EuRoC."""
    image = layout.sensors.get("image")
    if image is None or image.first.parent.name != "data":
        return None
    paths = (image.first.parent.parent / name for name in ("timestamps.txt", "data.csv"))
    return next((path for path in paths if path.is_file()), None)


def _tags(
    surveys: Mapping[str, SensorSurvey], options: ConvertOptions, calibrated: str | None
) -> tuple[dict[str, TagEncoding], TagTable | None, str]:
    roles = [role for role in _TAG_ROLES if role in surveys]
    if not roles:
        return {}, None, ""
    named, lossy, first = named_table(options.tags or calibrated), options.allow_lossy_tags, roles[0]
    found = {role: tag_encoding(surveys[role].paths, named and named[0], allow_lossy=lossy) for role in roles}
    table, source = named or choose_table(*found[first], surveys[first].sensor.source)
    return {role: encoding for role, (encoding, _) in found.items()}, table, source


def _detections(layout: DumpLayout, notes: list[str]) -> tuple[Mapping[int, tuple[Detection, ...]], str]:
    """Return the detections by frame number, and their source."""
    if "detections" in layout.sensors:
        sensor = layout.sensors["detections"]
        return load_kitti_labels(sensor.files), f"{sensor.source}, KITTI labels"
    path = layout.documents.get("detections")
    if path is None:
        return {}, ""
    detections, kind, found = load_detections(path)
    notes += found
    return detections, f"{path.name}, {kind}"


def _of_frames(what: str, entries: Mapping[int, T], frames: Mapping[int, int], notes: list[str]) -> dict[int, T]:
    """Return the entries of frames with an image; adds a note about the others."""
    kept = {number: entries[number] for number in frames if number in entries}
    if len(kept) < len(entries):
        notes.append(f"{what}: {len(entries) - len(kept)} of {len(entries)} frames have no image: left out")
    return kept
