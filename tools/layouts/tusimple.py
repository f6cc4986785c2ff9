"""TuSimple's lane benchmark: ``label_data_*.json`` beside ``clips/``, whose clips have 20 images in a second.

Each line of a file labels one image, usually the last of its clip: columns of each lane at the rows ``h_samples``, -2
where the lane has none. Clips are unrelated, so one begins every three seconds.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from pydantic import Field, TypeAdapter

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float
from roadperc_stream.system.time import NS_PER_S

from ..readers.documents import EPOCH_NS, Document, Listed, checked, named_file, parsed_json, read_lines
from ..readers.sensor_folders import Sensor, sensor_in
from .dataset import DatasetSequence, Layout, Request
from .lane_labels import FLAGS, labelled_dataset

_LABELS: Final = ("label_data_*.json", "test_label*.json")
_RATE_HZ: Final = 20
_EVERY_S: Final = 3
_Pixel = Annotated[float, Field(ge=-1e6, le=1e6)]


class _Label(Document):
    raw_file: str
    lanes: Listed[Listed[_Pixel]]
    h_samples: Listed[_Pixel]


def _detect(folder: Path) -> bool:
    return bool(_files(folder)) and (folder / "clips").is_dir()


def _read(request: Request) -> DatasetSequence:
    """Read the labelled clips; ``--sequence`` chooses those whose path below ``clips`` begins with it."""
    folder, sequence = request.folder, request.options.sequence
    wanted = f"{folder / 'clips' / (sequence or '.')}"
    labels = {image: lines for image, lines in _labels(folder) if f"{image}".startswith(wanted)}
    clips = sorted({image.parent for image in labels})
    if not clips:
        raise DumpError(f"{folder}: the labels name no image in clips/{sequence or ''}")
    files: dict[int, Path] = {}
    for place, clip in enumerate(clips):
        first = place * _EVERY_S * _RATE_HZ
        files |= {first + number: path for number, path in sorted(sensor_in(clip, "image").files.items())}
    stamps_ns = {number: EPOCH_NS + number * NS_PER_S // _RATE_HZ for number in files}
    lines_px = {number: labels[path] for number, path in files.items() if path in labels}
    dataset = labelled_dataset(request, Sensor("image", "clips", files), lines_px, stamps_ns)
    names = {number: path.relative_to(folder).as_posix() for number, path in files.items() if path in labels}
    timing = f"{_RATE_HZ} Hz in a clip, a clip every {_EVERY_S} s"
    return replace(dataset, title=f"TuSimple, clips: {len(clips)}", timing=timing, label_names=names)


LAYOUT: Final = Layout(_read, FLAGS, detect=_detect)


def _files(folder: Path) -> list[Path]:
    return sorted(path for pattern in _LABELS for path in folder.glob(pattern))


def _labels(folder: Path) -> Iterator[tuple[Path, list[Float]]]:
    """Yield the labelled images that exist and their lines in pixels, without absent points."""
    for place, text in (
        (f"{path}: line {k}", text) for path in _files(folder) for k, text in enumerate(read_lines(path), 1)
    ):
        label = checked(place, TypeAdapter(_Label), parsed_json(place, text or "null"))
        if any(len(columns) != len(label.h_samples) for columns in label.lanes):
            raise DumpError(f"{place}: expected a column of each lane at each of h_samples")
        lines = [np.column_stack((columns, label.h_samples)) for columns in label.lanes]
        if image := named_file(f"{place}: raw_file", folder, label.raw_file):
            yield image, [line[line[:, 0] >= 0] for line in lines]
