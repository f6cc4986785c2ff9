"""A dataset as a recording: its files are checked before the first message is written.

Raises everywhere:
    DumpError: the dataset cannot be converted.
    ConfigError: the tag table is unknown.
"""

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final, TypeVar

from roadperc_stream.config import SyncConfig
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry.rectification import is_rectified
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.log import Channel, Message
from roadperc_stream.metrics.evidence import rough_ratio
from roadperc_stream.model.tag_tables import TagTable
from roadperc_stream.output.findings import depth_rough
from roadperc_stream.schemas.record import PIXEL_ORIGIN_KEY
from roadperc_stream.schemas.roles import REFERENCE_ROLES
from roadperc_stream.system.text import number as counted
from roadperc_stream.system.text import shown
from roadperc_stream.system.threads import in_order
from roadperc_stream.system.time import ns_to_seconds, seconds_to_ns

from .encoders import Codings, encoded, roles_of
from .layouts.dataset import ConvertOptions, DatasetSequence, Layout, Request
from .readers.depth_files import GREY, DepthEncoding, depth_encoding, depth_metres, grey_encoding
from .readers.image_files import UnreadableFrameError
from .readers.pixel_files import samples_of
from .readers.sensor_folders import Sensor, of_size
from .readers.tag_files import LOSSY_TAGS, TagEncoding, choose_table, named_table, tag_encoding
from .recording import WORKERS, Recording, SensorRow, channels_of, finding_notes, rig_facts, static_messages

T = TypeVar("T")
_TAG_ROLES: Final[tuple[str, ...]] = ("segmentation", "truth_segmentation")
_DEPTH_ROLES: Final[tuple[str, ...]] = ("depth", "truth_depth")
_MISSING: Final = "counted as missing: {}"
_TOLERANCE_S: Final = SyncConfig().tolerance_s


@dataclass(frozen=True)
class _Plan:
    """A dataset whose files have the size of their cameras, and everything else that is needed to write the log."""

    dataset: DatasetSequence
    codings: Codings
    tag_table_source: str
    frames: tuple[int, ...]
    """Frame numbers; if sensors have their own stamps, the numbers of the reference sensor's images."""
    missing: Mapping[str, int]
    """Number of frames without a file by role; if sensors have their own stamps, without a file in the tolerance."""


def recording_of_dataset(layout: Layout, request: Request) -> Recording:
    """Return the recording of a folder with one file per frame and sensor."""
    read = layout.read(request)
    plan = _planned(read, request.options, request.notes)
    dataset = plan.dataset
    title = f"{dataset.title}, " if dataset.title else ""
    warnings = [
        *_losses(plan.codings),
        *(_MISSING.format(fault) for sensor in dataset.sensors.values() for fault in sensor.unreadable),
    ]
    labels = chain.from_iterable(read.detections.values())
    return Recording(
        title=f"{request.folder}: {title}{counted(len(plan.frames), 'frame')}",
        sensors=tuple(_rows(plan)),
        facts=tuple(_facts(plan)),
        frames=len(dataset.stamps_ns),
        channels=_channels(plan),
        messages=lambda warnings: _messages(plan, warnings),
        required=tuple(dataset.sensors),
        metadata=_metadata(plan),
        images=_images(dataset),
        notes=(*request.notes, *finding_notes(dataset.rig, labels)),
        warnings=tuple(warnings),
    )


def _planned(dataset: DatasetSequence, options: ConvertOptions, notes: list[str]) -> _Plan:
    sensors = {role: of_size(sensor, dataset.rig_of) for role, sensor in dataset.sensors.items()}
    frames, missing = _frames_and_missing(dataset, sensors, notes)
    if LIDAR in sensors:
        _of_frames(LIDAR, sensors[LIDAR].files, dataset.stamps_ns, notes)
    depth = {role: _depth_encoding(dataset, sensors[role], options, notes) for role in _DEPTH_ROLES if role in sensors}
    tags, table, table_source = _tag_encodings(sensors, options, dataset.tag_table)
    sensors = {
        role: replace(sensor, encoding=depth.get(role) or tags.get(role) or sensor.encoding)
        for role, sensor in sensors.items()
    }
    detections = _of_frames("detections", dataset.detections, dataset.stamps_ns, notes)
    poses = _of_frames("poses", dataset.poses, dataset.stamps_ns, notes)
    return _Plan(
        dataset=replace(dataset, sensors=sensors, detections=detections, poses=poses),
        codings=Codings(depth, tags, table, options.depth_as_float, options.allow_lossy_tags),
        tag_table_source=table_source,
        frames=frames,
        missing=missing,
    )


def _of_frames(what: str, entries: Mapping[int, T], frames: Mapping[int, int], notes: list[str]) -> dict[int, T]:
    """Return the entries of frames with an image; adds a note about the others."""
    kept = {number: entries[number] for number in frames if number in entries}
    if len(kept) < len(entries):
        notes.append(f"{what}: {len(entries) - len(kept)} of {len(entries)} frames have no image: left out")
    return kept


def _depth_encoding(
    dataset: DatasetSequence, sensor: Sensor, options: ConvertOptions, notes: list[str]
) -> DepthEncoding:
    """Return the encoding of a sensor's depth; adds a note for 8-bit grey, and a finding for rough depth."""
    camera, files = dataset.rig.camera_of(sensor.role), sensor.paths
    found = depth_encoding(files, options.depth_coding)
    if found in GREY and dataset.grey_depth and options.depth_coding is None:
        found = dataset.grey_depth
    elif found in GREY:
        found, note = grey_encoding(files, camera, options.depth_coding)
        notes.append(note)
    if found == "disparity" and not dataset.rig.baseline_m:
        raise DumpError(f"{files[0]}: disparity needs the baseline; add baseline_m to calibration.json")
    focal_baseline, shares = camera.fx * (dataset.rig.baseline_m or math.nan), []
    for pixels in samples_of(files):
        with suppress(DumpError):  # a file of another encoding is reported when it is written
            shares.append(rough_ratio(depth_metres(pixels, found, focal_baseline)))
    if (rough := depth_rough([share for share in shares if share is not None])) is not None:
        notes.append(f"{sensor.role}: {rough}")
    return found


def _tag_encodings(
    sensors: Mapping[str, Sensor], options: ConvertOptions, stated: str | None
) -> tuple[dict[str, TagEncoding], TagTable | None, str]:
    """Return the encodings by role, the table of the tags, and its source."""
    roles = [role for role in _TAG_ROLES if role in sensors]
    if not roles:
        return {}, None, ""
    named, lossy, first = named_table(options.tags or stated), options.allow_lossy_tags, roles[0]
    found = {role: tag_encoding(sensors[role].paths, named and named[0], allow_lossy=lossy) for role in roles}
    table, source = named or choose_table(*found[first], sensors[first].source)
    return {role: encoding for role, (encoding, _) in found.items()}, table, source


def _frames_and_missing(
    dataset: DatasetSequence, sensors: Mapping[str, Sensor], notes: list[str]
) -> tuple[tuple[int, ...], dict[str, int]]:
    """Return the frame numbers, and the number of frames without a file by role."""
    stamps_ns = dataset.stamps_ns
    if not dataset.stamps_of_sensors:
        counts = {role: sum(number in stamps_ns for number in sensor.files) for role, sensor in sensors.items()}
        return tuple(stamps_ns), {role: len(stamps_ns) - count for role, count in counts.items()}
    reference = next(role for role in REFERENCE_ROLES if role in sensors)
    frames = tuple(sorted(sensors[reference].files))
    stamps = {role: [stamps_ns[n] for n in sorted(found.files) if n in stamps_ns] for role, found in sensors.items()}
    missing = {}
    for role, of_role in stamps.items():
        apart = _apart_ns(stamps[reference], of_role) if of_role else None
        missing[role] = len(frames) if apart is None else len(apart)
        notes += [_apart_note(sensors[role].source, apart, len(frames))] if apart else []
    return frames, missing


def _apart_ns(frames_ns: Sequence[int], stamps_ns: Sequence[int]) -> list[int]:
    """Return the distances of frames from the nearest of one or more ascending stamps, beyond a replay's tolerance."""
    limit_ns = seconds_to_ns(_TOLERANCE_S)
    places = ((ns, bisect_left(stamps_ns, ns)) for ns in frames_ns)
    nearest = (min(abs(ns - other) for other in stamps_ns[max(at - 1, 0) : at + 1]) for ns, at in places)
    return [ns for ns in nearest if ns > limit_ns]


def _apart_note(source: str, apart_ns: Sequence[int], frames: int) -> str:
    ends_s = map(ns_to_seconds, (min(apart_ns), max(apart_ns)))
    nearest, farthest = (f"{end_s:.6f}".rstrip("0").rstrip(".") for end_s in ends_s)
    by = nearest if nearest == farthest else f"{nearest} to {farthest}"
    return (
        f"{source}: {len(apart_ns)} of {frames} images have no file within sync.tolerance_s ({_TOLERANCE_S:g} s), the "
        f"nearest are {by} s apart; pass --set sync.tolerance_s=SECONDS to the replay to pair them"
    )


def _channels(plan: _Plan) -> dict[str, Channel]:
    rigs = (plan.dataset.rig, *plan.dataset.frame_rigs.values())
    return channels_of(rigs, roles_of(plan.dataset), plan.codings.tag_table)


def _messages(plan: _Plan, warnings: list[str]) -> Iterator[tuple[str, Message]]:
    """Yield role and message: calibrations and mountings first, then frame by frame.

    If each frame has its own rig, that comes first in the frame. Few frames are in memory at a time.
    """
    dataset, channels, roles = plan.dataset, _channels(plan), roles_of(plan.dataset)
    rigs = dataset.frame_rigs or {next(iter(dataset.stamps_ns)): dataset.rig}

    def made(number: int) -> tuple[list[tuple[str, bytes]], list[str]]:
        """Return the messages of a frame with their roles, and the errors of its files."""
        contents, faults = [], []
        for role in roles:
            try:
                content = encoded(dataset, plan.codings, role, number)
            except UnreadableFrameError as error:
                faults.append(_MISSING.format(error))
                continue
            contents += [] if content is None else [(role, content)]
        return contents, faults

    unreadable: list[str] = []
    frames = zip(dataset.stamps_ns.items(), in_order(made, dataset.stamps_ns, WORKERS), strict=True)
    for sequence, ((number, stamp_ns), (contents, faults)) in enumerate(frames):
        static = static_messages(rigs[number], stamp_ns) if number in rigs else []
        for role, content in (*static, *contents):
            yield role, Message(channels[role], stamp_ns, stamp_ns, sequence, content)
        unreadable += faults
    warnings += unreadable


def _losses(codings: Codings) -> Iterator[str]:
    """Yield warnings about losses in the conversion."""
    for found in dict.fromkeys(codings.depth.values()):
        if found in GREY:
            yield f"depth is {found}, {GREY[found]}; it is converted with this precision"
    if codings.allow_lossy_tags and codings.tag_table is not None:
        yield LOSSY_TAGS


def _metadata(plan: _Plan) -> Mapping[str, str]:
    dataset, table = plan.dataset, plan.codings.tag_table
    found = {"frames": str(len(plan.frames)), "time": dataset.timing}
    found |= {f"encoding.{role}": sensor.encoding for role, sensor in dataset.sensors.items()}
    found |= {"tag_table": table.name, "tag_table_known_by": plan.tag_table_source} if table else {}
    found |= {PIXEL_ORIGIN_KEY: dataset.pixel_origin} if dataset.pixel_origin else {}
    return found | ({"dataset": dataset.title} if dataset.title else {})


def _images(dataset: DatasetSequence) -> Mapping[str, str]:
    """Return the stamps of labelled images by name; none if the log's images lack the labels' distortion."""
    names = dataset.label_names if is_rectified(dataset.rig.cameras["calibration"]) else {}
    return {name: str(dataset.stamps_ns[number]) for number, name in names.items() if number in dataset.stamps_ns}


def _rows(plan: _Plan) -> Iterator[SensorRow]:
    dataset = plan.dataset
    for role, sensor in dataset.sensors.items():
        camera = dataset.rig.camera_of(role)
        count = sum(number in dataset.stamps_ns for number in sensor.files)
        size = "" if role == LIDAR else f"{camera.width}x{camera.height}"
        yield (role, shown(sensor.source), str(count), str(plan.missing[role]), size, sensor.encoding)
    if dataset.detections:
        missing = str(sum(number not in dataset.detections for number in plan.frames))
        boxes = f"{sum(map(len, dataset.detections.values()))} boxes"
        yield ("detections", shown(dataset.detections_source), str(len(dataset.detections)), missing, "", boxes)


def _facts(plan: _Plan) -> list[tuple[str, str]]:
    dataset, table = plan.dataset, plan.codings.tag_table
    facts = [("time", dataset.timing)]
    facts += [("tags", f"{table.title} ({plan.tag_table_source})")] if table else []
    facts += rig_facts(dataset.rig, dataset.pixel_origin)
    truth = {"surface": dataset.truth.surfaces, "lanes": dataset.truth.lanes, "objects": dataset.truth.objects}
    counts = [f"{name} {len(entries)}" for name, entries in ({"poses": dataset.poses} | truth).items() if entries]
    return facts + ([("truth", ", ".join(counts))] if counts else [])
