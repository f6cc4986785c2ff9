"""A dump folder as a recording."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from roadperc_stream.log import Message
from roadperc_stream.schemas.record import PIXEL_ORIGIN_KEY
from roadperc_stream.system.text import shown

from ..recording import Recording, SensorRow, camera_facts, mounting_fact
from .camera_rig import LIDAR
from .messages import channels, messages
from .plan import ConvertOptions, Plan, make_plan

_MISSING: Final = "counted as missing: {}"


def recording_of_dump(dump: Path, options: ConvertOptions) -> Recording:
    """Return the recording of a folder with one file per frame and sensor.

    Raises:
        DumpError: the dump cannot be converted.
        ConfigError: the tag table is unknown.
    """
    plan = make_plan(dump, options)
    return Recording(
        title=f"{plan.layout.dump}: {len(plan.frames)} frames",
        sensors=tuple(_sensors(plan)),
        facts=tuple(_facts(plan)),
        frames=len(plan.stamps_ns),
        channels=channels(plan),
        messages=lambda warnings: _messages(plan, warnings),
        required=tuple(plan.surveys),
        metadata=_metadata(plan),
        notes=plan.notes,
        warnings=(*plan.warnings, *map(_MISSING.format, plan.unreadable)),
    )


def _messages(plan: Plan, warnings: list[str]) -> Iterator[tuple[str, Message]]:
    unreadable: list[str] = []
    yield from messages(plan, unreadable)
    warnings.extend(map(_MISSING.format, unreadable))


def _metadata(plan: Plan) -> Mapping[str, str]:
    encodings = {f"encoding.{role}": survey.encoding for role, survey in plan.surveys.items()}
    table = {"tag_table": plan.tag_table.name, "tag_table_known_by": plan.tag_table_source} if plan.tag_table else {}
    origin = {PIXEL_ORIGIN_KEY: plan.pixel_origin} if plan.pixel_origin else {}
    return {"frames": str(len(plan.frames)), "time": plan.timing, **encodings, **table, **origin}


def _sensors(plan: Plan) -> Iterator[SensorRow]:
    for role, survey in plan.surveys.items():
        camera, count = plan.rig.camera_of(role), sum(number in plan.stamps_ns for number in survey.sensor.files)
        size = "" if role == LIDAR else f"{camera.width}x{camera.height}"
        missing = str(plan.missing[role])
        yield (role, shown(survey.sensor.source), str(count), missing, size, survey.encoding)
    if plan.detections:
        missing = str(sum(number not in plan.detections for number in plan.frames))
        boxes = f"{sum(map(len, plan.detections.values()))} boxes"
        source = shown(plan.detections_source)
        yield ("detections", source, str(len(plan.detections)), missing, "", boxes)


def _facts(plan: Plan) -> list[tuple[str, str]]:
    facts = [("time", plan.timing)]
    if plan.tag_table is not None:
        facts.append(("tags", f"{plan.tag_table.title} ({plan.tag_table_source})"))
    facts += camera_facts(plan.rig)
    facts += [("pixel origin", plan.pixel_origin)] if plan.pixel_origin else []
    facts.append(mounting_fact(plan.rig))
    truth = {"surface": plan.truth.surfaces, "lanes": plan.truth.lanes, "objects": plan.truth.objects}
    counts = [f"{name} {len(entries)}" for name, entries in ({"poses": plan.poses} | truth).items() if entries]
    return facts + ([("truth", ", ".join(counts))] if counts else [])
