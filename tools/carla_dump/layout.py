"""Find the contents of a dump: a folder or flat files per sensor with one file per frame, and the documents."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from shlex import quote
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.schemas.role_names import names_other_sensor, role_of
from roadperc_stream.system.files import real_path

from .calibration_file import CALIBRATION_NAME
from .json_files import frame_number, is_seconds
from .yolo_files import NAMES_FILES

_IMAGE_SUFFIXES: Final = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".webp", ".tif", ".tiff", ".ppm", ".exr"})
_NUMBER_SUFFIXES: Final = frozenset({".npy", ".npz", ".dat", ".csv", ".raw", ".bin", ".h5", ".hdf5"})
_POINT_SUFFIXES: Final = frozenset({".ply", ".las", ".laz"})
_FRAME_SUFFIXES: Final = _IMAGE_SUFFIXES | _NUMBER_SUFFIXES | _POINT_SUFFIXES
"""Suffixes of files that can be a frame; the content decides the format."""
_DOCUMENTS: Final = {
    "calibration": (CALIBRATION_NAME,),
    "detections": ("detections.json", "coco_results.json", "coco.json"),
    "poses": ("poses.json", "transforms.json", "poses.csv", "poses.txt"),
    "timestamps": ("timestamps.txt", "timestamps.csv", "times.txt", "data.csv"),
    "truth": ("truth.json",),
}
_DOCUMENT_SUFFIXES: Final = frozenset({".json", ".txt", ".yaml", ".yml"})
_DOCUMENT_NAMES: Final = frozenset(name for names in _DOCUMENTS.values() for name in names)
_NOT_FRAMES: Final = _DOCUMENT_NAMES.union(NAMES_FILES)
_KNOWN_DOCUMENTS: Final = "known documents are " + ", ".join(names[0] for names in _DOCUMENTS.values())
_TRUTH_FOLDER: Final = "truth"
_SHORTEST_NS: Final = 1_000_000


@dataclass(frozen=True)
class Sensor:
    """The files of one role by frame number."""

    role: str
    source: str
    """Name of the folder or files for messages."""
    files: Mapping[int, Path]

    @property
    def first(self) -> Path:
        """Return the file with the smallest frame number."""
        return self.files[min(self.files)]


@dataclass(frozen=True)
class DumpLayout:
    """The sensors and documents of a dump."""

    sensors: Mapping[str, Sensor]
    documents: Mapping[str, Path]
    notes: tuple[str, ...] = ()


def find_layout(dump: Path, overrides: Mapping[str, Path], *, below: bool = True) -> DumpLayout:
    """Return the sensors and documents of a dump; ``overrides`` are the paths of ``--role``.

    With ``below``, a folder without sensors may hold one folder with a dump, such as ``_out``.

    Raises:
        DumpError: no such folder, no sensor, two candidates for one role, or two files of one frame.
    """
    entries = _entries(dump)
    notes: list[str] = []
    taken = {real_path(path) for path in overrides.values()}
    free = [e for e in entries if real_path(e) not in taken and role_of(e.name) not in overrides]
    candidates = [sensor for sensor in _candidates(free, notes) if sensor.role not in overrides]
    documents = {kind: path for kind in _DOCUMENTS if (path := _document(dump, kind, overrides))}
    candidates += [
        _numbered(role, str(path), _frame_files(path, role), notes, single=_is_single(path))
        for role, path in overrides.items()
        if path not in documents.values()
    ]
    sensors = _one_per_role(candidates)
    if not sensors and (camera := _only_images(dump, entries)):
        sensors, notes = {"image": camera}, [f"{camera.source}: taken as the images of the front camera"]
    folders = [entry for entry in entries if entry.is_dir() and not names_other_sensor(entry.name)]
    inside = [folder for folder in folders if frame_count(folder)] if below and not sensors else []
    if len(inside) == 1:
        found = find_layout(inside[0], overrides, below=False)
        note = f"{inside[0].name}/ is read: {dump.name} has no sensor itself"
        return replace(found, notes=(note, *found.notes))
    if not sensors:
        several = f"; {len(inside)} folders in it hold frames: pass one, such as {inside[0]}" if inside else ""
        raise DumpError(_nothing_found(dump, entries) + several)
    if "detections" in sensors and "detections" in documents:
        raise DumpError(
            f"{dump}: both {documents['detections'].name} and {sensors['detections'].source}/ hold detections; "
            "choose one with --role detections=PATH"
        )
    return DumpLayout(sensors, documents, tuple(notes))


def frame_count(dump: Path) -> int:
    """Return the number of files that can be frames: of flat files, and of folders with a role.

    Raises:
        DumpError: a folder cannot be read.
    """
    entries = _entries(dump)
    folders = [entry for entry in entries if entry.is_dir() and role_of(entry.name)]
    return sum(map(_may_be_frame, entries)) + sum(len(_frame_files(folder)) for folder in folders)


def _only_images(dump: Path, entries: Sequence[Path]) -> Sensor | None:
    """Return the camera of a folder that holds nothing but images, flat or in one folder, under any name."""
    folders = [entry for entry in entries if entry.is_dir()]
    inside = _entries(folders[0]) if len(folders) == 1 else []
    images = [path for path in (*entries, *inside) if path.suffix.lower() in _IMAGE_SUFFIXES and path.is_file()]
    sources = {path.parent for path in images}
    if len(sources) != 1 or any(names_other_sensor(f"{path.parent.name} {path.stem}") for path in images):
        return None
    source = f"{images[0].name} to {images[-1].name}" if sources == {dump} else folders[0].name
    return _numbered("image", source, images, [], single=len(images) == 1 and _is_single(images[0]))


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(p for p in folder.iterdir() if not p.name.startswith("."))
    except OSError as error:
        raise DumpError(f"{folder}: {error.strerror or error}") from error


def _candidates(entries: Sequence[Path], notes: list[str]) -> Iterator[Sensor]:
    yield from _flat_sensors([entry for entry in entries if _may_be_frame(entry)], notes)
    notes += [
        f"{entry.name} is not used: {_KNOWN_DOCUMENTS}"
        for entry in entries
        if entry.suffix.lower() in _DOCUMENT_SUFFIXES and entry.name not in _NOT_FRAMES and entry.is_file()
    ]
    for folder in (entry for entry in entries if entry.is_dir()):
        if folder.name == _TRUTH_FOLDER:
            yield from _truth_sensors(folder, notes)
        elif sensor := _folder_sensor(folder, folder.name, notes):
            yield sensor


def _truth_sensors(truth: Path, notes: list[str]) -> Iterator[Sensor]:
    for folder in (entry for entry in _entries(truth) if entry.is_dir()):
        sensor = _folder_sensor(folder, f"{truth.name}/{folder.name}", notes)
        if sensor and sensor.role in ("depth", "segmentation"):
            yield Sensor(f"truth_{sensor.role}", sensor.source, sensor.files)


def _folder_sensor(folder: Path, source: str, notes: list[str]) -> Sensor | None:
    role = role_of(folder.name)
    files = _frame_files(folder, role)
    if role in ("segmentation", "detections") and not files:
        role, files = "detections", _label_files(folder)
    unused = [path.name for path in _entries(folder) if path.suffix == ".json"] if role != "detections" else []
    notes += [f"{source}/{name} is not used: put stamps into timestamps.txt or timestamps.csv" for name in unused]
    if role is None or not files:
        why = "it has no frames" if role else "its name fits no role; choose one with --role"
        notes.append(f"{source}/ is left out: {why}")
        return None
    return _numbered(role, source, files, notes)


def sensor_in(folder: Path, role: str) -> Sensor:
    """Return a role's files in a folder by the number in their names.

    Raises:
        DumpError: the folder has no file of a frame, or two of one.
    """
    return _numbered(role, folder.name, _frame_files(folder, role), [])


def _frame_files(path: Path, role: str | None = None) -> list[Path]:
    """Return the files of a folder that can be frames; in KITTI they are in the subfolder ``data``."""
    if path.is_file():
        return [path]
    if role == "detections":
        return _label_files(path)
    found = [p for p in _entries(path) if _may_be_frame(p)]
    return _frame_files(path / "data") if not found and (path / "data").is_dir() else found


def _may_be_frame(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() in _FRAME_SUFFIXES and path.name not in _DOCUMENT_NAMES


def _label_files(folder: Path) -> list[Path]:
    return [p for p in _entries(folder) if p.suffix == ".txt" and p.name not in _NOT_FRAMES]


def _is_single(path: Path) -> bool:
    """Return True if a path is a file without a frame number; it becomes frame 0."""
    return path.is_file() and frame_number(path.stem) is None


def _numbered(role: str, source: str, files: list[Path], notes: list[str], *, single: bool = False) -> Sensor:
    """Return a sensor with its files by the number in their names; a ``single`` file is frame 0."""
    numbered: dict[int, Path] = {}
    unnumbered = []
    in_seconds = any(is_seconds(path.stem) for path in files)
    for path in files:
        whole = in_seconds and not is_seconds(path.stem)  # 13.png among 12.95.png and 13.05.png
        number = 0 if single else frame_number(f"{path.stem}.0" if whole else path.stem)
        if number is None:
            unnumbered.append(path.name)
        elif number in numbered:
            raise DumpError(
                f"{source}: {numbered[number].name} and {path.name} are both frame {number}: the last number in a "
                "name is the frame's; rename the files, move other sensors into folders of their own, or remove one"
            )
        else:
            numbered[number] = path
    if not files:
        raise DumpError(f"{source}: no frames found; expected one numbered file per frame")
    if not numbered:
        raise DumpError(f"{source}: no frame number in the name of {unnumbered[0]}; expected names such as 000001.png")
    if unnumbered:
        notes.append(f"{source}: left out, no frame number in the name: {', '.join(unnumbered[:3])}")
    if in_seconds:
        _require_times(source, numbered)
    return Sensor(role, source, numbered)


def _require_times(source: str, files: Mapping[int, Path]) -> None:
    """Check that decimal numbers in names are seconds: as such, ``1.0001`` and ``1.0002`` are too close."""
    for earlier_ns, later_ns in pairwise(sorted(files)):
        if later_ns - earlier_ns <= _SHORTEST_NS:
            names = f"{files[earlier_ns].name} and {files[later_ns].name}"
            raise DumpError(f"{source}: {names}: as seconds 1 ms apart or less; write frame numbers without a point")


def _flat_sensors(files: Iterable[Path], notes: list[str]) -> Iterator[Sensor]:
    """Yield the sensors of files directly in the dump, by their names: ``left.png``, ``depth_0001.png``."""
    groups: dict[str, list[Path]] = {}
    for path in files:
        # The name without its frame number; a plain number is a camera image.
        words = re.sub(r"([0-9]+\.)?[0-9]+(?=[^0-9]*$)", "", path.stem).strip("_-. ")
        if role := role_of(words) if words else "image":
            groups.setdefault(role, []).append(path)
        else:
            notes.append(f"{path.name} is left out: its name fits no role; choose one with --role")
    for role, group in groups.items():
        single = len(group) == 1 and _is_single(group[0])
        source = group[0].name if len(group) == 1 else f"{group[0].name} to {group[-1].name}"
        yield _numbered(role, source, group, notes, single=single)


def _document(dump: Path, kind: str, overrides: Mapping[str, Path]) -> Path | None:
    if kind in overrides:
        return overrides[kind] if overrides[kind].suffix == ".json" else None
    found = [dump / name for name in _DOCUMENTS[kind] if (dump / name).is_file()]
    if len(found) > 1:
        raise DumpError(f"{dump}: {found[0].name} and {found[1].name} both hold {kind}; keep one of them")
    return found[0] if found else None


def _one_per_role(candidates: Iterable[Sensor]) -> dict[str, Sensor]:
    sensors: dict[str, Sensor] = {}
    for sensor in candidates:
        if sensor.role in sensors:
            first = sensors[sensor.role].source
            both = f"{first} and {sensor.source} both match the role {sensor.role}"
            raise DumpError(f"{both}; choose one, such as --role {sensor.role}={quote(first)}")
        sensors[sensor.role] = sensor
    return sensors


def _nothing_found(dump: Path, entries: list[Path]) -> str:
    there = ", ".join(entry.name + "/" * entry.is_dir() for entry in entries[:8]) or "nothing"
    return (
        f"{dump}: no sensor found. Expected folders such as rgb, depth, segmentation, left, right (CameraRGB, image_2, "
        f"sem, ...) with one numbered file per frame, or files such as left.png; found: {there}"
    )
