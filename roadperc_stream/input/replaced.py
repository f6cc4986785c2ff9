"""Replaces the cameras and mountings of a log by those of the configuration, now or of the replay that wrote it."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig, validated
from roadperc_stream.config.calibration import CalibrationConfig
from roadperc_stream.config.settings import parsed_toml
from roadperc_stream.config.stages import ABOUT_THE_LOG
from roadperc_stream.errors import ConfigError, DecodeError, DumpError
from roadperc_stream.geometry import Camera
from roadperc_stream.input.calibrations import GivenCalibration, Size, calibration_role, own_calibration
from roadperc_stream.input.stream import RoleAssignment, decoded_messages
from roadperc_stream.input.sync import Paired, reference_of
from roadperc_stream.input.transforms import NOTHING_LATCHED, LatchedState, TransformTree
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


def given_for(summary: LogSummary, roles: RoleAssignment, cfg: ReplayConfig) -> LatchedState:
    """The cameras and mountings that replace those of a log.

    Raises:
        DumpError: the calibration does not fit the log.
        LogError: the log cannot be read.
    """
    front = roles.reference
    if cfg.calibration == CalibrationConfig() or front is None:
        return NOTHING_LATCHED
    wanted = dict.fromkeys(role for role in (front, *_SENSORS) if role in roles.topics)
    found = {role: _sensor(summary, roles, role, cfg) for role in wanted}
    sensors = {role: sensor for role, sensor in found.items() if sensor is not None}
    return given_to(sensors, cfg.calibration, front) if front in sensors else NOTHING_LATCHED


@dataclass(frozen=True)
class LogSensor:
    """A sensor of a log: the frame and, for a camera, the size of its first readable message."""

    topic: str
    frame_id: str
    size: Size | None = None


def given_to(sensors: Mapping[str, LogSensor], calibration: CalibrationConfig, front: str) -> LatchedState:
    """The cameras and mountings that a calibration gives to the sensors of a log, by role; others stay.

    K, a field of view or a pair at the top are those of the front camera, whose role is ``front``.

    Raises:
        DumpError: the calibration is wrong, incomplete, or of images of another size.
    """
    sizes = {role: sensor.size for role, sensor in sensors.items() if sensor.size}
    known = GivenCalibration.of(calibration, Path("calibration"), sizes, front)
    front_T = known.mountings.get(front, known.mountings.get("image"))
    baseline_m = known.baseline_m(known.mountings.get("left", front_T))
    named = {role for role in sensors if role in known.intrinsics or (known.pair and role in ("left", "right"))}
    if calibration.K or calibration.fov_deg or known.pair:
        named |= {front, "right"} if baseline_m and "right" in sensors else {front}
    cameras = {own_calibration(role): known.camera(sensors[role].frame_id, role) for role in sorted(named)}
    if "right" in named:
        cameras["right_calibration"] = replace(cameras["right_calibration"], baseline_m=baseline_m)
    for role in named:
        _require_size(sensors[role], cameras[own_calibration(role)])
    placed: dict[str, Transform] = {}
    for role, sensor in sensors.items():
        ego_T_sensor = front_T if role == front else known.mountings.get(role)
        if ego_T_sensor is not None:
            edge = Transform(EGO, sensor.frame_id, ego_T_sensor)
            if not np.array_equal(placed.setdefault(edge.child, edge).parent_T_child, ego_T_sensor):
                raise DumpError(f"calibration: two mountings of the frame {edge.child!r}, also of {role}; remove one")
    return LatchedState(cameras, TransformTree(placed))


def _require_size(sensor: LogSensor, camera: Camera) -> None:
    if sensor.size is not None and sensor.size != (camera.width, camera.height):
        found, expected = f"{sensor.size[0]}x{sensor.size[1]}", f"{camera.width}x{camera.height}"
        raise DumpError(
            f"{sensor.topic}: images of {found}, but the given calibration is of {expected}; "
            "pass that of this resolution"
        )


def _sensor(summary: LogSummary, roles: RoleAssignment, role: str, cfg: ReplayConfig) -> LogSensor | None:
    """The sensor by its first readable message; None without one."""
    topic = roles.topics[role]
    messages = islice(log.read(summary, topics=(topic,)), _PROBED)
    for item in decoded_messages(messages, replace(roles, topics={role: topic}), cfg):
        with suppress(DecodeError):
            match item.payload:
                case CameraImage() | DepthImage() as image:
                    return LogSensor(topic, image.frame_id, image.size)
                case TagImage() as image:
                    return LogSensor(topic, image.frame_id, (image.tags.shape[1], image.tags.shape[0]))
                case PointCloud() as cloud:
                    return LogSensor(topic, cloud.frame_id)
    return None


def first_latched(summary: LogSummary, roles: RoleAssignment, cfg: ReplayConfig | None = None) -> LatchedState:
    """The first calibration of each camera and the first transforms, with those that the log records instead.

    Raises:
        RoadpercError: the log, or the calibration that it or ``cfg`` says, cannot be read.
    """
    cfg = with_recorded(cfg or ReplayConfig(), summary.attachments, summary.path)
    latched = NOTHING_LATCHED
    for kind in LATCHED_KINDS:
        topics = {role: topic for role, topic in roles.topics.items() if ROLES[role].kind == kind}
        messages = islice(log.read(summary, topics=tuple(topics.values())), _MOST_LATCHED) if topics else ()
        for item in decoded_messages(messages, replace(roles, topics=topics), cfg):
            latched = latched if item.role in latched.cameras else latched.updated(item.role, item.payload)
    return replaced(latched, given_for(summary, roles, cfg), roles.reference or "image")


def as_configured(paired: Paired, given: LatchedState, labels: Mapping[str, str]) -> Paired:
    """The messages of an instant with the ``given`` cameras and mountings, and with known labels."""
    reference = reference_of(paired)
    reference = replace(reference, latched=replaced(reference.latched, given, reference.role))
    paired = {**paired, reference.role: reference}
    if not labels:
        return paired
    return {role: replace(item, payload=_with_labels(item.payload, labels)) for role, item in paired.items()}


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


def replaced(latched: LatchedState, given: LatchedState, reference: str) -> LatchedState:
    """The cameras and transforms with the ``given`` ones; ``reference`` is the role of the frames.

    Cameras of the log with the view of the frames' camera are replaced too. Given mountings are below ego; what was
    connected with the first of their frames stays connected with it.
    """
    before = latched.cameras.get(calibration_role(reference, latched.cameras))
    after = given.cameras.get(own_calibration(reference))
    same = {
        role: replace(after, frame_id=camera.frame_id, baseline_m=camera.baseline_m)
        for role, camera in latched.cameras.items()
        if before is not None and after is not None and camera.same_view(before)
    }
    tree = latched.tree
    if edges := [edge for edge in given.tree.edges.values() if edge.child != EGO]:
        tree = TransformTree().updated(map(_renamed, tree.edges.values())).rooted_at(edges[0].child).updated(edges)
    return LatchedState({**latched.cameras, **same, **given.cameras}, tree)


def _renamed(edge: Transform) -> Transform:
    """The edge with another name for the log's ego, which is not that of the given mountings."""
    parent, child = (_EGO_OF_LOG if name == EGO else name for name in (edge.parent, edge.child))
    return Transform(parent, child, edge.parent_T_child)
