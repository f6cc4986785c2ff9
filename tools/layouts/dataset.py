"""A dataset folder in the terms of a conversion: sensors by number, cameras, stamps, poses and truth."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float
from roadperc_stream.model import Detection

from ..readers.calibration_file import CALIBRATION_NAME, CalibrationFile, calibration_of
from ..readers.depth_files import DepthCoding, DepthEncoding
from ..readers.sensor_folders import Sensor
from ..readers.truth_file import TruthTables
from ..rig import Rig

_FLAGS: Final = {
    "--role": "roles",
    "--tags": "tags",
    "--fov": "fov_deg",
    "--rate": "rate_hz",
    "--allow-lossy-tags": "allow_lossy_tags",
    "--depth-coding": "depth_coding",
    "--calibration": "calibration",
    "--height": "height_m",
    "--layout": "layout",
    "--sequence": "sequence",
}


@dataclass(frozen=True)
class ConvertOptions:
    """The options of the command line."""

    roles: Mapping[str, Path] = field(default_factory=dict)
    tags: str | None = None
    """Table of the tags: a CARLA version, the name of a dataset's table, or a TOML file."""
    fov_deg: float | None = None
    rate_hz: float | None = None
    depth_as_float: bool = False
    allow_lossy_tags: bool = False
    depth_coding: DepthCoding | None = None
    calibration: Path | None = None
    """A file that replaces ``calibration.json``: JSON, or the camera_info YAML of ROS."""
    height_m: float | None = None
    layout: str | None = None
    sequence: str | None = None

    def calibration_of(self, folder: Path) -> tuple[CalibrationFile, Path]:
        """Return the calibration of a recording in a folder, and its path."""
        return calibration_of(folder / CALIBRATION_NAME, self.calibration, self.fov_deg, self.height_m)

    def refuse(self, source: Path, flags: Collection[str], why: str) -> None:
        """Raise a ``DumpError`` if the user passed one of these flags; it names the source, the flag and the reason."""
        for flag in flags:
            if getattr(self, _FLAGS[flag]):
                raise DumpError(f"{source}: {flag} {why}: remove it")

    def require_only(self, source: Path, flags: Collection[str], why: str = "is not an option for it") -> None:
        """Raise a ``DumpError`` if the user passed another flag than these, or ``--layout``."""
        self.refuse(source, [flag for flag in _FLAGS if flag not in (*flags, "--layout")], why)


@dataclass(frozen=True)
class DatasetSequence:
    """What a layout reads from a folder. One number joins a frame's files, stamp, pose, boxes and truth.

    The ego frame is x forward, y left, z up. Its origin is on the road below the front camera, unless the dataset has
    its own ego frame. The odom frame is the ego frame of the first pose, unless the dataset has a world with z up.
    """

    title: str
    """Dataset and sequence for the printed line and the log's metadata; empty for a dump."""
    sensors: Mapping[str, Sensor]
    """Files by role and number, in the order of ``schemas.roles.ROLES``; ``sensors.with_headers`` makes them."""
    stamps_ns: Mapping[int, int]
    """Stamp by number, ascending."""
    timing: str
    rig: Rig
    frame_rigs: Mapping[int, Rig] = field(default_factory=dict)
    """Rig by number if each frame has its own calibration; then ``rig`` is that of the first frame."""
    stamps_of_sensors: bool = False
    """True if sensors have stamps of their own: a number has a file of one sensor, and frames are the front images."""
    detections: Mapping[int, tuple[Detection, ...]] = field(default_factory=dict)
    detections_source: str = ""
    poses: Mapping[int, Float] = field(default_factory=dict)
    """(4, 4) true odom_T_ego."""
    truth: TruthTables = field(default_factory=TruthTables)
    label_names: Mapping[int, str] = field(default_factory=dict)
    """Name of each labelled image in the dataset's own label files."""
    side_by_side: int = 1
    """Cameras that each file of a camera holds along its width; the middle one is used."""
    grey_depth: DepthEncoding | None = None
    """Encoding of 8-bit grey depth, if the dataset states it."""
    tag_table: str | None = None
    """Name of the tags' table, or a CARLA version, if the dataset states it."""
    pixel_origin: str = ""
    """Origin of the principal point, and its source; empty without a matrix."""

    def rig_of(self, number: int) -> Rig:
        """Return the cameras of a frame."""
        return self.frame_rigs.get(number, self.rig)


@dataclass(frozen=True)
class Request:
    """What a layout must read: the sequence ``name`` of a ``folder``, which is at ``path``, with some options."""

    folder: Path
    """The folder that the user named."""
    name: str
    path: Path
    options: ConvertOptions
    notes: list[str] = field(default_factory=list)
    """What is assumed, and what is left out; the layout adds to it."""


@dataclass(frozen=True)
class Layout:
    """How the folders of a dataset are detected and read; the module of each dataset has one as ``LAYOUT``."""

    read: Callable[[Request], DatasetSequence]
    """Reads documents and the headers of files. Images, depths, masks and points are read while the log is written.

    A folder that cannot be converted raises a ``DumpError`` with file and line."""
    options: tuple[str, ...]
    """The options that it takes beside ``--layout``."""
    sequences: Callable[[Path], Mapping[str, Path]] | None = None
    """Returns the folders of the sequences in a folder by name; None if a folder is read as one sequence."""
    detect: Callable[[Path], bool] | None = None
    """Returns True if the names in a folder are those of the dataset. No file is read.

    None: it has sequences, and no calibration.json, which makes it a dump."""
    refusal: str = "is not an option for it"
    """Why the other options are refused."""

    def fits(self, folder: Path) -> bool:
        """Return True if a folder has this layout."""
        if self.detect is not None:
            return self.detect(folder)
        found = self.sequences is not None and self.sequences(folder)
        return bool(found) and not (folder / CALIBRATION_NAME).exists()

    def request(self, folder: Path, options: ConvertOptions) -> Request:
        """Check the options, and return what ``read`` needs.

        Raises:
            DumpError: an option is not one of the layout's, there is no such sequence, or several and none is wanted.
        """
        options.require_only(folder, self.options, self.refusal)
        name, path = "", folder
        if self.sequences is not None:
            name, path = _chosen(folder, self.sequences(folder), options.sequence)
        return Request(folder, name, path, options)


def _chosen(folder: Path, sequences: Mapping[str, Path], wanted: str | None) -> tuple[str, Path]:
    """Return name and folder of the wanted sequence, or of the only one."""
    if not sequences:
        raise DumpError(
            f"{folder}: no sequence of this layout found; see the folders of each layout in docs/recordings.md, "
            "or remove --layout to detect it"
        )
    names = f"{', '.join(list(sequences)[:12])}{', ...' if len(sequences) > 12 else ''}"
    if wanted is None and len(sequences) != 1:
        raise DumpError(f"{folder}: expected one sequence, found {names}; choose one with --sequence NN")
    name = next(iter(sequences)) if wanted is None else wanted
    if name not in sequences:
        raise DumpError(f"{folder}: no sequence {name}; found {names}")
    return name, sequences[name]
