"""Straight lane lines in the image: the course's method.

Mask of the separators -> edges (Canny 1986) -> probabilistic Hough lines (Matas et al. 2000) -> drop nearly horizontal
lines and lines off the road -> merge by slope and intercept -> draw from the image's bottom to the road's far end.

Edges and lines are searched in every second row and column if the median filter leaves nothing narrower.
"""

from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import LanesConfig, scaled
from roadperc_stream.geometry import Float
from roadperc_stream.model import Image, Line, Mask

_ON_ROAD = 0.5
_SAMPLES = 64
"""Points along a line that decide whether it is on the road."""
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
_COARSE_PX = 5
"""Size of the median filter from which on every second row and column suffices: it leaves nothing below 3 px."""


Coordinate = TypeVar("Coordinate", float, Float)


@dataclass(frozen=True)
class LineGroup:
    """Merged proposals: x = (y - intercept) / slope, and the rows between which proposals support it."""

    slope: float
    intercept: float
    top_px: float
    bottom_px: float

    def x(self, y: Coordinate) -> Coordinate:
        """Column at a row, or columns at (N,) rows, pixels."""
        return (y - self.intercept) / self.slope


def pixel_step(cfg: LanesConfig, rows: int) -> int:
    """2 if the median filter of an image with this many rows would remove what every second pixel misses, else 1."""
    return 2 if scaled(cfg.median_px, rows) >= _COARSE_PX else 1


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


def propose(cfg: LanesConfig, edges: Image, visible: float = 1.0, step: int = 1) -> Float:
    """(N, 4) x1, y1, x2, y2 of Hough lines along (H, W) uint8 edges of 255. The thresholds are for 960 rows.

    ``visible`` is the visible share of the lines' length; lines may be shorter by this factor. ``step`` is the
    ``pixel_step`` of the edges: their places are rounded to so many pixels, and bins are wider by the difference.
    """
    scale = scaled(1.0, edges.shape[0])
    shortest = scale * visible
    found = cv2.HoughLinesP(
        edges,
        cfg.hough_rho_px * scale + (step - 1) / step,
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
    steep: Float = proposals[(dy > 0) & (dy >= _MIN_SLOPE * dx)]
    margin_px = max(round(scaled(_ROAD_MARGIN_PX, drivable.shape[0])), 1)
    if not len(steep):
        return steep
    along = np.linspace(0.0, 1.0, _SAMPLES)[:, None, None]
    columns, rows = np.rint((1.0 - along) * steep[:, :2] + along * steep[:, 2:]).astype(int).transpose(2, 0, 1)
    left, top = max(columns.min() - margin_px, 0), max(rows.min() - margin_px, 0)
    near = drivable[top : rows.max() + margin_px + 1, left : columns.max() + margin_px + 1].view(np.uint8)
    widened = cv2.dilate(near, np.ones((2 * margin_px + 1, 2 * margin_px + 1), np.uint8))
    kept: Float = steep[widened[rows - top, columns - left].mean(axis=0) > _ON_ROAD]
    return kept


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


def road_rows(drivable: Mask) -> tuple[int, int] | None:
    """The topmost row of the road, and the row below which the car's own bonnet hides it; None without any road.

    At least a hundredth of the columns of the topmost row is road. This is less exact than the first road pixel, but
    noise in the sky does not affect it. If nothing hides the road, the second number is that of the image's rows.
    """
    height, width = drivable.shape
    columns = _row_sums(drivable.view(np.uint8))
    far = np.flatnonzero(columns >= max(_ROAD_COLUMNS * width, 1))
    if not len(far):
        return None
    near = np.flatnonzero(columns >= _NEAR_COLUMNS * width)
    return int(far[0]), int(near[-1]) + 1 if len(near) and near[-1] < _HIDDEN_BELOW * height else height


def _row_sums(image: Image) -> NDArray[np.int32]:
    """(H,) sums of the rows, twenty times as fast as NumPy's for booleans."""
    return np.asarray(cv2.reduce(image, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S), np.int32).ravel()


def visible_share(far: int, bottom: int, height: int) -> float:
    """The share of the rows below the road's far end that a bonnet leaves visible, at least ``_LEAST_VISIBLE``."""
    return max((bottom - far) / (height - far), _LEAST_VISIBLE) if bottom < height else 1.0


def _mean(lines: list[tuple[float, float, float, float]]) -> LineGroup:
    slopes, intercepts, tops, bottoms = zip(*lines, strict=True)
    return LineGroup(sum(slopes) / len(lines), sum(intercepts) / len(lines), min(tops), max(bottoms))
