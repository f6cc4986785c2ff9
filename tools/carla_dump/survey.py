"""A sensor's files by their headers: what can be read, in which size, and what is counted as missing.

Where the names of files are stamps, also which images have a file of each other sensor near enough for a replay.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from roadperc_stream.config import SyncConfig
from roadperc_stream.errors import DumpError
from roadperc_stream.schemas.roles import REFERENCE_ROLES
from roadperc_stream.system.time import ns_to_seconds, seconds_to_ns

from .camera_rig import CAMERA_ROLES, LIDAR
from .image_files import UnreadableFrameError, read_header
from .layout import Sensor
from .pixel_files import file_size
from .point_files import load_points, points_kind


@dataclass(frozen=True)
class SensorSurvey:
    """A sensor's files that can be read, as far as their headers tell, and the faults of those that cannot."""

    sensor: Sensor
    unreadable: tuple[str, ...]
    sizes: Mapping[int, tuple[int, int]]
    """Columns and rows by frame; empty where only reading everything tells."""
    encoding: str = ""

    @property
    def size(self) -> tuple[int, int] | None:
        """Columns and rows of most frames, of equally many the first's."""
        return next((size for size, _ in Counter(self.sizes.values()).most_common(1)), None)

    @property
    def paths(self) -> list[Path]:
        """Files in the order of frames."""
        return list(self.sensor.files.values())


def front_sensors(sensors: Mapping[str, Sensor]) -> tuple[dict[str, Sensor], str]:
    """The sensors, the left camera standing as the front one where there is no other, and what to tell of it.

    Raises:
        DumpError: no camera among them.
    """
    if not any(role in sensors for role in CAMERA_ROLES):
        raise DumpError(f"no camera found, only {', '.join(s.source for s in sensors.values())}")
    kept = dict(sensors)
    left = kept.pop("left", None)
    if left is None:
        return kept, ""
    if "image" not in kept:
        return {"image": replace(left, role="image"), **kept}, f"{left.source}: the left camera is the front camera"
    if _same_files(kept["image"].files, left.files):
        return kept, f"{left.source} holds the same images as {kept['image'].source}: not stored twice"
    return dict(sensors), ""


def _same_files(ours: Mapping[int, Path], theirs: Mapping[int, Path]) -> bool:
    """Whether both hold the same frames, by sizes and by the first frame's bytes."""
    if ours.keys() != theirs.keys():
        return False
    same_sizes = all(ours[number].stat().st_size == theirs[number].stat().st_size for number in ours)
    return same_sizes and ours[min(ours)].read_bytes() == theirs[min(theirs)].read_bytes()


def survey(sensor: Sensor) -> SensorSurvey:
    """Look at every file's header: what is empty, cut off or foreign is counted as missing.

    Raises:
        DumpError: not one file of the sensor can be read.
    """
    files: dict[int, Path] = {}
    sizes: dict[int, tuple[int, int]] = {}
    faults: list[str] = []
    kinds = Counter[str]()
    for number, path in sorted(sensor.files.items()):
        try:
            size, kind = _header(sensor.role, path)
        except UnreadableFrameError as error:
            faults.append(str(error))
            continue
        files[number] = path
        kinds[kind] += 1
        sizes |= {} if size is None else {number: size}
    if not files:
        raise DumpError(f"{sensor.source}: none of {len(faults)} files can be read; {faults[0]}")
    return SensorSurvey(replace(sensor, files=files), tuple(faults), sizes, _counted(kinds))


def points_fault(sensor: Sensor, frames: Collection[int]) -> str:
    """Why no frame gets points of a lidar; empty where at least one does.

    The files are read until one holds points: their first bytes alone do not tell.

    Args:
        sensor: the lidar's files.
        frames: numbers of the frames that have an image.
    """
    faults = []
    for number, path in sorted(sensor.files.items()):
        if number in frames:
            try:
                load_points(path)
            except UnreadableFrameError as error:
                faults.append(str(error))
                continue
            return ""
    if not faults:
        return f"none of its {len(sensor.files)} frames has an image"
    return f"none of {len(faults)} files can be read; {faults[0]}"


def _header(role: str, path: Path) -> tuple[tuple[int, int] | None, str]:
    """Columns and rows, where the header tells, and a description."""
    if role == LIDAR:
        return None, points_kind(path)
    if role in ("image", "left", "right"):
        return read_header(path)
    return file_size(path), ""


def _counted(kinds: Counter[str]) -> str:
    if len(kinds) == 1:
        return next(iter(kinds))
    return ", ".join(f"{kind} ({count})" for kind, count in kinds.most_common())


def of_size(found: SensorSurvey, expected: tuple[int, int]) -> SensorSurvey:
    """The survey without the images of another size than their camera's, which are counted as missing.

    Raises:
        UnreadableFrameError: all of them are.
    """
    files = dict(found.sensor.files)
    faults: list[UnreadableFrameError] = []
    for number, size in found.sizes.items():
        try:
            require_size(files[number], size, expected)
        except UnreadableFrameError as error:
            faults.append(error)
            del files[number]
    if faults and not files:
        raise faults[0]
    sensor = replace(found.sensor, files=files)
    return replace(found, sensor=sensor, unreadable=(*found.unreadable, *map(str, faults))) if faults else found


def require_size(path: Path, found: tuple[int, int], expected: tuple[int, int]) -> None:
    """Check an image's columns and rows against its camera's.

    Raises:
        UnreadableFrameError: names the file and both sizes.
    """
    if found != expected:
        raise UnreadableFrameError(f"{path}: image is {found[0]}x{found[1]}, its camera {expected[0]}x{expected[1]}")


TOLERANCE_S = SyncConfig().tolerance_s


def reference_of(sensors: Mapping[str, object]) -> str:
    """The sensor each of whose images makes a frame, of sensors by role with a camera among them."""
    return next(role for role in REFERENCE_ROLES if role in sensors)


def apart_ns(surveys: Mapping[str, SensorSurvey], stamps_ns: Mapping[int, int]) -> dict[str, list[int]]:
    """By role the distances of the nearest stamps that are beyond a replay's tolerance, one for each such frame.

    Args:
        surveys: of the sensors.
        stamps_ns: stamp by the number that is a file's name.
    """
    stamps = {
        role: [stamps_ns[n] for n in sorted(found.sensor.files) if n in stamps_ns] for role, found in surveys.items()
    }
    limit_ns = seconds_to_ns(TOLERANCE_S)
    apart: dict[str, list[int]] = {}
    for role, of_role in stamps.items():
        if of_role:
            nearest = (_distance_ns(frame_ns, of_role) for frame_ns in stamps[reference_of(surveys)])
            apart[role] = [ns for ns in nearest if ns > limit_ns]
    return apart


def _distance_ns(frame_ns: int, stamps_ns: Sequence[int]) -> int:
    """How far the nearest of one or more stamps, ascending, is from that of a frame."""
    place = bisect_left(stamps_ns, frame_ns)
    return min(abs(ns - frame_ns) for ns in stamps_ns[max(place - 1, 0) : place + 1])


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
