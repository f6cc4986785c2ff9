"""Check the headers of a sensor's files: readable files, sizes, and files that count as missing.

If file names are stamps, also find the images without a file of another sensor within a replay's tolerance.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from roadperc_stream.config import SyncConfig
from roadperc_stream.errors import DumpError
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.schemas.roles import REFERENCE_ROLES, ROLES
from roadperc_stream.system.time import ns_to_seconds, seconds_to_ns

from ..rig import CAMERA_ROLES, Rig
from .image_files import UnreadableFrameError, read_bytes, read_header
from .layout import Sensor
from .pixel_files import file_size
from .point_files import load_points, points_kind


@dataclass(frozen=True)
class SensorSurvey:
    """A sensor's files with readable headers, and the errors of the other files."""

    sensor: Sensor
    unreadable: tuple[str, ...]
    sizes: Mapping[int, tuple[int, int]]
    """Columns and rows by frame, if the headers give them."""
    encoding: str = ""

    @property
    def size(self) -> tuple[int, int] | None:
        """Return the most frequent columns and rows; with equal counts, those of the first frame."""
        return next((size for size, _ in Counter(self.sizes.values()).most_common(1)), None)

    @property
    def paths(self) -> list[Path]:
        """Return the files in the order of frames."""
        return list(self.sensor.files.values())


def front_sensors(sensors: Mapping[str, Sensor]) -> tuple[dict[str, Sensor], str]:
    """Return the sensors, with the left camera as front camera if there is no other, and a note.

    Raises:
        DumpError: no sensor is a camera.
    """
    if not any(role in sensors for role in CAMERA_ROLES):
        found = ", ".join(sensor.source for sensor in sensors.values())
        raise DumpError(f"no camera found, only {found}; add one or pass --role")
    kept = dict(sensors)
    left = kept.pop("left", None)
    if left is None:
        return kept, ""
    if "image" not in kept:
        return {"image": replace(left, role="image"), **kept}, f"{left.source}: the left camera is the front camera"
    if _same_files(kept["image"].files, left.files):
        return kept, f"{left.source} holds the same images as {kept['image'].source}: not stored twice"
    return dict(sensors), ""


def _same_files(a: Mapping[int, Path], b: Mapping[int, Path]) -> bool:
    """Return True if all files have the same sizes, and the first files have the same bytes."""
    if a.keys() != b.keys() or any(a[number].stat().st_size != b[number].stat().st_size for number in a):
        return False
    return read_bytes(a[min(a)]) == read_bytes(b[min(b)])


def surveyed(sensors: Mapping[str, Sensor]) -> dict[str, SensorSurvey]:
    """Return the surveys of sensors by role, in the order of ``ROLES``.

    Raises:
        DumpError: no file of a sensor can be read.
    """
    return {role: survey(sensors[role]) for role in ROLES if role in sensors}


def survey(sensor: Sensor) -> SensorSurvey:
    """Check the header of every file; empty, cut off or unknown files count as missing.

    Raises:
        DumpError: no file of the sensor can be read.
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
    """Return the reason if a lidar has points for no frame, else ""; ``frames`` are the frames with an image.

    Reads files until one holds points, because the first bytes are not enough.
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
    """Return columns and rows, if the header gives them, and a description."""
    if role == LIDAR:
        return None, points_kind(path)
    if role in ("image", "left", "right"):
        return read_header(path)
    return file_size(path), ""


def _counted(kinds: Counter[str]) -> str:
    if len(kinds) == 1:
        return next(iter(kinds))
    return ", ".join(f"{kind} ({count})" for kind, count in kinds.most_common())


def of_size(found: SensorSurvey, rig_of: Callable[[int], Rig]) -> SensorSurvey:
    """Return the survey without images of another size than their camera's; those count as missing.

    ``rig_of`` gives the cameras of a frame.

    Raises:
        UnreadableFrameError: no image has the camera's size.
    """
    files = dict(found.sensor.files)
    faults: list[UnreadableFrameError] = []
    for number, size in found.sizes.items():
        camera = rig_of(number).camera_of(found.sensor.role)
        try:
            require_size(files[number], size, (camera.width, camera.height))
        except UnreadableFrameError as error:
            faults.append(error)
            del files[number]
    if faults and not files:
        raise faults[0]
    sensor = replace(found.sensor, files=files)
    return replace(found, sensor=sensor, unreadable=(*found.unreadable, *map(str, faults))) if faults else found


def require_size(path: Path, found: tuple[int, int], expected: tuple[int, int]) -> None:
    """Check that an image has the columns and rows of its camera.

    Raises:
        UnreadableFrameError: the sizes differ; the message names the file and both sizes.
    """
    if found != expected:
        raise UnreadableFrameError(
            f"{path}: image is {found[0]}x{found[1]}, expected {expected[0]}x{expected[1]} as its camera"
        )


TOLERANCE_S = SyncConfig().tolerance_s


def reference_of(sensors: Mapping[str, object]) -> str:
    """Return the role whose images make the frames; one of the sensors must be a camera."""
    return next(role for role in REFERENCE_ROLES if role in sensors)


def apart_ns(surveys: Mapping[str, SensorSurvey], stamps_ns: Mapping[int, int]) -> dict[str, list[int]]:
    """Return by role the distances from frames to the nearest stamp, for frames beyond a replay's tolerance.

    ``stamps_ns`` holds the stamp by the number in a file's name.
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
    """Return the distance of a frame's stamp from the nearest of one or more ascending stamps."""
    place = bisect_left(stamps_ns, frame_ns)
    return min(abs(ns - frame_ns) for ns in stamps_ns[max(place - 1, 0) : place + 1])


def meeting_notes(
    surveys: Mapping[str, SensorSurvey], apart: Mapping[str, Sequence[int]], frames: int
) -> Iterator[str]:
    """Yield a note for each sensor without files near some images."""
    for role, distances in apart.items():
        if distances:
            ends_s = map(ns_to_seconds, (min(distances), max(distances)))
            nearest, farthest = (f"{end_s:.6f}".rstrip("0").rstrip(".") for end_s in ends_s)
            by = nearest if nearest == farthest else f"{nearest} to {farthest}"
            yield (
                f"{surveys[role].sensor.source}: {len(distances)} of {frames} images have no file within "
                f"sync.tolerance_s ({TOLERANCE_S:g} s), the nearest are {by} s apart; "
                "pass --set sync.tolerance_s=SECONDS to the replay to pair them"
            )
