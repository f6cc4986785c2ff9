"""Boxes of a detector: decoding, and removal of duplicates and of boxes that cannot be objects."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.mosaic import areas, overlaps, shared_areas
from roadperc_stream.geometry import Float, Float32
from roadperc_stream.model import Box, Detection

from .description import DetectionKeys, Network
from .session import require_output

_IN_ANOTHER: Final = 0.8
"""Share of a box inside another one of its class, from which both are the same object."""
_MOST: Final = 1000
"""Boxes with the best scores that count in one frame."""


@dataclass(frozen=True)
class Boxes:
    """N boxes: corners (N, 4) in pixels, scores (N,), and numbers of their classes (N,)."""

    corners: Float
    scores: Float
    classes: NDArray[np.int64]

    def of(self, rows: NDArray[np.generic]) -> "Boxes":
        """The boxes at some positions, or those of a mask."""
        return Boxes(self.corners[rows], self.scores[rows], self.classes[rows])

    def with_others(self, others: "Boxes") -> "Boxes":
        """These boxes and others."""
        pairs = zip(vars(self).values(), vars(others).values(), strict=True)
        return Boxes(*(np.concatenate(pair) for pair in pairs))


def decoded(network: Network, keys: DetectionKeys, outputs: list[Float32]) -> Boxes:
    """Return the boxes of the wanted classes above ``min_score``, in pixels of the input, the best first.

    Raises:
        ConfigError: an output has another shape than the decoder expects.
    """
    found = _joined(network, outputs) if keys.decoder == "boxes" else _scored(network, keys, outputs[0])
    wanted = np.isin(found.classes, list(keys.classes)) & (found.scores >= keys.min_score)
    found = found.of(wanted & np.isfinite(found.corners).all(axis=1))
    return found.of(np.argsort(-found.scores, kind="stable")[:_MOST])


def _joined(network: Network, outputs: list[Float32]) -> Boxes:
    """Boxes that the model has decoded: rows of four corners, score, class; or corners, scores and classes apart."""
    flat = [output.reshape(-1, max(output.shape[-1], 1) if output.ndim > 1 else 1) for output in outputs]
    if len(outputs) == 3:  # boxes, scores, classes
        flat = [flat[0], *(output.reshape(-1, 1) for output in flat[1:])]
    columns = sum(output.shape[1] for output in flat)
    fits = columns == 6 and len({len(output) for output in flat}) == 1
    expected = "[1, N, 6], or [N, 4] with [N] scores and [N] classes"
    require_output(network, "of boxes", outputs[0].shape, expected, fits=fits)
    rows = np.concatenate(flat, axis=1).astype(np.float64)
    return Boxes(rows[:, :4], rows[:, 4], rows[:, 5].astype(np.int64))


def _scored(network: Network, keys: DetectionKeys, output: Float32) -> Boxes:
    """Boxes of YOLO: centre and size, YOLOX's objectness, and the scores of all classes.

    Source of the grids: Ge et al., YOLOX: Exceeding YOLO Series in 2021, and its ``demo_postprocess``.
    """
    grids = _grids(network, keys) if keys.decoder == "yolo_grid" else None
    before = 4 if grids is None else 5  # values of a box before its class scores
    rows = output[0].astype(np.float64) if output.ndim == 3 else np.zeros((0, 0))
    rows = rows.T if grids is None else rows
    least = before + max(keys.classes) + 1
    fits = rows.shape[1] >= least and (grids is None or len(grids) == len(rows))
    expected = f"[1, {least} or more, N]" if grids is None else f"[1, {len(grids)}, {least} or more]"
    require_output(network, "of boxes", output.shape, expected, fits=fits)
    best = rows[:, before:].argmax(axis=1)
    scores = rows[np.arange(len(rows)), before + best]
    centre, size = rows[:, :2], rows[:, 2:4]
    if grids is not None:
        centre = (centre + grids[:, :2]) * grids[:, 2:]
        size = np.exp(np.minimum(size, 20.0)) * grids[:, 2:]
        scores = scores * rows[:, 4]
    return Boxes(np.hstack((centre - size / 2, centre + size / 2)), scores, best.astype(np.int64))


def _grids(network: Network, keys: DetectionKeys) -> Float:
    """(N, 3) column, row and stride of each cell."""
    columns, rows = network.keys.input.size
    cells = []
    for stride in keys.strides:
        row, column = np.mgrid[: rows // stride, : columns // stride]
        cells.append(np.column_stack((column.ravel(), row.ravel(), np.full(row.size, stride))))
    return np.concatenate(cells).astype(np.float64)


def without_duplicates(keys: DetectionKeys, boxes: Boxes) -> Boxes:
    """Return the boxes without those that overlap a better one, or are nested with a better one of the same class."""
    boxes = boxes.of(np.argsort(-boxes.scores, kind="stable"))
    sides = boxes.corners.T
    together = overlaps(sides, sides) > keys.max_overlap
    smaller = np.minimum(areas(sides)[:, None], areas(sides))
    nested = shared_areas(sides, sides) > _IN_ANOTHER * smaller
    together |= nested & (boxes.classes[:, None] == boxes.classes)
    kept = np.zeros(len(sides[0]), bool)
    for row in range(len(kept)):
        kept[row] = not (together[row] & kept).any()
    return boxes.of(kept)


def possible(keys: DetectionKeys, boxes: Boxes, size: tuple[int, int]) -> Boxes:
    """Return the boxes without large ones and those on the own bonnet, in an image of ``size`` (columns, rows)."""
    sides = boxes.corners.T
    area = areas(sides)
    above_bonnet = sides[3] <= keys.ignore_below * size[1]
    return boxes.of(np.asarray((area > 0) & (area <= keys.max_area * size[0] * size[1]) & above_bonnet))


def of_tile(boxes: Boxes, corner: tuple[int, int], size: tuple[int, int]) -> Boxes:
    """Return the boxes of a tile in pixels of the image, without those that the tile's edge cuts.

    ``corner`` is the column and row of the tile's first pixel, ``size`` its columns and rows.
    """
    uncut = np.all((boxes.corners > 0) & (boxes.corners < np.tile(size, 2)), axis=1)
    return replace(boxes, corners=boxes.corners + np.tile(corner, 2)).of(np.asarray(uncut))


def detections(keys: DetectionKeys, boxes: Boxes) -> tuple[Detection, ...]:
    """Return the boxes as detections with their labels."""
    rows = zip(boxes.corners.tolist(), boxes.scores.tolist(), boxes.classes.tolist(), strict=True)
    return tuple(Detection(keys.classes[number], Box(*box), score) for box, score, number in rows)
