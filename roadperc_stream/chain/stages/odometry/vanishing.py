"""The pitch by the vanishing point of the road's lines: for a car at rest, and for the first frame of a drive.

Lane markings, kerbs and walls run along the road and meet at one point of its horizon. Segments are found by the line
segment detector (Grompone von Gioi et al., "LSD: a Line Segment Detector", IPOL 2012); the point that most of their
length agrees on is chosen among the crossings of pairs and refined by least squares. In a bend, on a wet road full of
reflections and in a yard there is no such point, or another one, and it is refused.
"""

from itertools import combinations
from typing import Final

import cv2
import numpy as np

from roadperc_stream.core.config import scaled
from roadperc_stream.core.datatypes import Image, Mask
from roadperc_stream.core.geometry import Camera, Float, rays

LINES_STD: Final = np.deg2rad(0.6)
"""Standard deviation of the pitch by lines beyond their own: they follow the road, which bends and climbs."""
_STEEPEST: Final = np.deg2rad(8.0)
"""Radians from the horizon that the mounting promises within which the point is searched."""
_WIDEST: Final = 0.5
"""Tangent of the angle to either side of the camera's axis within which it is searched."""
_LEAST_LENGTH_PX: Final = 60.0
_AGREE_PX: Final = 3.0
"""Length of a segment, and distance by which its end may miss the point's line, at 960 rows."""
_LEAST_AGREE_PX: Final = 1.0
"""The latter at least: what the detector is good for."""
_LEAST_SLOPE: Final = 0.15
"""Rows per column below which a segment runs across the view, and crosses the others anywhere."""
_MOST_SEGMENTS: Final = 40
_LEAST_SEGMENTS: Final = 6
_LEAST_SHARE: Final = 0.5
"""Share of the segments' length that must agree."""
_REFINEMENTS: Final = 4
"""The two edges of a marking cross the others beside the point: which segments agree is asked anew each time."""
_SINGULAR: Final = 1e6
_LEAST_SPREAD: Final = 0.5
"""Radians between the segments' directions: those of one bundle cross anywhere along it."""


def pitch_by_lines(
    camera: Camera, ego_T_camera: Float, grey: Image, movable: Image | None
) -> tuple[float, float] | None:
    """By how much more than the mounting says the camera looks down, and the variance of that.

    Args:
        camera: of the image.
        ego_T_camera: its mounting.
        grey: (H, W) the image.
        movable: (H, W) not 0 on what moves, whose lines run anywhere, or None.

    Returns:
        Radians and their square; None where too few lines agree on a point near the horizon.
    """
    segments = _segments(camera, grey, movable)
    if len(segments) < _LEAST_SEGMENTS:
        return None
    points = _crossings(segments)
    elevation, ahead = _elevations(camera, ego_T_camera, points)
    points = points[ahead & (np.abs(elevation) < _STEEPEST)]
    if not len(points):
        return None
    lengths = np.linalg.norm(segments[:, 2:] - segments[:, :2], axis=1)
    agree = np.array([_agreeing(camera, segments, point) for point in points])
    point = points[int(np.argmax(agree @ lengths))]
    for _ in range(_REFINEMENTS):
        chosen = _agreeing(camera, segments, point)
        if np.sum(chosen) < _LEAST_SEGMENTS or lengths[chosen].sum() < _LEAST_SHARE * lengths.sum():
            return None
        fitted = _meeting(segments[chosen], lengths[chosen])
        if fitted is None:
            return None
        point, variance_px = fitted
    elevation, ahead = _elevations(camera, ego_T_camera, point[None])
    if not ahead[0] or abs(elevation[0]) > _STEEPEST:
        return None
    return float(elevation[0]), variance_px / camera.fy**2 + float(LINES_STD) ** 2


def _segments(camera: Camera, grey: Image, movable: Image | None) -> Float:
    """(N, 4) x1, y1, x2, y2 of the longest segments that do not run across the view."""
    found = cv2.createLineSegmentDetector().detect(grey)[0]
    if found is None:
        return np.empty((0, 4))
    segments = np.asarray(found, float).reshape(-1, 4)
    along = segments[:, 2:] - segments[:, :2]
    lengths = np.linalg.norm(along, axis=1)
    upright = np.abs(along[:, 0]) < _LEAST_SLOPE * np.abs(along[:, 1])
    flat = np.abs(along[:, 1]) < _LEAST_SLOPE * np.abs(along[:, 0])
    kept = (lengths > scaled(_LEAST_LENGTH_PX, camera.height)) & ~upright & ~flat
    if movable is not None:
        columns, rows = np.clip(np.rint(segments[:, :2] + along / 2).astype(int), 0, np.array(grey.shape[::-1]) - 1).T
        kept &= movable[rows, columns] == 0
    longest = np.argsort(-lengths[kept], kind="stable")[:_MOST_SEGMENTS]
    return np.asarray(segments[kept][longest])


def _homogeneous(segments: Float) -> Float:
    """(N, 3) lines a x + b y + c = 0 with a and b of unit length."""
    ones = np.ones((len(segments), 1))
    lines = np.cross(np.hstack((segments[:, :2], ones)), np.hstack((segments[:, 2:], ones)))
    return np.asarray(lines / np.linalg.norm(lines[:, :2], axis=1, keepdims=True))


def _crossings(segments: Float) -> Float:
    """(M, 2) pixels where pairs of them cross."""
    lines = _homogeneous(segments)
    i, j = np.array(list(combinations(range(len(lines)), 2))).T
    crossing = np.cross(lines[i], lines[j])
    crossing = crossing[np.abs(crossing[:, 2]) > 1e-3]
    return np.asarray(crossing[:, :2] / crossing[:, 2:])


def _elevations(camera: Camera, ego_T_camera: Float, points: Float) -> tuple[Float, Mask]:
    """(M,) elevations of pixels' rays above ego's x-y plane, radians, and which of them lie about ahead."""
    directions = rays(camera, points) @ ego_T_camera[:3, :3].T
    ahead = (directions[:, 0] > 0) & (np.abs(directions[:, 1]) < _WIDEST * directions[:, 0])
    return np.arctan2(directions[:, 2], np.hypot(directions[:, 0], directions[:, 1])), np.asarray(ahead)


def _agreeing(camera: Camera, segments: Float, point: Float) -> Mask:
    """(N,) segments whose ends lie near the line from their middle to a point."""
    middle, half = (segments[:, :2] + segments[:, 2:]) / 2, (segments[:, 2:] - segments[:, :2]) / 2
    towards = point - middle
    off = np.abs(half[:, 0] * towards[:, 1] - half[:, 1] * towards[:, 0]) / np.linalg.norm(towards, axis=1)
    return np.asarray(off < max(scaled(_AGREE_PX, camera.height), _LEAST_AGREE_PX))


def _meeting(segments: Float, lengths: Float) -> tuple[Float, float] | None:
    """The (2,) point nearest to all lines, each weighed by its length, and the variance of its row, pixels squared."""
    lines = _homogeneous(segments)
    spread = np.ptp(np.arctan2(*(lines[:, k] * np.sign(lines[:, 1]) for k in (0, 1))))
    N = (lines[:, :2] * lengths[:, None]).T @ lines[:, :2]
    if spread < _LEAST_SPREAD or np.linalg.cond(N) > _SINGULAR:
        return None
    point = np.asarray(np.linalg.solve(N, -(lines[:, :2] * lengths[:, None]).T @ lines[:, 2]), np.float64)
    off = lines[:, :2] @ point + lines[:, 2]
    covariance = np.linalg.inv(N) * float(lengths @ off**2) / max(len(lines) - 2, 1)
    return point, float(covariance[1, 1])
