"""CULane: folders of frames of a video, ``00030.jpg``, with the lines of the lanes beside them in ``00030.lines.txt``.

Each line of such a file is one line on the road, x and y of its points in pixels. The number of a file is that of the
video's frame: every 30th or 90th frame is there.
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float

from ..readers.documents import numbers, read_lines
from ..readers.frame_stamps import stamps_of_rate
from ..readers.sensor_folders import sensor_in
from .dataset import DatasetSequence, Layout, Request
from .lane_labels import FLAGS, labelled_dataset

_SUFFIX: Final = ".lines.txt"
_RATE_HZ: Final = 30.0
_NAME_PARTS: Final = 3
"""Parts of an image's path in the lists: drive, video and file."""
_DEPTHS: Final = ("", "*/", "*/*/")


def _sequences(folder: Path) -> dict[str, Path]:
    """Return the folders with files of lines up to two levels below a folder, by their path in it."""
    found = sorted({path.parent for depth in _DEPTHS for path in folder.glob(f"{depth}*{_SUFFIX}")})
    return {path.relative_to(folder).as_posix(): path for path in found}


def _read(request: Request) -> DatasetSequence:
    images, rate_hz = sensor_in(request.path, "image"), request.options.rate_hz or _RATE_HZ
    labels = {number: path.with_suffix(_SUFFIX) for number, path in images.files.items()}
    lines_px = {number: _lines(path) for number, path in labels.items() if path.is_file()}
    dataset = labelled_dataset(request, images, lines_px, stamps_of_rate(sorted(images.files), rate_hz))
    names = {number: "/".join(images.files[number].resolve().parts[-_NAME_PARTS:]) for number in lines_px}
    title, timing = f"CULane, {request.name}", f"{rate_hz:g} Hz by frame number"
    return replace(dataset, title=title, timing=timing, label_names=names)


def _detect(folder: Path) -> bool:
    return any(next(folder.glob(f"{depth}*{_SUFFIX}"), None) for depth in _DEPTHS)


LAYOUT: Final = Layout(_read, (*FLAGS, "--rate"), _sequences, _detect)


def _lines(path: Path) -> list[Float]:
    """Return the lines of a file, each (N, 2) x, y in pixels."""
    found = []
    for k, text in enumerate(read_lines(path), 1):
        values = numbers(f"{path}: line {k}", text.split())
        if len(values) % 2:
            raise DumpError(f"{path}: line {k}: expected pairs of x and y, found {text[:60]!r}")
        found.append(values.reshape(-1, 2))
    return found
