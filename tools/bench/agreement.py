"""Check that the course method and the chain have the same results, so that their times are comparable."""

from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.api import frames
from roadperc_stream.errors import LogError
from roadperc_stream.model import Absent, Boundary, Side

from .course import Array, Course, CourseResult, Times, read_messages

LARGEST_TILT_DEG: Final = 0.1
LARGEST_HEIGHT_M: Final = 0.01
LARGEST_COLUMNS: Final = 0.01
"""Share of the image's width, at the image's bottom and at the far end of the road."""
LEAST_COVERED: Final = 0.97
"""Share of the chain's drivable pixels, which contain only the class road."""


def require_agreement(log: Path, count: int = 3) -> None:
    """Compare the results in the first frames of a log.

    Raises:
        LogError: a result differs by more than this module's limits, or no frame has lines of both.
    """
    course: Course | None = None
    lines = 0
    for index, (messages, frame) in enumerate(zip(read_messages(log), frames(log, max_frames=count), strict=False)):
        course = Course(messages, Times()) if course is None else course
        surface, lanes, drivable = frame.result.surface, frame.result.lanes, frame.result.drivable
        if isinstance(surface, Absent) or isinstance(lanes, Absent) or isinstance(drivable, Absent):
            raise LogError(f"{log}: frame {index}: the chain finds no road or no lane, so there is nothing to compare")
        found = course.step(messages)
        tilt_deg, height_m = plane_difference(found.plane, np.append(surface.plane.n, surface.plane.offset_m))
        apart_px = lines_apart_px(found, lanes.boundaries)
        uncovered = 1 - float(np.mean(found.drivable[drivable]))
        lines += len(apart_px)
        for quantity, value, largest, unit in (
            ("the plane normals", tilt_deg, LARGEST_TILT_DEG, "deg"),
            ("the plane heights", height_m, LARGEST_HEIGHT_M, "m"),
            ("the lane lines", max(apart_px, default=0.0), LARGEST_COLUMNS * frame.input.camera.width, "px"),
            ("the drivable areas", uncovered, 1 - LEAST_COVERED, "of the pixels"),
        ):
            if value > largest:
                where = f"{log}: frame {index}"
                raise LogError(f"{where}: {quantity} differ by {value:.3g} {unit}, expected at most {largest:.3g}")
    if not lines:
        raise LogError(f"{log}: no frame has a lane line in both results")


def plane_difference(course: Array, chain: Array) -> tuple[float, float]:
    """Return the angle between the normals in degrees, and between the offsets in metres, of unit planes (4,)."""
    own = course * np.sign(course[:3] @ chain[:3])
    return float(np.degrees(np.arccos(min(float(own[:3] @ chain[:3]), 1.0)))), abs(float(own[3] - chain[3]))


def lines_apart_px(course: CourseResult, boundaries: tuple[Boundary, ...]) -> list[float]:
    """Return the distance in columns for each boundary in both results: at the image's bottom or the far end."""
    sides: tuple[Side, Side] = ("left", "right")
    lines = dict(zip(sides, ego_lines(course.lines, course.drivable.shape), strict=True))
    apart = []
    for boundary in boundaries:
        line = lines[boundary.side]
        if line is not None and boundary.raw_px is not None:
            x1, y1, x2, y2 = boundary.raw_px
            slope, intercept = line
            apart.append(float(max(abs((y1 - intercept) / slope - x1), abs((y2 - intercept) / slope - x2))))
    return apart


def ego_lines(lines: Array, shape: tuple[int, ...]) -> tuple[Array | None, Array | None]:
    """Return the nearest lines to the left and right of the centre of the image's bottom."""
    height, width = shape[:2]
    at_bottom = (height - 1 - lines[:, 1]) / lines[:, 0] - width / 2
    left, right = np.flatnonzero(at_bottom < 0), np.flatnonzero(at_bottom >= 0)
    return (
        lines[left[np.argmax(at_bottom[left])]] if len(left) else None,
        lines[right[np.argmin(at_bottom[right])]] if len(right) else None,
    )
