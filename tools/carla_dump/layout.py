"""Finding what a dump folder holds: a folder or flat files per sensor, one file per frame, and the documents."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.system.files import real_path

from .json_files import frame_number
from .role_names import role_of

_IMAGE_SUFFIXES: Final = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".webp", ".tif", ".tiff", ".ppm", ".exr"})
_NUMBER_SUFFIXES: Final = frozenset({".npy", ".npz", ".dat", ".csv", ".raw", ".bin"})
_POINT_SUFFIXES: Final = frozenset({".ply"})
_FRAME_SUFFIXES: Final = _IMAGE_SUFFIXES | _NUMBER_SUFFIXES | _POINT_SUFFIXES
"""Files that may be a frame; what they really are is decided by content."""
_DOCUMENTS: Final = {
    "calibration": ("calibration.json",),
    "detections": ("detections.json", "coco_results.json", "coco.json"),
    "poses": ("poses.json", "transforms.json", "poses.csv", "poses.txt"),
    "timestamps": ("timestamps.txt", "timestamps.csv", "times.txt", "data.csv"),
    "truth": ("truth.json",),
}
_DOCUMENT_SUFFIXES: Final = frozenset({".json", ".txt", ".yaml", ".yml"})
_DOCUMENT_NAMES: Final = frozenset(name for names in _DOCUMENTS.values() for name in names)
_KNOWN_DOCUMENTS: Final = "documents are called " + ", ".join(names[0] for names in _DOCUMENTS.values())
_TRUTH_FOLDER: Final = "truth"
_KITTI_IMAGES: Final = re.compile(r"image_0?[0-3]")
"""KITTI's folders: image_2 of objects, image_0 of odometry, image_02/data of raw drives."""


@dataclass(frozen=True)
class Sensor:
    """The files of one role by frame number."""

    role: str
    source: str
    """Folder or file pattern, as the user knows it."""
    files: Mapping[int, Path]

    @property
    def first(self) -> Path:
        """File of the smallest frame number."""
        return self.files[min(self.files)]

    @property
    def is_of_kitti(self) -> bool:
        """Whether the images lie in one of KITTI's folders."""
        folders = self.first.parent, self.first.parent.parent
        return any(_KITTI_IMAGES.fullmatch(folder.name) for folder in folders)


@dataclass(frozen=True)
class DumpLayout:
    """Everything found in a dump."""

    dump: Path
    sensors: Mapping[str, Sensor]
    documents: Mapping[str, Path]
    notes: tuple[str, ...] = ()


def find_layout(dump: Path, overrides: Mapping[str, Path]) -> DumpLayout:
    """Look through a dump folder.

    Args:
        dump: the folder.
        overrides: folder, file or document for a role, under any name.

    Raises:
        DumpError: no such folder, nothing that fits a role, two candidates for one role, two files of one frame.
    """
    entries = _entries(dump)
    notes: list[str] = []
    taken = {real_path(path) for path in overrides.values()}
    free = [e for e in entries if real_path(e) not in taken and role_of(e.name) not in overrides]
    candidates = [sensor for sensor in _candidates(free, notes) if sensor.role not in overrides]
    documents = {kind: path for kind in _DOCUMENTS if (path := _document(dump, kind, overrides))}
    candidates += [
        _numbered(role, str(path), _frame_files(path, role), notes, alone=_stands_alone(path))
        for role, path in overrides.items()
        if path not in documents.values()
    ]
    sensors = _one_per_role(candidates)
    if not sensors:
        raise DumpError(_nothing_found(dump, entries))
    if "detections" in sensors and "detections" in documents:
        raise DumpError(
            f"{dump}: both {documents['detections'].name} and {sensors['detections'].source}/ hold detections; "
            "choose with --role detections=PATH"
        )
    return DumpLayout(dump, sensors, documents, tuple(notes))


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
        if entry.suffix.lower() in _DOCUMENT_SUFFIXES and entry.name not in _DOCUMENT_NAMES and entry.is_file()
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
    notes += [f"{source}/{name} is not used: stamps are in timestamps.txt or timestamps.csv" for name in unused]
    if role is None or not files:
        notes.append(f"{source}/ is left out: " + ("no frames in it" if role else "its name fits no role (--role)"))
        return None
    return _numbered(role, source, files, notes)


def _frame_files(path: Path, role: str | None = None) -> list[Path]:
    """Files of a folder that may be frames; KITTI puts them one folder deeper, in ``data``."""
    if path.is_file():
        return [path]
    if role == "detections":
        return _label_files(path)
    found = [p for p in _entries(path) if _may_be_frame(p)]
    return _frame_files(path / "data") if not found and (path / "data").is_dir() else found


def _may_be_frame(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() in _FRAME_SUFFIXES and path.name not in _DOCUMENT_NAMES


def _label_files(folder: Path) -> list[Path]:
    return [p for p in _entries(folder) if p.suffix == ".txt" and p.name not in _DOCUMENT_NAMES]


def _stands_alone(path: Path) -> bool:
    """Whether a path is one file without a frame number: it makes the one frame there is, 0."""
    return path.is_file() and frame_number(path.stem) is None


def _numbered(role: str, source: str, files: list[Path], notes: list[str], *, alone: bool = False) -> Sensor:
    """A sensor with its files by the number in their names; a file standing alone needs none."""
    numbered: dict[int, Path] = {}
    unnumbered = []
    for path in files:
        number = 0 if alone else frame_number(path.stem)
        if number is None:
            unnumbered.append(path.name)
        elif number in numbered:
            raise DumpError(f"{source}: {numbered[number].name} and {path.name} are both frame {number}")
        else:
            numbered[number] = path
    if not files:
        raise DumpError(f"{source}: no frames in it")
    if not numbered:
        raise DumpError(f"{source}: no frame number in the name of {unnumbered[0]}")
    if unnumbered:
        notes.append(f"{source}: left out, no frame number in the name: {', '.join(unnumbered[:3])}")
    return Sensor(role, source, numbered)


def _flat_sensors(files: Iterable[Path], notes: list[str]) -> Iterator[Sensor]:
    """Sensors of files that lie in the dump itself, recognised by their names: ``left.png``, ``depth_0001.png``."""
    groups: dict[str, list[Path]] = {}
    for path in files:
        # Without its frame number; a bare number is a camera image.
        words = re.sub(r"[0-9]+(?=[^0-9]*$)", "", path.stem).strip("_-. ")
        if role := role_of(words) if words else "image":
            groups.setdefault(role, []).append(path)
        else:
            notes.append(f"{path.name} is left out: its name fits no role (--role)")
    for role, group in groups.items():
        alone = len(group) == 1 and _stands_alone(group[0])
        source = group[0].name if len(group) == 1 else f"{group[0].name} to {group[-1].name}"
        yield _numbered(role, source, group, notes, alone=alone)


def _document(dump: Path, kind: str, overrides: Mapping[str, Path]) -> Path | None:
    if kind in overrides:
        return overrides[kind] if overrides[kind].suffix == ".json" else None
    found = [dump / name for name in _DOCUMENTS[kind] if (dump / name).is_file()]
    if len(found) > 1:
        raise DumpError(f"{dump}: {found[0].name} and {found[1].name} both hold {kind}: keep one")
    return found[0] if found else None


def _one_per_role(candidates: Iterable[Sensor]) -> dict[str, Sensor]:
    sensors: dict[str, Sensor] = {}
    for sensor in candidates:
        if sensor.role in sensors:
            first = sensors[sensor.role].source
            choice = f"--role {sensor.role}={quote(first)}"
            raise DumpError(f"{first} and {sensor.source} both look like {sensor.role}: choose with {choice}")
        sensors[sensor.role] = sensor
    return sensors


def _nothing_found(dump: Path, entries: list[Path]) -> str:
    there = ", ".join(entry.name + "/" * entry.is_dir() for entry in entries[:8]) or "nothing"
    return (
        f"{dump}: no sensor found. Looked for folders such as rgb, depth, segmentation, left, right (CameraRGB, "
        f"image_2, sem, ...) with one numbered file per frame, or files such as left.png; there is: {there}"
    )
