"""A dataset folder as a recording."""

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Final

from roadperc_stream.geometry.rectification import is_rectified
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.log import Message
from roadperc_stream.schemas.record import PIXEL_ORIGIN_KEY
from roadperc_stream.system.text import number, shown

from ..layouts.drive import ConvertOptions, Drive
from ..recording import Recording, SensorRow, camera_facts, finding_notes, mounting_fact
from .messages import channels, messages
from .plan import Plan, make_plan

_MISSING: Final = "counted as missing: {}"


def recording_of_drive(drive: Drive, options: ConvertOptions) -> Recording:
    """Return the recording of a folder with one file per frame and sensor.

    Raises:
        DumpError: the drive cannot be converted.
        ConfigError: the tag table is unknown.
    """
    plan = make_plan(drive, options)
    title = f"{drive.title}, " if drive.title else ""
    return Recording(
        title=f"{drive.folder}: {title}{number(len(plan.frames), 'frame')}",
        sensors=tuple(_sensors(plan)),
        facts=tuple(_facts(plan)),
        frames=len(drive.stamps_ns),
        channels=channels(plan),
        messages=lambda warnings: _messages(plan, warnings),
        required=tuple(plan.drive.surveys),
        metadata=_metadata(plan),
        images=_images(plan.drive),
        notes=(*plan.drive.notes, *finding_notes(plan.drive.rig, chain.from_iterable(drive.detections.values()))),
        warnings=(*plan.warnings, *map(_MISSING.format, plan.unreadable)),
    )


def _messages(plan: Plan, warnings: list[str]) -> Iterator[tuple[str, Message]]:
    unreadable: list[str] = []
    yield from messages(plan, unreadable)
    warnings.extend(map(_MISSING.format, unreadable))


def _metadata(plan: Plan) -> Mapping[str, str]:
    encodings = {f"encoding.{role}": survey.encoding for role, survey in plan.drive.surveys.items()}
    table = {"tag_table": plan.tag_table.name, "tag_table_known_by": plan.tag_table_source} if plan.tag_table else {}
    origin = {PIXEL_ORIGIN_KEY: plan.drive.pixel_origin} if plan.drive.pixel_origin else {}
    layout = {"dataset": plan.drive.title} if plan.drive.title else {}
    return {"frames": str(len(plan.frames)), "time": plan.drive.timing, **encodings, **table, **origin, **layout}


def _images(drive: Drive) -> Mapping[str, str]:
    """Return the stamps of labelled images by name; none if the log's images lack the labels' distortion."""
    names = drive.label_names if is_rectified(drive.rig.cameras["calibration"]) else {}
    return {name: str(drive.stamps_ns[number]) for number, name in names.items() if number in drive.stamps_ns}


def _sensors(plan: Plan) -> Iterator[SensorRow]:
    for role, survey in plan.drive.surveys.items():
        camera = plan.drive.rig.camera_of(role)
        count = sum(number in plan.drive.stamps_ns for number in survey.sensor.files)
        size = "" if role == LIDAR else f"{camera.width}x{camera.height}"
        missing = str(plan.missing[role])
        yield (role, shown(survey.sensor.source), str(count), missing, size, survey.encoding)
    if plan.drive.detections:
        missing = str(sum(number not in plan.drive.detections for number in plan.frames))
        boxes = f"{sum(map(len, plan.drive.detections.values()))} boxes"
        source = shown(plan.drive.detections_source)
        yield ("detections", source, str(len(plan.drive.detections)), missing, "", boxes)


def _facts(plan: Plan) -> list[tuple[str, str]]:
    facts = [("time", plan.drive.timing)]
    if plan.tag_table is not None:
        facts.append(("tags", f"{plan.tag_table.title} ({plan.tag_table_source})"))
    facts += camera_facts(plan.drive.rig)
    facts += [("pixel origin", plan.drive.pixel_origin)] if plan.drive.pixel_origin else []
    facts.append(mounting_fact(plan.drive.rig))
    truth = {"surface": plan.drive.truth.surfaces, "lanes": plan.drive.truth.lanes, "objects": plan.drive.truth.objects}
    counts = [f"{name} {len(entries)}" for name, entries in ({"poses": plan.drive.poses} | truth).items() if entries]
    return facts + ([("truth", ", ".join(counts))] if counts else [])
