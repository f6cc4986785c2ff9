"""Reads CULane's lists: each line begins with the path of an image, whose true lanes are in a file beside it."""

import io
from collections.abc import Collection
from pathlib import Path, PurePosixPath
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.system.files import is_inside, read_file

from .lane_files import FARTHEST_PX, LaneFileError, LaneFrame, image_name

_MOST_BYTES: Final = 100_000_000
"""Largest list or file of lanes; the lists of CULane have 10 MB."""


def read_list(path: Path, images: Collection[str], rows: Float) -> list[LaneFrame]:
    """The frames of a list of CULane that are among ``images``, with their true lanes at ``rows``.

    The lists name images from the dataset's folder on: ``/driver_23_30frame/05151640_0419.MP4/00030.jpg``.

    Raises:
        LaneFileError: the list names none of the images, or their lanes are wrong or not below a parent of the list.
        OSError: a file cannot be read.
    """
    lines = ((k, line.split(maxsplit=1)) for k, line in enumerate(_lines_of(path), 1))
    listed = {name: k for k, words in lines if words and (name := image_name(words[0])) in images}
    if not listed:
        example = min(images, default="those of a dataset that roadperc-convert converted")
        raise LaneFileError(f"{path}: names no image of the log; expected names such as {example}")
    labels = {name: PurePosixPath(name).with_suffix(".lines.txt") for name in listed}
    first = next(iter(labels.values()))
    folder = next((folder for folder in path.absolute().parents if (folder / first).is_file()), None)
    if folder is None:
        raise LaneFileError(f"{path}: no {first} in its folder or above it; expected the list of CULane in list/")
    if outside := next((name for name in listed if not is_inside(folder / labels[name], folder)), ""):
        raise LaneFileError(
            f"{path}:{listed[outside]}: {outside} leads out of {folder}; copy the files into this folder"
        )
    return [_listed(name, folder / labels[name], rows, f"{path}:{k}") for name, k in listed.items()]


def _lines_of(path: Path) -> io.StringIO:
    return io.StringIO(read_file(path, _MOST_BYTES).decode("utf-8", "replace"))


def _listed(name: str, path: Path, rows: Float, place: str) -> LaneFrame:
    """A frame of CULane; its lanes are interpolated between their points."""
    lanes = []
    for k, text in enumerate(_lines_of(path), 1):
        try:
            x, y = np.array(text.split(), np.float64).reshape(-1, 2).T
        except ValueError:
            x = y = np.array([np.nan])
        if not (np.abs((x, y)) <= FARTHEST_PX).all():
            raise LaneFileError(f"{path}:{k}: expected pairs of x and y in px, found {text[:60]!r}")
        order = np.argsort(y)
        if len(y):
            columns = np.interp(rows, y[order], x[order], left=np.nan, right=np.nan)
            lanes.append(np.where(columns < 0, np.nan, columns))
    return LaneFrame(name, rows, tuple(lanes), place=place)
