"""Read YOLO's label files: on each line class, centre and size of a box in shares of the image, and perhaps a score."""

import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.model import Detection

from .detection_files import Detections, checked_box
from .json_files import numbers, read_lines, read_yaml

NAMES_FILES: Final = ("data.yaml", "dataset.yaml", "classes.txt", "names.txt", "obj.names", "coco.names")
"""Files with the names of the classes: beside the labels, or up to two folders above."""
_FIELDS: Final = (4, 5)
"""Numbers after the class."""
_CLASS: Final = re.compile("[0-9]{1,9}")
_MOST: Final = 1.5
"""Larger values are pixels; a box may end a little outside the image."""


def is_yolo(files: Collection[Path]) -> bool:
    """Return True if the first line of the labels begins with a number; KITTI's begin with a name."""
    first = next((line for path in files for line in read_lines(path) if line.strip()), "")
    return bool(re.match(r"\s*[0-9]+\s", first))


def load_yolo_labels(
    files: Mapping[int, Path], frames: Collection[int], size: tuple[int, int]
) -> tuple[Detections, str]:
    """Return the detections by frame number, and the source of the names; a frame without a file has no objects.

    ``size`` is columns and rows of the images.

    Raises:
        DumpError: a line is wrong; the message names file and line.
    """
    names, source = _names(next(iter(files.values())).absolute().parent)
    found = {number: tuple(_boxes(path, names, size)) for number, path in files.items()}
    return dict.fromkeys(frames, ()) | found, source


def _boxes(path: Path, names: Mapping[int, str], size: tuple[int, int]) -> Iterator[Detection]:
    for at, line in enumerate(read_lines(path), 1):
        if not line.strip():
            continue
        where, (kind, *fields) = f"{path}: line {at}", line.split()
        shares = numbers(where, (*fields, "1")[:5]).tolist()
        if len(fields) not in _FIELDS or not _CLASS.fullmatch(kind) or not all(abs(share) <= _MOST for share in shares):
            raise DumpError(f"{where}: expected class, x, y, width, height (shares of the image) and perhaps a score")
        (x, y, width, height, score), (columns, rows) = shares, size
        left, top = (x - width / 2) * columns, (y - height / 2) * rows
        box = checked_box(where, left, top, left + width * columns, top + height * rows)
        yield Detection(names.get(int(kind), kind), box, score)


def _names(folder: Path) -> tuple[dict[int, str], str]:
    """Return the name of each class, and its file; without a file, the numbers are the labels.

    Raises:
        DumpError: the file has no names.
    """
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
