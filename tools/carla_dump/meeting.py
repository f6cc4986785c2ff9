"""Where the files' names are stamps: which images have a file of each other sensor, as near as a replay wants it."""

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence

from roadperc_stream.core.config import SyncConfig
from roadperc_stream.core.time import ns_to_seconds, seconds_to_ns
from roadperc_stream.schemas.roles import REFERENCE_ROLES

from .survey import SensorSurvey

TOLERANCE_S = SyncConfig().tolerance_s


def reference_of(sensors: Mapping[str, object]) -> str:
    """The sensor each of whose images makes a frame.

    Args:
        sensors: by role, a camera among them.
    """
    return next(role for role in REFERENCE_ROLES if role in sensors)


def distances_ns(frames_ns: Sequence[int], stamps_ns: Sequence[int]) -> list[int]:
    """How far the nearest stamp of a sensor is from that of each frame.

    Args:
        frames_ns: of the frames.
        stamps_ns: of the sensor, one or more, ascending.
    """
    found = []
    for frame_ns in frames_ns:
        place = bisect_left(stamps_ns, frame_ns)
        found.append(min(abs(ns - frame_ns) for ns in stamps_ns[max(place - 1, 0) : place + 1]))
    return found


def apart_ns(surveys: Mapping[str, SensorSurvey], stamps_ns: Mapping[int, int]) -> dict[str, list[int]]:
    """By role the distances of the nearest stamps that are beyond a replay's tolerance, one for each such frame.

    Args:
        surveys: of the sensors.
        stamps_ns: stamp by the number that is a file's name.
    """
    stamps = {
        role: [stamps_ns[n] for n in sorted(found.sensor.files) if n in stamps_ns] for role, found in surveys.items()
    }
    frames_ns = stamps[reference_of(surveys)]
    limit_ns = seconds_to_ns(TOLERANCE_S)
    return {
        role: [ns for ns in distances_ns(frames_ns, of_role) if ns > limit_ns]
        for role, of_role in stamps.items()
        if of_role
    }


def meeting_notes(
    surveys: Mapping[str, SensorSurvey], apart: Mapping[str, Sequence[int]], frames: int
) -> Iterator[str]:
    """A line for each sensor whose files lie too far from some images."""
    for role, distances in apart.items():
        if distances:
            nearest, farthest = (_seconds(ns) for ns in (min(distances), max(distances)))
            by = nearest if nearest == farthest else f"{nearest} to {farthest}"
            yield (
                f"{surveys[role].sensor.source}: {len(distances)} of {frames} images have no file within "
                f"sync.tolerance_s ({TOLERANCE_S:g} s), the nearest are {by} s apart: "
                "a replay pairs more with --set sync.tolerance_s=SECONDS"
            )


def _seconds(distance_ns: int) -> str:
    return f"{ns_to_seconds(distance_ns):.6f}".rstrip("0").rstrip(".")
