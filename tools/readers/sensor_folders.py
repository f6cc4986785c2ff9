"""The files of a sensor by frame number, and what their headers say.

Raises everywhere:
    DumpError: the folder has no file of a frame, two of one, or none that can be read.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.input.calibrations import LIDAR, Size
from roadperc_stream.schemas.roles import ROLES

from ..rig import Rig
from .calibration_file import CALIBRATION_NAME
from .documents import frame_number, is_seconds
from .image_files import UnreadableFrameError, read_header
from .pixel_files import file_size
from .point_files import load_points, points_kind

_IMAGE_SUFFIXES: Final = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".webp", ".tif", ".tiff", ".ppm", ".exr"})
_NUMBER_SUFFIXES: Final = frozenset({".npy", ".npz", ".dat", ".csv", ".raw", ".bin", ".h5", ".hdf5"})
_POINT_SUFFIXES: Final = frozenset({".ply", ".las", ".laz"})
_FRAME_SUFFIXES: Final = _IMAGE_SUFFIXES | _NUMBER_SUFFIXES | _POINT_SUFFIXES
"""Suffixes of files that can be a frame; the content decides the format."""
DOCUMENTS: Final = {
    "calibration": (CALIBRATION_NAME,),
    "detections": ("detections.json", "coco_results.json", "coco.json"),
    "poses": ("poses.json", "transforms.json", "poses.csv", "poses.txt"),
    "timestamps": ("timestamps.txt", "timestamps.csv", "times.txt", "data.csv"),
    "truth": ("truth.json",),
}
"""Names of the documents of a dump by their content."""
_DOCUMENT_NAMES: Final = frozenset(name for names in DOCUMENTS.values() for name in names)
_SHORTEST_NS: Final = 1_000_000


@dataclass(frozen=True)
class Sensor:
    """The files of one role by frame number; ``with_headers`` sets the later fields."""

    role: str
    source: str
    """Name of the folder or files for messages."""
    files: Mapping[int, Path]
    sizes: Mapping[int, Size] = field(default_factory=dict)
    """Columns and rows by frame, if the headers give them."""
    encoding: str = ""
    unreadable: tuple[str, ...] = ()
    """The errors of the files that are left out."""

    @property
    def first(self) -> Path:
        """Return the file with the smallest frame number."""
        return self.files[min(self.files)]

    @property
    def size(self) -> Size | None:
        """Return the most frequent columns and rows; with equal counts, those of the first frame."""
        return next((size for size, _ in Counter(self.sizes.values()).most_common(1)), None)

    @property
    def paths(self) -> list[Path]:
        """Return the files in the order of frames."""
        return list(self.files.values())


def entries_of(folder: Path) -> list[Path]:
    """Return the visible entries of a folder, sorted."""
    try:
        return sorted(p for p in folder.iterdir() if not p.name.startswith("."))
    except OSError as error:
        raise DumpError(f"{folder}: {error.strerror or error}") from error


def is_image(path: Path) -> bool:
    """Return True if the suffix of a file is that of an image."""
    return path.suffix.lower() in _IMAGE_SUFFIXES and path.is_file()


def may_be_frame(path: Path) -> bool:
    """Return True if a path is a file that can be a frame, by its name."""
    return path.is_file() and path.suffix.lower() in _FRAME_SUFFIXES and path.name not in _DOCUMENT_NAMES


def frame_files(folder: Path) -> list[Path]:
    """Return the files of a folder that can be frames; in KITTI they are in the subfolder ``data``."""
    found = [path for path in entries_of(folder) if may_be_frame(path)]
    return frame_files(folder / "data") if not found and (folder / "data").is_dir() else found


def sensor_in(folder: Path, role: str) -> Sensor:
    """Return a role's files in a folder by the number in their names."""
    return numbered_sensor(role, folder.name, frame_files(folder), [])


def is_single(path: Path) -> bool:
    """Return True if a path is a file without a frame number; it becomes frame 0."""
    return path.is_file() and frame_number(path.stem) is None


def numbered_sensor(role: str, source: str, files: list[Path], notes: list[str], *, single: bool = False) -> Sensor:
    """Return a sensor with its files by the number in their names; a ``single`` file is frame 0.

    Adds a note about files without a number.
    """
    numbered: dict[int, Path] = {}
    unnumbered = []
    in_seconds = any(is_seconds(path.stem) for path in files)
    for path in files:
        whole = in_seconds and not is_seconds(path.stem)  # 13.png among 12.95.png and 13.05.png
        number = 0 if single else frame_number(f"{path.stem}.0" if whole else path.stem)
        if number is None:
            unnumbered.append(path.name)
        elif number in numbered:
            raise DumpError(
                f"{source}: {numbered[number].name} and {path.name} are both frame {number}: the last number in a "
                "name is the frame's; rename the files, move other sensors into folders of their own, or remove one"
            )
        else:
            numbered[number] = path
    if not files:
        raise DumpError(f"{source}: no frames found; expected one numbered file per frame")
    if not numbered:
        raise DumpError(f"{source}: no frame number in the name of {unnumbered[0]}; expected names such as 000001.png")
    if unnumbered:
        notes.append(f"{source}: left out, no frame number in the name: {', '.join(unnumbered[:3])}")
    if in_seconds:
        _require_times(source, numbered)
    return Sensor(role, source, numbered)


def _require_times(source: str, files: Mapping[int, Path]) -> None:
    """Check that decimal numbers in names are seconds: as such, ``1.0001`` and ``1.0002`` are too close."""
    for earlier_ns, later_ns in pairwise(sorted(files)):
        if later_ns - earlier_ns <= _SHORTEST_NS:
            names = f"{files[earlier_ns].name} and {files[later_ns].name}"
            raise DumpError(f"{source}: {names}: as seconds 1 ms apart or less; write frame numbers without a point")


def with_headers(sensors: Mapping[str, Sensor]) -> dict[str, Sensor]:
    """Return the sensors with what the headers of their files say, in the order of ``ROLES``.

    Empty, cut off or unknown files count as missing.
    """
    return {role: _with_headers(sensors[role]) for role in ROLES if role in sensors}


def _with_headers(sensor: Sensor) -> Sensor:
    files: dict[int, Path] = {}
    sizes: dict[int, Size] = {}
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
    counted = [f"{kind} ({count})" for kind, count in kinds.most_common()]
    encoding = next(iter(kinds)) if len(kinds) == 1 else ", ".join(counted)
    return replace(sensor, files=files, sizes=sizes, encoding=encoding, unreadable=tuple(faults))


def _header(role: str, path: Path) -> tuple[Size | None, str]:
    """Return columns and rows, if the header gives them, and a description."""
    if role == LIDAR:
        return None, points_kind(path)
    if role in ("image", "left", "right"):
        return read_header(path)
    return file_size(path), ""


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


def of_size(sensor: Sensor, rig_of: Callable[[int], Rig]) -> Sensor:
    """Return the sensor without images of another size than their camera's; those count as missing.

    ``rig_of`` gives the cameras of a frame.
    """
    files = dict(sensor.files)
    faults: list[UnreadableFrameError] = []
    for number, size in sensor.sizes.items():
        camera = rig_of(number).camera_of(sensor.role)
        try:
            require_size(files[number], size, (camera.width, camera.height))
        except UnreadableFrameError as error:
            faults.append(error)
            del files[number]
    if faults and not files:
        raise faults[0]
    return replace(sensor, files=files, unreadable=(*sensor.unreadable, *map(str, faults)))


def require_size(path: Path, found: Size, expected: Size) -> None:
    """Check that an image has the columns and rows of its camera, else raise an ``UnreadableFrameError``."""
    if found != expected:
        raise UnreadableFrameError(
            f"{path}: image is {found[0]}x{found[1]}, expected {expected[0]}x{expected[1]} as its camera"
        )
