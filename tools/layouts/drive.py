"""A dataset folder in the terms of a conversion: sensors by number, cameras, stamps, poses and truth."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float
from roadperc_stream.model import Detection

from ..carla_dump.depth_files import DepthCoding, DepthEncoding
from ..carla_dump.survey import SensorSurvey
from ..carla_dump.truth_file import NO_TRUTH, TruthTables
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

    def refuse(self, source: Path, flags: Collection[str], why: str) -> None:
        """Check that the user passed none of these flags.

        Raises:
            DumpError: a flag was passed; the message names the source, the flag and the reason.
        """
        for flag in flags:
            if getattr(self, _FLAGS[flag]):
                raise DumpError(f"{source}: {flag} {why}: remove it")

    def require_only(self, source: Path, *flags: str) -> None:
        """Check that a dataset, which has its own calibration and stamps, got only these flags, or ``--layout``.

        Raises:
            DumpError: another flag was passed.
        """
        others = [flag for flag in _FLAGS if flag not in (*flags, "--layout")]
        self.refuse(source, others, "is not an option for it")


@dataclass(frozen=True)
class Drive:
    """What a layout reads from a folder. One number joins a frame's files, stamp, pose, boxes and truth.

    The ego frame is x forward, y left, z up. Its origin is on the road below the front camera, unless the dataset has
    its own ego frame. The odom frame is the ego frame of the first pose, unless the dataset has a world with z up.
    """

    folder: Path
    title: str
    """Dataset and sequence for the printed line and the log's metadata; empty for a dump."""
    surveys: Mapping[str, SensorSurvey]
    """Files by role and number, in the order of ``schemas.roles.ROLES``; ``survey.surveyed`` makes them."""
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
    truth: TruthTables = NO_TRUTH
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
    notes: tuple[str, ...] = ()
    """What is assumed, and what is left out."""

    def rig_of(self, number: int) -> Rig:
        """Return the cameras of a frame."""
        return self.frame_rigs.get(number, self.rig)


def choose_sequence(folder: Path, sequences: Mapping[str, Path], wanted: str | None) -> tuple[str, Path]:
    """Return name and folder of the wanted sequence, or of the only one.

    Raises:
        DumpError: there is no such sequence, or several and none is wanted.
    """
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


class Layout(Protocol):
    """A module of this package."""

    def detect(self, folder: Path, /) -> bool:
        """Return True if the folder's names are those of the layout; no file is read."""

    def read(self, folder: Path, options: ConvertOptions) -> Drive:
        """Return the content of a folder; the images, depths, masks and points are read while the log is written.

        Raises:
            DumpError: the folder cannot be converted; the message names file and line.
        """
