"""Straight lane lines in the image: the course's method.

Mask of the separators -> edges (Canny 1986) -> probabilistic Hough lines (Matas et al. 2000) -> drop nearly horizontal
lines and lines off the road -> merge by slope and intercept -> draw from the image's bottom to the road's far end.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import LanesConfig, scaled
from roadperc_stream.geometry import Float
from roadperc_stream.model import Image, Line, Mask

_ON_ROAD = 0.5
_ROAD_MARGIN_PX = 2.0
_ROAD_COLUMNS = 0.01
"""Minimum share of road columns in a row that shows the road."""
_NEAR_COLUMNS = 0.1
"""Minimum share of road columns in a row near the car; blobs of wrong tags cover less."""
_HIDDEN_BELOW = 0.85
"""Share of the rows: if no row below it shows the road, a bonnet hides it."""
_LEAST_VISIBLE = 0.4
"""Least factor of the length of lines above a bonnet; shorter ones are blobs of wrong tags."""
_MIN_VERTICAL = 1e-6
_HOUGH_THETA_DEG = 1.0
"""Resolution of the angle in the Hough transform: 2 px over the length of the shortest line, 100 px."""
_MIN_SLOPE = 0.3
"""Rows per column below which a line is too flat in the image for a boundary of the ego lane."""
_MERGE_SLOPE = 0.1
_MERGE_INTERCEPT_PX = 40.0
"""Largest differences of slope, and of the row at the image's left edge at 960 rows, of lines that are merged."""
_AROUND_PX = 5
"""Rows around a mask that affect its edges: half of the largest Sobel filter, and Canny's neighbours."""


@dataclass(frozen=True)
class LineGroup:
    """Merged proposals: x = (y - intercept) / slope, and the rows between which proposals support it."""

    slope: float
    intercept: float
    top_px: float
    bottom_px: float

    def x(self, y: float) -> float:
        """Column at a row, pixels."""
        return (y - self.intercept) / self.slope


def without_salt(cfg: LanesConfig, separators: Image) -> Image:
    """(H, W) 255 at separators after a median filter, which removes salt noise and slivers; ``separators`` are 1.

    The median of ones and zeros is the value of more than half of the pixels; counting is faster than sorting.
    """
    size = max(round(scaled(cfg.median_px, separators.shape[0])), 1) | 1
    depth = cv2.CV_8U if size**2 <= np.iinfo(np.uint8).max else cv2.CV_32F
    part = _rows_around(separators, size // 2 + 1)
    if part is None:
        return np.zeros(separators.shape, np.uint8)
    count = cv2.boxFilter(separators[part], depth, (size, size), normalize=False, borderType=cv2.BORDER_REPLICATE)
    return _with_rows(separators.shape, part, cv2.threshold(count, size**2 // 2, 255, cv2.THRESH_BINARY)[1])


def edges_of(cfg: LanesConfig, separators: Image) -> Image:
    """(H, W) uint8, 255 at the edges of (H, W) separators, which are 1; searched only in rows with separators."""
    mask = without_salt(cfg, separators)
    part = _rows_around(mask, _AROUND_PX)
    if part is None:
        return mask
    edges = cv2.Canny(mask[part], cfg.canny_low, cfg.canny_high, apertureSize=cfg.canny_aperture)
    return _with_rows(mask.shape, part, edges)


def _rows_around(mask: Image, margin: int) -> slice | None:
    """The rows from the first to the last nonzero one, widened by a margin; None if all are zero."""
    marked = np.flatnonzero(_row_sums(mask))
    return slice(max(int(marked[0]) - margin, 0), int(marked[-1]) + 1 + margin) if len(marked) else None


def _with_rows(shape: tuple[int, ...], part: slice, rows: NDArray[Any]) -> Image:
    """(H, W) uint8 with these values in a part of its rows and 0 in all others."""
    image = np.empty(shape, np.uint8)
    image[: part.start], image[part], image[part.stop :] = 0, rows, 0
    return image


def propose(cfg: LanesConfig, edges: Image, visible: float = 1.0) -> Float:
    """(N, 4) x1, y1, x2, y2 of Hough lines along (H, W) uint8 edges of 255. The thresholds are for 960 rows.

    ``visible`` is the visible share of the lines' length; lines may be shorter by this factor.
    """
    scale = scaled(1.0, edges.shape[0])
    shortest = scale * visible
    found = cv2.HoughLinesP(
        edges,
        cfg.hough_rho_px * scale,
        np.radians(_HOUGH_THETA_DEG),
        max(round(cfg.hough_threshold * shortest), 1),
        minLineLength=cfg.hough_min_length_px * shortest,
        maxLineGap=cfg.hough_max_gap_px * scale,
    )
    return np.empty((0, 4)) if found is None else found.reshape(-1, 4).astype(float)


def on_road(proposals: Float, drivable: Mask) -> Float:
    """The (M, 4) proposals that are steep enough and lie on the (H, W) drivable surface for over half of their length.

    A vertical line is steep; a line within one row is not. The surface is widened by a pixel or two because the edge of
    a kerb lies just outside it.
    """
    dx, dy = np.abs(proposals[:, 2:] - proposals[:, :2]).T
    steep = proposals[(dy > 0) & (dy >= _MIN_SLOPE * dx)]
    margin_px = max(round(scaled(_ROAD_MARGIN_PX, drivable.shape[0])), 1)
    kept: Float = steep[line_shares(steep, drivable, margin_px) > _ON_ROAD]
    return kept


def line_shares(lines: Float, mask: Mask, margin_px: int) -> Float:
    """(N,) shares of (N, 4) lines x1, y1, x2, y2 that lie on an (H, W) mask, widened by a margin on all sides.

    A line has one pixel for every column, or for every row if it is steep.
    """
    if not len(lines):
        return np.empty(0)
    start, end = lines[:, :2], lines[:, 2:]
    steps = np.abs(end - start).max(axis=1).astype(int)
    first = np.cumsum(steps + 1) - (steps + 1)
    owner = np.repeat(np.arange(len(lines)), steps + 1)
    along = np.arange(len(owner)) - first[owner]
    places = along[:, None] * ((end - start) / np.maximum(steps, 1)[:, None])[owner] + start[owner]
    places[first + steps] = end
    columns, rows = np.rint(places).astype(int).T
    left, top = max(columns.min() - margin_px, 0), max(rows.min() - margin_px, 0)
    near = mask[top : rows.max() + margin_px + 1, left : columns.max() + margin_px + 1].view(np.uint8)
    widened = cv2.dilate(near, np.ones((2 * margin_px + 1, 2 * margin_px + 1), np.uint8))
    shares: Float = np.add.reduceat(widened[rows - top, columns - left], first, dtype=float) / (steps + 1)
    return shares


def merge(proposals: Float, rows: int) -> tuple[LineGroup, ...]:
    """Proposals joined greedily: each goes to the first group whose first line has nearly its slope and intercept."""
    reach = scaled(_MERGE_INTERCEPT_PX, rows)
    groups: list[list[tuple[float, float, float, float]]] = []
    for x1, y1, x2, y2 in proposals.tolist():
        dx = x2 - x1 if abs(x2 - x1) > _MIN_VERTICAL else _MIN_VERTICAL
        slope = (y2 - y1) / dx
        intercept = y1 - slope * x1
        line = (slope, intercept, min(y1, y2), max(y1, y2))
        for group in groups:
            if abs(group[0][0] - slope) < _MERGE_SLOPE and abs(group[0][1] - intercept) < reach:
                group.append(line)
                break
        else:
            groups.append([line])
    return tuple(_mean(group) for group in groups)


def drawn(group: LineGroup, bottom: float, far: float) -> Line:
    """The line from the image's bottom edge to the road's far end, pixels."""
    return group.x(bottom), bottom, group.x(far), far


def road_far_end(drivable: Mask) -> int | None:
    """Topmost row in which at least a hundredth of the columns is road; None without any road.

    This is less exact than the first road pixel, but noise in the sky does not affect it.
    """
    rows = np.flatnonzero(_row_sums(drivable.view(np.uint8)) >= max(_ROAD_COLUMNS * drivable.shape[1], 1))
    return int(rows[0]) if len(rows) else None


def road_near_end(drivable: Mask) -> int:
    """The row below which the car's own bonnet hides the road; the image's bottom edge if nothing hides it."""
    height, width = drivable.shape
    rows = np.flatnonzero(_row_sums(drivable.view(np.uint8)) >= _NEAR_COLUMNS * width)
    return int(rows[-1]) + 1 if len(rows) and rows[-1] < _HIDDEN_BELOW * height else height


def visible_share(far: int, bottom: int, height: int) -> float:
    """The share of the rows below the road's far end that a bonnet leaves visible, at least ``_LEAST_VISIBLE``."""
    return max((bottom - far) / (height - far), _LEAST_VISIBLE) if bottom < height else 1.0


def _row_sums(image: Image) -> NDArray[np.int32]:
    """(H,) sums of the rows, twenty times as fast as NumPy's for booleans."""
    return np.asarray(cv2.reduce(image, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S), np.int32).ravel()


def _mean(lines: list[tuple[float, float, float, float]]) -> LineGroup:
    slope, intercept = np.mean([line[:2] for line in lines], axis=0)
    return LineGroup(float(slope), float(intercept), min(line[2] for line in lines), max(line[3] for line in lines))
