"""Replaces the cameras and mountings of a log by those of the configuration, now or of the replay that wrote it."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import Any, Final

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig, validated
from roadperc_stream.config.calibration import CalibrationConfig
from roadperc_stream.config.settings import parsed_toml
from roadperc_stream.config.stages import ABOUT_THE_LOG
from roadperc_stream.errors import ConfigError, DecodeError
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.rig import NO_RIG, LogSensor, Rig, calibration_role, own_calibration, replacing_rig
from roadperc_stream.input.stream import Problems, RoleAssignment, decoded_messages
from roadperc_stream.input.sync import Paired, reference_of, without_loops
from roadperc_stream.input.transforms import LatchedState, TransformTree
from roadperc_stream.log import Attachment, LogSummary
from roadperc_stream.model import (
    EGO,
    CameraImage,
    DepthImage,
    Detection,
    Object,
    Objects,
    PointCloud,
    TagImage,
    Transform,
)
from roadperc_stream.model.tag_tables import known_label
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES

_SENSORS: Final = ("depth", "left", "right", "lidar")
"""Roles whose camera or mounting may be replaced, besides that of the frames."""
_PROBED: Final = 20
"""Messages of a sensor that are searched for a readable one."""
_MOST_LATCHED: Final = 200
"""Messages that are searched for the first calibrations, and for the first transforms."""
_EGO_OF_LOG: Final = f"{EGO} of the log"


def with_recorded(cfg: ReplayConfig, attachments: Iterable[Attachment], source: object) -> ReplayConfig:
    """The configuration with what an earlier replay recorded about its log, for the tables that say nothing themselves.

    ``source`` is the log.

    Raises:
        ConfigError: the record cannot be read.
    """
    toml, tables = next((item.data for item in attachments if item.name == CONFIG_ATTACHMENT), b""), {}
    with suppress(ConfigError):  # of another program; the settings are not needed
        tables = {name: table for name, table in parsed_toml(toml).items() if name in ABOUT_THE_LOG}
    where = f"{source}: attachment {CONFIG_ATTACHMENT}: "
    return cfg.with_log_facts(validated(tables, where)) if tables else cfg


def attachments_about_log(cfg: ReplayConfig) -> tuple[Attachment, ...]:
    """The record that ``with_recorded`` reads; empty if the configuration says nothing about the log."""
    tables = ReplayConfig().with_log_facts(cfg)
    toml = "" if tables == ReplayConfig() else tables.to_toml()
    return (Attachment(CONFIG_ATTACHMENT, "application/toml", toml.encode()),) if toml else ()


def rig_of_log(summary: LogSummary, roles: RoleAssignment, cfg: ReplayConfig) -> Rig:
    """The cameras and mountings that replace those of a log.

    Raises:
        DumpError: the calibration does not fit the log.
        LogError: the log cannot be read.
    """
    front = roles.reference
    if cfg.calibration == CalibrationConfig() or front is None:
        return NO_RIG
    wanted = [role for role in (front, *_SENSORS) if role in roles.topics]
    found = {role: _sensor(summary, roles, role, cfg) for role in dict.fromkeys(wanted)}
    sensors = {role: sensor for role, sensor in found.items() if sensor is not None}
    return replacing_rig(cfg.calibration, sensors, front) if front in sensors else NO_RIG


def first_latched(summary: LogSummary, roles: RoleAssignment, cfg: ReplayConfig | None = None) -> LatchedState:
    """The first calibration of each camera and the first transforms, with those that the log records instead.

    Raises:
        RoadpercError: the log, or the calibration that it or ``cfg`` says, cannot be read.
    """
    cfg = with_recorded(cfg or ReplayConfig(), summary.attachments, summary.path)
    latched, problems = LatchedState(), Problems()
    for kind in LATCHED_KINDS:
        topics = {role: topic for role, topic in roles.topics.items() if ROLES[role].kind == kind}
        messages = islice(log.read(summary, topics=tuple(topics.values())), _MOST_LATCHED) if topics else ()
        items = decoded_messages(messages, replace(roles, topics=topics), "auto", problems, cfg.limits)
        for item in without_loops(items, latched.tree, topics, problems, cfg.limits):
            latched = latched if item.role in latched.cameras else latched.updated(item.role, item.payload)
    return replaced(latched, rig_of_log(summary, roles, cfg), roles.reference or "image")


def _sensor(summary: LogSummary, roles: RoleAssignment, role: str, cfg: ReplayConfig) -> LogSensor | None:
    """The sensor by its first readable message; None without one."""
    topic = roles.topics[role]
    messages = islice(log.read(summary, topics=(topic,)), _PROBED)
    items = decoded_messages(messages, replace(roles, topics={role: topic}), cfg.tag_table, Problems(), cfg.limits)
    return next(_readable(topic, items), None)


def _readable(topic: str, items: Iterable[Stamped]) -> Iterator[LogSensor]:
    for item in items:
        with suppress(DecodeError):
            match item.payload:
                case CameraImage() | DepthImage() as image:
                    yield LogSensor(topic, image.frame_id, image.size)
                case TagImage() as image:
                    yield LogSensor(topic, image.frame_id, (image.tags.shape[1], image.tags.shape[0]))
                case PointCloud() as cloud:
                    yield LogSensor(topic, cloud.frame_id)


def as_configured(paired: Paired, rig: Rig, labels: Mapping[str, str]) -> Paired:
    """The messages of an instant with the cameras and mountings of ``rig``, and with known labels."""
    reference = reference_of(paired)
    reference = replace(reference, latched=replaced(reference.latched, rig, reference.role))
    paired = {**paired, reference.role: reference}
    return {role: _relabelled(item, labels) for role, item in paired.items()} if labels else paired


def _relabelled(item: Stamped, labels: Mapping[str, str]) -> Stamped:
    return replace(item, payload=_with_labels(item.payload, labels))


def _with_labels(found: Any, labels: Mapping[str, str]) -> Any:
    match found:
        case Detection():
            return replace(found, label=known_label(found.label, labels))
        case Object():
            return replace(found, detection=_with_labels(found.detection, labels))
        case Objects():
            return replace(found, objects=_with_labels(found.objects, labels))
        case tuple():
            return tuple(_with_labels(part, labels) for part in found)
    return found


def replaced(latched: LatchedState, rig: Rig, reference: str) -> LatchedState:
    """The cameras and transforms with those of ``rig``; ``reference`` is the role of the frames.

    A camera that the log describes as that of the frames is replaced as that one.
    """
    if rig == NO_RIG:
        return latched
    before = latched.cameras.get(calibration_role(reference, latched.cameras))
    after = rig.cameras.get(own_calibration(reference))
    same = {
        role: replace(after, frame_id=camera.frame_id, baseline_m=camera.baseline_m)
        for role, camera in latched.cameras.items()
        if before is not None and after is not None and camera.same_view(before)
    }
    return LatchedState({**latched.cameras, **same, **rig.cameras}, _with_mountings(latched.tree, rig.transforms))


def _with_mountings(tree: TransformTree, edges: tuple[Transform, ...]) -> TransformTree:
    """The tree with these sensors below ego; what was connected with the first one stays so."""
    edges = tuple(edge for edge in edges if edge.child != EGO)
    if not edges:
        return tree
    return TransformTree().updated(map(_renamed, tree.edges.values())).rooted_at(edges[0].child).updated(edges)


def _renamed(edge: Transform) -> Transform:
    """The edge with another name for the log's ego, which is not that of the given mountings."""
    parent, child = (_EGO_OF_LOG if name == EGO else name for name in (edge.parent, edge.child))
    return Transform(parent, child, edge.parent_T_child)
