"""TuSimple's lane benchmark: ``label_data_*.json`` beside ``clips/``, whose clips have 20 images in a second.

Each line of a file labels one image, usually the last of its clip: columns of each lane at the rows ``h_samples``, -2
where the lane has none. Clips are unrelated, so each begins two seconds after the end of the one before.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from pydantic import Field, FiniteFloat, TypeAdapter

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float
from roadperc_stream.system.text import number as number_of
from roadperc_stream.system.time import NS_PER_S

from ..carla_dump.frame_stamps import EPOCH_NS
from ..carla_dump.json_files import Document, checked, read_lines
from ..carla_dump.layout import Sensor, sensor_in
from ..carla_dump.survey import surveyed
from .drive import ConvertOptions, Drive
from .lane_labels import labelled_rig

_LABELS: Final = ("label_data_*.json", "test_label*.json")
_RATE_HZ: Final = 20.0
_PAUSE_S: Final = 2.0
_CLIP: Final = 1000
"""Numbers of images in a clip; the first clip has the numbers 0 to 999."""
_Pixel = Annotated[FiniteFloat, Field(ge=-1e6, le=1e6)]


class _Label(Document):
    raw_file: str
    lanes: list[list[_Pixel]]
    h_samples: list[_Pixel]


def detect(folder: Path) -> bool:
    """Return True if the folder has files of labels and ``clips``."""
    return bool(_files(folder)) and (folder / "clips").is_dir()


def read(folder: Path, options: ConvertOptions) -> Drive:
    """Read the labelled clips; ``--sequence`` chooses those whose path below ``clips`` begins with it.

    Raises:
        DumpError: a line is no label, or no labelled image exists; the message names file and line.
    """
    options.require_only(folder, "--sequence", "--fov", "--calibration", "--height", "--rate")
    rate_hz, wanted = options.rate_hz or _RATE_HZ, options.sequence or ""
    labels = {image: lines for image, lines in _labels(folder) if _clip_of(folder, image).startswith(wanted)}
    clips = sorted({image.parent for image in labels if image.is_file()})
    if not clips:
        raise DumpError(f"{folder}: the labels name no image in clips/{wanted}")
    missing = sum(not image.is_file() for image in labels)
    files: dict[int, Path] = {}
    stamps_ns: dict[int, int] = {}
    begin_ns = EPOCH_NS
    for place, clip in enumerate(clips):
        for number, path in sorted(sensor_in(clip, "image").files.items()):
            files[place * _CLIP + number] = path
            stamps_ns[place * _CLIP + number] = begin_ns + round(number * NS_PER_S / rate_hz)
        begin_ns = max(stamps_ns.values()) + round(_PAUSE_S * NS_PER_S)
    surveys = surveyed({"image": Sensor("image", "clips", files)})
    lines_px = {number: labels[path] for number, path in files.items() if path in labels}
    rig, truth, notes = labelled_rig(folder, options, surveys["image"].size, lines_px)
    return Drive(
        folder=folder,
        title=f"TuSimple, {number_of(len(clips), 'clip')}",
        surveys=surveys,
        stamps_ns=stamps_ns,
        timing=f"{rate_hz:g} Hz in a clip, {_PAUSE_S:g} s between clips",
        rig=rig,
        truth=truth,
        notes=(*notes, *[f"{missing} labelled images are not in clips/: left out"] * bool(missing)),
    )


def _files(folder: Path) -> list[Path]:
    return sorted(path for pattern in _LABELS for path in folder.glob(pattern))


def _clip_of(folder: Path, image: Path) -> str:
    return image.parent.relative_to(folder).as_posix().removeprefix("clips/")


def _labels(folder: Path) -> Iterator[tuple[Path, list[Float]]]:
    """Yield the labelled images and their lines in pixels, without absent points."""
    for path in _files(folder):
        for k, text in enumerate(read_lines(path), 1):
            if not text.strip():
                continue
            place = f"{path}: line {k}"
            try:
                label = checked(place, TypeAdapter(_Label), json.loads(text))
            except ValueError as error:
                raise DumpError(f"{place}: not JSON: {error}") from error
            if (
                any(len(columns) != len(label.h_samples) for columns in label.lanes)
                or ".." in Path(label.raw_file).parts
            ):
                raise DumpError(
                    f"{place}: expected raw_file below clips, and a column of each lane at each of h_samples"
                )
            lines = [np.column_stack((columns, label.h_samples)) for columns in label.lanes]
            yield folder / label.raw_file, [line[line[:, 0] >= 0] for line in lines]
