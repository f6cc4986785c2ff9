"""Find the contents of a dump: a folder or flat files per sensor with one file per frame, and the documents."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.schemas.role_names import names_other_sensor, role_of
from roadperc_stream.system.files import real_path

from ..readers.detection_files import NAMES_FILES
from ..readers.sensor_folders import (
    DOCUMENTS,
    Sensor,
    entries_of,
    frame_files,
    is_image,
    is_single,
    may_be_frame,
    numbered_sensor,
)

_DOCUMENT_SUFFIXES: Final = frozenset({".json", ".txt", ".yaml", ".yml"})
_NOT_FRAMES: Final = frozenset(name for names in DOCUMENTS.values() for name in names).union(NAMES_FILES)
_KNOWN_DOCUMENTS: Final = "known documents are " + ", ".join(names[0] for names in DOCUMENTS.values())
_TRUTH_FOLDER: Final = "truth"


@dataclass(frozen=True)
class DumpFolder:
    """The sensors and documents of a dump."""

    sensors: Mapping[str, Sensor]
    documents: Mapping[str, Path]
    notes: list[str] = field(default_factory=list)


def find_dump(dump: Path, overrides: Mapping[str, Path], *, below: bool = True) -> DumpFolder:
    """Return the sensors and documents of a dump; ``overrides`` are the paths of ``--role``.

    With ``below``, a folder without sensors may hold one folder with a dump, such as ``_out``.

    Raises:
        DumpError: no such folder, no sensor, two candidates for one role, or two files of one frame.
    """
    entries = entries_of(dump)
    notes: list[str] = []
    taken = {real_path(path) for path in overrides.values()}
    free = [e for e in entries if real_path(e) not in taken and role_of(e.name) not in overrides]
    candidates = [sensor for sensor in _candidates(free, notes) if sensor.role not in overrides]
    documents = {kind: path for kind in DOCUMENTS if (path := _document(dump, kind, overrides))}
    candidates += [
        numbered_sensor(role, str(path), _files_of(path, role), notes, single=is_single(path))
        for role, path in overrides.items()
        if path not in documents.values()
    ]
    sensors = _one_per_role(candidates)
    if not sensors and (camera := _only_images(dump, entries)):
        sensors, notes = {"image": camera}, [f"{camera.source}: taken as the images of the front camera"]
    if not sensors:
        return _find_below(dump, entries, overrides if below else None)
    if "detections" in sensors and "detections" in documents:
        raise DumpError(
            f"{dump}: both {documents['detections'].name} and {sensors['detections'].source}/ hold detections; "
            "choose one with --role detections=PATH"
        )
    return DumpFolder(sensors, documents, notes)


def _find_below(dump: Path, entries: list[Path], overrides: Mapping[str, Path] | None) -> DumpFolder:
    """Return the dump in the only folder that holds frames; None for ``overrides`` allows none."""
    folders = [entry for entry in entries if entry.is_dir() and not names_other_sensor(entry.name)]
    inside = [] if overrides is None else [folder for folder in folders if frame_count(folder)]
    if overrides is not None and len(inside) == 1:
        found = find_dump(inside[0], overrides, below=False)
        found.notes.insert(0, f"{inside[0].name}/ is read: {dump.name} has no sensor itself")
        return found
    several = f"; {len(inside)} folders in it hold frames: pass one, such as {inside[0]}" if inside else ""
    there = ", ".join(entry.name + "/" * entry.is_dir() for entry in entries[:8]) or "nothing"
    raise DumpError(
        f"{dump}: no sensor found. Expected folders such as rgb, depth, segmentation, left, right (CameraRGB, image_2, "
        f"sem, ...) with one numbered file per frame, or files such as left.png; found: {there}{several}"
    )


def frame_count(dump: Path) -> int:
    """Return the number of files that can be frames: of flat files, and of folders with a role.

    Raises:
        DumpError: a folder cannot be read.
    """
    entries = entries_of(dump)
    folders = [entry for entry in entries if entry.is_dir() and role_of(entry.name)]
    return sum(map(may_be_frame, entries)) + sum(len(frame_files(folder)) for folder in folders)


def _only_images(dump: Path, entries: Sequence[Path]) -> Sensor | None:
    """Return the camera of a folder that holds nothing but images, flat or in one folder, under any name."""
    folders = [entry for entry in entries if entry.is_dir()]
    inside = entries_of(folders[0]) if len(folders) == 1 else []
    images = [path for path in (*entries, *inside) if is_image(path)]
    sources = {path.parent for path in images}
    if len(sources) != 1 or any(names_other_sensor(f"{path.parent.name} {path.stem}") for path in images):
        return None
    source = f"{images[0].name} to {images[-1].name}" if sources == {dump} else folders[0].name
    return numbered_sensor("image", source, images, [], single=len(images) == 1 and is_single(images[0]))


def _candidates(entries: Sequence[Path], notes: list[str]) -> Iterator[Sensor]:
    yield from _flat_sensors([entry for entry in entries if may_be_frame(entry)], notes)
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
    for folder in (entry for entry in entries_of(truth) if entry.is_dir()):
        sensor = _folder_sensor(folder, f"{truth.name}/{folder.name}", notes)
        if sensor and sensor.role in ("depth", "segmentation"):
            yield Sensor(f"truth_{sensor.role}", sensor.source, sensor.files)


def _folder_sensor(folder: Path, source: str, notes: list[str]) -> Sensor | None:
    role = role_of(folder.name)
    files = _files_of(folder, role)
    if role in ("segmentation", "detections") and not files:
        role, files = "detections", _label_files(folder)
    unused = [path.name for path in entries_of(folder) if path.suffix == ".json"] if role != "detections" else []
    notes += [f"{source}/{name} is not used: put stamps into timestamps.txt or timestamps.csv" for name in unused]
    if role is None or not files:
        why = "it has no frames" if role else "its name fits no role; choose one with --role"
        notes.append(f"{source}/ is left out: {why}")
        return None
    return numbered_sensor(role, source, files, notes)


def _files_of(path: Path, role: str | None) -> list[Path]:
    """Return the files of a role in a folder, or the file itself."""
    if path.is_file():
        return [path]
    return _label_files(path) if role == "detections" else frame_files(path)


def _label_files(folder: Path) -> list[Path]:
    return [p for p in entries_of(folder) if p.suffix == ".txt" and p.name not in _NOT_FRAMES]


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
        single = len(group) == 1 and is_single(group[0])
        source = group[0].name if len(group) == 1 else f"{group[0].name} to {group[-1].name}"
        yield numbered_sensor(role, source, group, notes, single=single)


def _document(dump: Path, kind: str, overrides: Mapping[str, Path]) -> Path | None:
    if kind in overrides:
        return overrides[kind] if overrides[kind].suffix == ".json" else None
    found = [dump / name for name in DOCUMENTS[kind] if (dump / name).is_file()]
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
