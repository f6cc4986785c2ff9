"""The plan of a conversion: all files are found and checked before the first message is written."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

from roadperc_stream.errors import DumpError
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.metrics.evidence import rough_ratio
from roadperc_stream.model.tag_tables import TagTable
from roadperc_stream.output.findings import depth_rough

from ..layouts.drive import ConvertOptions, Drive
from .depth_files import GREY, DepthEncoding, depth_encoding, depth_metres, grey_encoding
from .pixel_files import surveyed
from .survey import SensorSurvey, apart_ns, meeting_notes, of_size, reference_of
from .tag_files import LOSSY_TAGS, TagEncoding, choose_table, named_table, tag_encoding

T = TypeVar("T")
_TAG_ROLES: Final[tuple[str, ...]] = ("segmentation", "truth_segmentation")
_DEPTH_ROLES: Final[tuple[str, ...]] = ("depth", "truth_depth")


@dataclass(frozen=True)
class Plan:
    """A drive, and everything else that is needed to write the log."""

    drive: Drive
    """Its surveys hold only files of their camera's size, and name the encodings."""
    options: ConvertOptions
    frames: tuple[int, ...]
    """Frame numbers; if sensors have their own stamps, the numbers of the reference sensor's images."""
    missing: Mapping[str, int]
    """Number of frames without a file by role; if sensors have their own stamps, without a file in the tolerance."""
    depth_encodings: Mapping[str, DepthEncoding]
    tag_encodings: Mapping[str, TagEncoding]
    tag_table: TagTable | None
    tag_table_source: str

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return warnings about losses in the conversion."""
        lossy_depth = [
            f"depth is {found}, {GREY[found]}; it is converted with this precision"
            for found in dict.fromkeys(self.depth_encodings.values())
            if found in GREY
        ]
        lossy_tags = self.options.allow_lossy_tags and self.tag_table is not None
        return (*lossy_depth, *(LOSSY_TAGS,) * lossy_tags)

    @property
    def unreadable(self) -> tuple[str, ...]:
        """Return the errors of unreadable files, which are left out."""
        return tuple(fault for survey in self.drive.surveys.values() for fault in survey.unreadable)


def make_plan(drive: Drive, options: ConvertOptions) -> Plan:
    """Check a drive's files and plan its conversion.

    Raises:
        DumpError: the drive cannot be converted; nothing is written.
        ConfigError: the tag table is unknown.
    """
    notes = list(drive.notes)
    surveys = {role: of_size(found, drive.rig_of) for role, found in drive.surveys.items()}
    frames, missing = _frames_and_missing(drive, surveys, notes)
    if LIDAR in surveys:
        _of_frames(LIDAR, surveys[LIDAR].sensor.files, drive.stamps_ns, notes)
    depth_encodings = {
        role: _depth_encoding(drive, role, surveys[role].paths, options, notes)
        for role in _DEPTH_ROLES
        if role in surveys
    }
    tags, table, table_source = _tags(surveys, options, drive.tag_table)
    named = {
        role: replace(found, encoding=depth_encodings.get(role) or tags.get(role) or found.encoding)
        for role, found in surveys.items()
    }
    detections = _of_frames("detections", drive.detections, drive.stamps_ns, notes)
    poses = _of_frames("poses", drive.poses, drive.stamps_ns, notes)
    return Plan(
        drive=replace(drive, surveys=named, detections=detections, poses=poses, notes=tuple(notes)),
        options=options,
        frames=frames,
        missing=missing,
        depth_encodings=depth_encodings,
        tag_encodings=tags,
        tag_table=table,
        tag_table_source=table_source,
    )


def _depth_encoding(
    drive: Drive, role: str, files: Sequence[Path], options: ConvertOptions, notes: list[str]
) -> DepthEncoding:
    """Return the encoding of a sensor's depth; adds a note for 8-bit grey, and a finding for rough depth.

    Raises:
        DumpError: the encoding is not known, or disparity without a baseline.
    """
    found = depth_encoding(files, options.depth_coding)
    if found in GREY and drive.grey_depth and options.depth_coding is None:
        found = drive.grey_depth
    elif found in GREY:
        found, note = grey_encoding(files, drive.rig.camera_of(role), options.depth_coding)
        notes.append(note)
    if found == "disparity" and not drive.rig.baseline_m:
        raise DumpError(f"{files[0]}: disparity needs the baseline; add baseline_m to calibration.json")
    focal_baseline, shares = drive.rig.camera_of(role).fx * (drive.rig.baseline_m or math.nan), []
    for pixels in surveyed(files):
        with suppress(DumpError):  # a file of another encoding is reported when it is written
            shares.append(rough_ratio(depth_metres(pixels, found, focal_baseline)))
    if (rough := depth_rough([share for share in shares if share is not None])) is not None:
        notes.append(f"{role}: {rough}")
    return found


def _frames_and_missing(
    drive: Drive, surveys: Mapping[str, SensorSurvey], notes: list[str]
) -> tuple[tuple[int, ...], dict[str, int]]:
    """Return the frame numbers, and the number of frames without a file by role."""
    stamps_ns = drive.stamps_ns
    if not drive.stamps_of_sensors:
        counts = {role: sum(number in stamps_ns for number in found.sensor.files) for role, found in surveys.items()}
        return tuple(stamps_ns), {role: len(stamps_ns) - count for role, count in counts.items()}
    frames = tuple(sorted(surveys[reference_of(surveys)].sensor.files))
    apart = apart_ns(surveys, stamps_ns)
    notes += meeting_notes(surveys, apart, len(frames))
    return frames, {role: len(apart.get(role, frames)) for role in surveys}


def _tags(
    surveys: Mapping[str, SensorSurvey], options: ConvertOptions, stated: str | None
) -> tuple[dict[str, TagEncoding], TagTable | None, str]:
    roles = [role for role in _TAG_ROLES if role in surveys]
    if not roles:
        return {}, None, ""
    named, lossy, first = named_table(options.tags or stated), options.allow_lossy_tags, roles[0]
    found = {role: tag_encoding(surveys[role].paths, named and named[0], allow_lossy=lossy) for role in roles}
    table, source = named or choose_table(*found[first], surveys[first].sensor.source)
    return {role: encoding for role, (encoding, _) in found.items()}, table, source


def _of_frames(what: str, entries: Mapping[int, T], frames: Mapping[int, int], notes: list[str]) -> dict[int, T]:
    """Return the entries of frames with an image; adds a note about the others."""
    kept = {number: entries[number] for number in frames if number in entries}
    if len(kept) < len(entries):
        notes.append(f"{what}: {len(entries) - len(kept)} of {len(entries)} frames have no image: left out")
    return kept
