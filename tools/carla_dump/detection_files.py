"""Read the detections of a dump: the project's JSON, COCO results or KITTI label files."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter

from roadperc_stream.config.calibration import Number, Numbers4
from roadperc_stream.errors import DumpError
from roadperc_stream.model import Box, Detection

from .json_files import (
    Document,
    Id,
    Listed,
    by_frame,
    checked,
    checked_entries,
    frame_number,
    numbers,
    read_json,
    read_lines,
)

Detections = dict[int, tuple[Detection, ...]]

COCO_LABELS: Final = {
    1: "person",
    2: "bicycle",
    3: "car",
    4: "motorcycle",
    6: "bus",
    7: "train",
    8: "truck",
    10: "traffic light",
    13: "stop sign",
}
"""COCO's standard category ids of classes on a road."""
_COCO_LISTS: Final = ("annotations", "results", "detections", "predictions")
_COCO_HINT: Final = (
    "; read as COCO: each entry has image_id, bbox and category_id; the other form is {frame: [{label, box_px, score}]}"
)
_KITTI_COLUMNS: Final = 15
KITTI_IGNORED: Final = "DontCare"


class _Entry(Document):
    label: str
    box_px: Numbers4
    score: Number = 1.0
    id: Id = ""


class _CocoEntry(Document):
    image_id: Id
    bbox: Numbers4
    score: Number = 1.0
    category_id: int | None = None
    category: str | None = None
    label: str | None = None
    id: Id = ""


class _Category(Document):
    id: int
    name: str


class _Image(Document):
    id: Id
    file_name: str


def load_detections(path: Path) -> tuple[Detections, str, tuple[str, ...]]:
    """Return the detections of a JSON file by frame number, the format, and notes.

    Raises:
        DumpError: the file is wrong; the message names file, key and error.
    """
    data = read_json(path)
    if isinstance(data, list) or (isinstance(data, dict) and any(isinstance(data.get(k), list) for k in _COCO_LISTS)):
        return _coco(path, data)
    frames = by_frame(path, checked_entries(path, TypeAdapter(Listed[_Entry]), data))
    return {n: tuple(_detection(path, n, e) for e in entries) for n, entries in frames.items()}, "boxes by frame", ()


def _detection(path: Path, number: int, entry: _Entry) -> Detection:
    return Detection(entry.label, checked_box(f"{path}: frame {number}", *entry.box_px), entry.score, str(entry.id))


def checked_box(where: str, x_min: float, y_min: float, x_max: float, y_max: float) -> Box:
    """Return a half-open box without clipping.

    Raises:
        DumpError: a maximum is below its minimum.
    """
    if x_max < x_min or y_max < y_min:
        raise DumpError(f"{where}: box {x_min}, {y_min}, {x_max}, {y_max}: expected x_min, y_min, x_max, y_max")
    return Box(x_min, y_min, x_max, y_max)


def _coco(path: Path, data: Any) -> tuple[Detections, str, tuple[str, ...]]:
    """Read COCO results (a list), or an object with a list of annotations, and optional images and categories."""
    tree: Mapping[str, Any] = data if isinstance(data, dict) else {"annotations": data}
    listed = next(tree[key] for key in _COCO_LISTS if isinstance(tree.get(key), list))
    entries = checked(path, TypeAdapter(Listed[_CocoEntry]), listed, hint=_COCO_HINT)
    categories = checked(path, TypeAdapter(Listed[_Category]), tree.get("categories") or [])
    images = checked(path, TypeAdapter(Listed[_Image]), tree.get("images") or [])
    names = {category.id: category.name for category in categories} or COCO_LABELS
    files = {str(image.id): Path(image.file_name).stem for image in images}
    frames: dict[int, list[Detection]] = {n: [] for name in files.values() if (n := frame_number(name)) is not None}
    for entry in entries:
        name = files.get(str(entry.image_id), str(entry.image_id))
        number = frame_number(name)
        if number is None:
            raise DumpError(f"{path}: image_id {name!r}: expected a frame number")
        frames.setdefault(number, []).append(_coco_detection(path, number, entry, names))
    given = {e.category_id for e in entries if e.category_id is not None and not (e.label or e.category)}
    unknown = sorted(given - set(names))
    notes = (f"COCO categories without a name: {', '.join(map(str, unknown))}",) if unknown else ()
    return {number: tuple(found) for number, found in frames.items()}, "COCO", notes


def _coco_detection(path: Path, number: int, entry: _CocoEntry, names: Mapping[int, str]) -> Detection:
    """Convert a COCO entry; its box is x, y, width, height, with half-open right and lower edges."""
    label = entry.label or entry.category
    if label is None:
        if entry.category_id is None:
            raise DumpError(f"{path}: frame {number}: expected category_id, category or label")
        label = names.get(entry.category_id, f"coco_{entry.category_id}")
    x, y, width, height = entry.bbox
    box = checked_box(f"{path}: frame {number}", x, y, x + width, y + height)
    return Detection(label, box, entry.score, str(entry.id))


def load_kitti_labels(files: Mapping[int, Path]) -> Detections:
    """Return the detections of KITTI label files by frame number.

    Raises:
        DumpError: a line is wrong; the message names file and line.
    """
    return {number: tuple(_kitti_objects(path)) for number, path in files.items()}


def _kitti_objects(path: Path) -> Iterator[Detection]:
    for at, line in enumerate(read_lines(path), 1):
        if line.strip() and (found := kitti_detection(f"{path}: line {at}", line.split())).label != KITTI_IGNORED:
            yield found


def kitti_detection(where: str, fields: list[str]) -> Detection:
    """Read a KITTI line: type, truncated, occluded, alpha, box, dimensions, location, rotation, score.

    The box's maxima are the last pixels inside. Half-open maxima are one pixel further.
    """
    if len(fields) not in (_KITTI_COLUMNS, _KITTI_COLUMNS + 1):
        raise DumpError(f"{where}: expected {_KITTI_COLUMNS} or {_KITTI_COLUMNS + 1} KITTI columns, got {len(fields)}")
    found = numbers(where, (*fields[4:_KITTI_COLUMNS], (*fields[15:], "1")[0]))
    x_min, y_min, x_max, y_max, *_, score = found.tolist()
    return Detection(fields[0], checked_box(where, x_min, y_min, x_max + 1.0, y_max + 1.0), score)
