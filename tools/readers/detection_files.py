"""Read detections: the project's JSON, COCO results, KITTI's and YOLO's label files.

Raises everywhere:
    DumpError: the file is wrong; the message names file, key or line, and error.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter

from roadperc_stream.config.calibration import Number, Numbers4
from roadperc_stream.errors import DumpError
from roadperc_stream.model import Box, Detection

from .documents import Document, Id, Listed, by_frame, checked, frame_number, numbers, read_json, read_lines, read_yaml

Detections = dict[int, tuple[Detection, ...]]
"""The detections by frame number."""

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
KITTI_COLUMNS: Final = 15
KITTI_IGNORED: Final = "DontCare"
NAMES_FILES: Final = ("data.yaml", "dataset.yaml", "classes.txt", "names.txt", "obj.names", "coco.names")
"""Files with the names of YOLO's classes: beside the labels, or up to two folders above."""
_YOLO_CLASS: Final = re.compile("[0-9]{1,9}")
_LARGEST_SHARE: Final = 1.5
"""Larger values in YOLO's labels are pixels; a box may end a little outside the image."""


def checked_box(where: str, x_min: float, y_min: float, x_max: float, y_max: float) -> Box:
    """Return a half-open box without clipping; it is an error if a maximum is below its minimum."""
    if x_max < x_min or y_max < y_min:
        raise DumpError(f"{where}: box {x_min}, {y_min}, {x_max}, {y_max}: expected x_min, y_min, x_max, y_max")
    return Box(x_min, y_min, x_max, y_max)


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
    """Return the detections of a JSON file by frame number, the format, and notes."""
    data = read_json(path)
    if isinstance(data, list) or (isinstance(data, dict) and any(isinstance(data.get(k), list) for k in _COCO_LISTS)):
        return _coco(path, data)
    frames = by_frame(path, checked(path, TypeAdapter(dict[str, Listed[_Entry]]), data))
    return {n: tuple(_detection(path, n, e) for e in entries) for n, entries in frames.items()}, "boxes by frame", ()


def _detection(path: Path, number: int, entry: _Entry) -> Detection:
    return Detection(entry.label, checked_box(f"{path}: frame {number}", *entry.box_px), entry.score, str(entry.id))


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


def load_labels(files: Mapping[int, Path], frames: Collection[int], size: tuple[int, int]) -> tuple[Detections, str]:
    """Return the detections of label files by frame number, and the format.

    KITTI's lines begin with a name, YOLO's with a number. With YOLO's labels a frame without a file has no objects.
    ``size`` is columns and rows of the images.
    """
    first = next((line for path in files.values() for line in read_lines(path) if line.strip()), "")
    if not re.match(r"\s*[0-9]+\s", first):
        return {number: tuple(_kitti_objects(path)) for number, path in files.items()}, "KITTI labels"
    names, source = _yolo_names(next(iter(files.values())).absolute().parent)
    found = {number: tuple(_yolo_boxes(path, names, size)) for number, path in files.items()}
    return dict.fromkeys(frames, ()) | found, f"YOLO labels, {source}"


def _kitti_objects(path: Path) -> Iterator[Detection]:
    for at, line in enumerate(read_lines(path), 1):
        if line.strip() and (found := kitti_detection(f"{path}: line {at}", line.split())).label != KITTI_IGNORED:
            yield found


def kitti_detection(where: str, fields: list[str]) -> Detection:
    """Read a KITTI line: type, truncated, occluded, alpha, box, dimensions, location, rotation, score.

    The box's maxima are the last pixels inside. Half-open maxima are one pixel further.
    """
    if len(fields) not in (KITTI_COLUMNS, KITTI_COLUMNS + 1):
        raise DumpError(f"{where}: expected {KITTI_COLUMNS} or {KITTI_COLUMNS + 1} KITTI columns, got {len(fields)}")
    found = numbers(where, (*fields[4:KITTI_COLUMNS], (*fields[15:], "1")[0]))
    x_min, y_min, x_max, y_max, *_, score = found.tolist()
    return Detection(fields[0], checked_box(where, x_min, y_min, x_max + 1.0, y_max + 1.0), score)


def _yolo_boxes(path: Path, names: Mapping[int, str], size: tuple[int, int]) -> Iterator[Detection]:
    """Yield the boxes of lines with class, centre and size of the box in shares of the image, and perhaps a score."""
    for at, line in enumerate(read_lines(path), 1):
        if not line.strip():
            continue
        where, (kind, *fields) = f"{path}: line {at}", line.split()
        shares = numbers(where, (*fields, "1")[:5]).tolist()
        is_share = all(abs(share) <= _LARGEST_SHARE for share in shares)
        if len(fields) not in (4, 5) or not _YOLO_CLASS.fullmatch(kind) or not is_share:
            raise DumpError(f"{where}: expected class, x, y, width, height (shares of the image) and perhaps a score")
        (x, y, width, height, score), (columns, rows) = shares, size
        left, top = (x - width / 2) * columns, (y - height / 2) * rows
        box = checked_box(where, left, top, left + width * columns, top + height * rows)
        yield Detection(names.get(int(kind), kind), box, score)


def _yolo_names(folder: Path) -> tuple[dict[int, str], str]:
    """Return the name of each class, and its file; without a file, the numbers are the labels."""
    places = (place / name for place in (folder, *folder.parents[:2]) for name in NAMES_FILES)
    path = next((path for path in places if path.is_file()), None)
    if path is None:
        return {}, "classes by number: no data.yaml or classes.txt"
    if path.suffix != ".yaml":
        return dict(enumerate(map(str.strip, read_lines(path)))), f"classes of {path.name}"
    document = read_yaml(path)
    names = document.get("names") if isinstance(document, dict) else None
    pairs = names.items() if isinstance(names, dict) else enumerate(names) if isinstance(names, list) else ()
    found = {key: name for key, name in pairs if isinstance(key, int) and isinstance(name, str)}
    if not found:
        raise DumpError(f"{path}: expected names: [car, truck] or names: {{0: car, 1: truck}}")
    return found, f"classes of {path.name}"
