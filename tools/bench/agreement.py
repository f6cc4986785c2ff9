"""Whether the course's method and the chain find the same: a comparison of times says nothing otherwise."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.api import frames
from roadperc_stream.errors import LogError
from roadperc_stream.model import Absent, Boundary, Side

from .course import Course, CourseResult, Times, ego_lines
from .course_log import Array, read_messages

LARGEST_TILT_DEG: Final = 0.1
LARGEST_HEIGHT_M: Final = 0.01
LARGEST_COLUMNS: Final = 0.01
"""Of the image's width, at the image's bottom and where the road ends."""
LEAST_COVERED: Final = 0.97
"""Of the pixels that the chain finds drivable; it leaves out what is no road by its class."""


@dataclass(frozen=True)
class Disagreement:
    """What the two give differently in a frame.

    ``lines_px`` has a value for each boundary that both see, ``covered`` is the share of the pixels that the chain
    finds drivable which the course's method does, too.
    """

    tilt_deg: float
    height_m: float
    lines_px: tuple[float, ...]
    covered: float


def require_agreement(log: Path, count: int) -> list[Disagreement]:
    """Check the first frames of a log.

    Returns:
        The differences of each.

    Raises:
        LogError: a plane or a line differs by more than this module's limits, or no frame shows both.
    """
    stream = read_messages(log)
    course: Course | None = None
    found: list[Disagreement] = []
    for messages, frame in zip(stream, frames(log, max_frames=count), strict=False):
        course = Course(messages, Times()) if course is None else course
        surface, lanes, drivable = frame.result.surface, frame.result.lanes, frame.result.drivable
        if isinstance(surface, Absent) or isinstance(lanes, Absent) or isinstance(drivable, Absent):
            raise LogError(f"{log}: frame {len(found)}: the chain finds no road or no lane, nothing to compare with")
        expected = np.append(surface.plane.n, surface.plane.offset_m)
        difference = difference_of(course.step(messages), expected, lanes.boundaries, drivable)
        _require(difference, f"{log}: frame {len(found)}", frame.input.camera.width)
        found.append(difference)
    if not any(difference.lines_px for difference in found):
        raise LogError(f"{log}: in none of {len(found)} frames both find a line")
    return found


def difference_of(
    course: CourseResult, plane: Array, boundaries: tuple[Boundary, ...], drivable: Array
) -> Disagreement:
    """What differs between the course's result and the chain's.

    Args:
        course: the one.
        plane: (4,) of the other, its normal of unit length.
        boundaries: of the ego lane, with their lines in the image.
        drivable: (H, W) of the chain: pixels on the plane that are road by their class.
    """
    own = course.plane * np.sign(course.plane[:3] @ plane[:3])
    tilt_deg = float(np.degrees(np.arccos(min(float(own[:3] @ plane[:3]), 1.0))))
    lines: dict[Side, Array | None] = dict(zip(("left", "right"), ego_lines(course.lines, drivable.shape), strict=True))
    apart = (_apart_px(lines[item.side], item) for item in boundaries)
    covered = float(np.mean(course.drivable[drivable]))
    return Disagreement(tilt_deg, abs(float(own[3] - plane[3])), tuple(px for px in apart if px is not None), covered)


def _apart_px(line: Array | None, boundary: Boundary) -> float | None:
    """Columns between the two lines at the image's bottom or at the road's far end, where they are farther apart."""
    if line is None or boundary.raw_px is None:
        return None
    x1, y1, x2, y2 = boundary.raw_px
    slope, intercept = line
    return float(max(abs((y1 - intercept) / slope - x1), abs((y2 - intercept) / slope - x2)))


def _require(difference: Disagreement, where: str, width: int) -> None:
    largest_px = LARGEST_COLUMNS * width
    for what, value, largest, unit in (
        ("the planes' normals", difference.tilt_deg, LARGEST_TILT_DEG, "deg"),
        ("their heights", difference.height_m, LARGEST_HEIGHT_M, "m"),
        ("the lane lines", max(difference.lines_px, default=0.0), largest_px, "px"),
        ("what is drivable", 1 - difference.covered, 1 - LEAST_COVERED, "of its pixels"),
    ):
        if value > largest:
            raise LogError(f"{where}: {what} differ by {value:.3g} {unit}, expected {largest:.3g} at most")
