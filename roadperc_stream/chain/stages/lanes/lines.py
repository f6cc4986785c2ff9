"""Straight lane lines in the image: the course's method.

Separator mask -> edges (Canny 1986) -> probabilistic Hough lines (Matas et al. 2000) -> the near-horizontal ones and
those off the road dropped -> merged by slope and intercept -> drawn from the image's bottom to the road's far end.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from roadperc_stream.core.config import LanesConfig, scaled
from roadperc_stream.core.datatypes import Image, Line, Mask
from roadperc_stream.core.geometry import Float

_ON_ROAD = 0.5
_ROAD_MARGIN_PX = 2.0
_MIN_VERTICAL = 1e-6


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
    """The separators' mask behind a median filter that removes salt noise and slivers."""
    size = round(scaled(cfg.median_px, separators.shape[0]))
    if size < 2:
        return separators
    return np.asarray(cv2.medianBlur(separators, size | 1), np.uint8)


def edges_of(cfg: LanesConfig, separators: Image) -> Image:
    """(H, W) uint8, 255 at the edges of (H, W) separators, which are 255 in 0."""
    mask = without_salt(cfg, separators)
    return np.asarray(cv2.Canny(mask, cfg.canny_low, cfg.canny_high, apertureSize=cfg.canny_aperture), np.uint8)


def propose(cfg: LanesConfig, edges: Image) -> Float:
    """(N, 4) x1, y1, x2, y2 of Hough lines along edges.

    Args:
        cfg: thresholds, for 960 rows.
        edges: (H, W) uint8, 255 at edges.
    """
    scale = scaled(1.0, edges.shape[0])
    found = cv2.HoughLinesP(
        edges,
        cfg.hough_rho_px * scale,
        np.radians(cfg.hough_theta_deg),
        max(round(cfg.hough_threshold * scale), 1),
        minLineLength=cfg.hough_min_length_px * scale,
        maxLineGap=cfg.hough_max_gap_px * scale,
    )
    return np.empty((0, 4)) if found is None else found.reshape(-1, 4).astype(float)


def on_road(cfg: LanesConfig, proposals: Float, drivable: Mask) -> Float:
    """The (M, 4) proposals that are steep enough and lie on the (H, W) drivable surface for over half of their length.

    The surface is widened by a pixel or two, for a curb's edge lies just outside it.
    """
    steep = proposals[_steep(cfg, proposals)]
    widened = _widened(drivable)
    return np.array([line for line in steep if _share_on(line, widened) > _ON_ROAD]).reshape(-1, 4)


def merge(cfg: LanesConfig, proposals: Float, rows: int) -> tuple[LineGroup, ...]:
    """Proposals joined greedily: each goes to the first group whose first line has nearly its slope and intercept."""
    reach = scaled(cfg.merge_intercept_px, rows)
    groups: list[list[tuple[float, float, float, float]]] = []
    for x1, y1, x2, y2 in proposals.tolist():
        slope = (y2 - y1) / _nonzero(x2 - x1)
        intercept = y1 - slope * x1
        line = (slope, intercept, min(y1, y2), max(y1, y2))
        for group in groups:
            if abs(group[0][0] - slope) < cfg.merge_slope and abs(group[0][1] - intercept) < reach:
                group.append(line)
                break
        else:
            groups.append([line])
    return tuple(_mean(group) for group in groups)


def drawn(group: LineGroup, bottom: float, far: float) -> Line:
    """The line from the image's bottom edge to the road's far end, pixels."""
    return group.x(bottom), bottom, group.x(far), far


def road_far_end(drivable: Mask, columns_share: float = 0.01) -> int | None:
    """Topmost row in which at least a hundredth of the columns is road; None without any road.

    One row less exact than the first pixel, but a speck of noise in the sky does not move it.
    """
    rows = np.flatnonzero(np.count_nonzero(drivable, axis=1) >= max(columns_share * drivable.shape[1], 1))
    return int(rows[0]) if len(rows) else None


def _mean(lines: list[tuple[float, float, float, float]]) -> LineGroup:
    slope, intercept = np.mean([line[:2] for line in lines], axis=0)
    return LineGroup(float(slope), float(intercept), min(line[2] for line in lines), max(line[3] for line in lines))


def _nonzero(dx: float) -> float:
    return dx if abs(dx) > _MIN_VERTICAL else _MIN_VERTICAL


def _steep(cfg: LanesConfig, lines: Float) -> Mask:
    """Where |slope| reaches the minimum; a vertical line is steep, one within a single row is not."""
    dx, dy = np.abs(lines[:, 2] - lines[:, 0]), np.abs(lines[:, 3] - lines[:, 1])
    steep: Mask = (dy > 0) & (dy >= cfg.min_slope * dx)
    return steep


def _widened(drivable: Mask) -> Image:
    radius = max(round(scaled(_ROAD_MARGIN_PX, drivable.shape[0])), 1)
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return np.asarray(cv2.dilate(drivable.view(np.uint8), kernel), np.uint8)


def _share_on(line: Float, drivable: Image) -> float:
    x1, y1, x2, y2 = line
    count = int(max(abs(x2 - x1), abs(y2 - y1))) + 1
    columns = np.rint(np.linspace(x1, x2, count)).astype(int)
    rows = np.rint(np.linspace(y1, y2, count)).astype(int)
    return float(drivable[rows, columns].mean())
