"""Reads CULane's lists: each line begins with the path of an image, whose true lanes are in a file beside it."""

from collections.abc import Collection
from pathlib import Path, PurePosixPath

import numpy as np

from roadperc_stream.geometry import Float

from .lane_files import FARTHEST_PX, LaneFileError, LaneFrame, image_name


def read_list(path: Path, images: Collection[str], rows: Float) -> list[LaneFrame]:
    """The frames of a list of CULane that are among ``images``, with their true lanes at ``rows``.

    The lists name images from the dataset's folder on: ``/driver_23_30frame/05151640_0419.MP4/00030.jpg``.

    Raises:
        LaneFileError: the list names none of the images, or their lanes are wrong or not below a parent of the list.
        OSError: a file cannot be read.
    """
    lines = [line.split() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    listed = {name: k for k, line in enumerate(lines, 1) if line and (name := image_name(line[0])) in images}
    if not listed:
        example = min(images, default="those of a dataset that roadperc-convert converted")
        raise LaneFileError(f"{path}: names no image of the log; expected names such as {example}")
    labels = {name: PurePosixPath(name).with_suffix(".lines.txt") for name in listed}
    first = next(iter(labels.values()))
    folder = next((folder for folder in path.absolute().parents if (folder / first).is_file()), None)
    if folder is None:
        raise LaneFileError(f"{path}: no {first} in its folder or above it; expected the list of CULane in list/")
    return [_listed(name, folder / labels[name], rows, f"{path}:{k}") for name, k in listed.items()]


def _listed(name: str, path: Path, rows: Float, place: str) -> LaneFrame:
    """A frame of CULane; its lanes are interpolated between their points."""
    lanes = []
    for k, text in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
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
