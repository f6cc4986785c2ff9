"""Collects the facts of a log in one pass."""

from collections.abc import Mapping

from roadperc_stream.config import ReplayConfig
from roadperc_stream.geometry import Camera
from roadperc_stream.info.facts import CameraFacts, ChannelFacts, FileFacts, LogFacts, ReplayFacts, provenance_of
from roadperc_stream.info.scan import Scan, Tally
from roadperc_stream.input.assemble import ego_T_camera_of
from roadperc_stream.input.earlier_replay import is_result_log
from roadperc_stream.input.topics import CAMERA_OF
from roadperc_stream.log import AnyLog, Channel, Recovery, Salvage
from roadperc_stream.schemas.record import CONVERSION_RECORD, PRODUCER, TAG_TABLE_KEY, log_id_of
from roadperc_stream.system.time import ns_to_seconds


def examine(source: AnyLog, overrides: Mapping[str, str], cfg: ReplayConfig | None = None) -> LogFacts:
    """Return the facts of a log, from one pass.

    ``overrides`` are topics by role, from ``--topic``; ``cfg`` says what the log does not.

    Raises:
        LogError: the file cannot be opened, or is not a log. A damaged log raises no error.
    """
    scan = Scan.of(source, overrides, cfg or ReplayConfig())
    salvage, tallies = scan.salvage, scan.tallies.values()
    first_ns = min((tally.first_ns for tally in tallies if tally.first_ns is not None), default=None)
    last_ns = max((tally.last_ns for tally in tallies), default=None)
    described = salvage.described
    result = is_result_log((item.name for item in described.metadata), salvage.channels.values())
    digest = scan.digest()
    return LogFacts(
        log=str(source),
        kind="result" if result else "input",
        log_id=None if digest is None else log_id_of(digest),
        file=_file_facts(salvage),
        messages=salvage.counts.total(),
        first_ns=first_ns,
        last_ns=last_ns,
        span_s=_seconds(last_ns, (first_ns or 0) + scan.pauses_ns) or 0.0,
        log_times_back=scan.log_times_back,
        channels=tuple(_channel_facts(salvage.channels[i], scan, first_ns) for i in sorted(salvage.channels)),
        replay=_replay_facts(scan),
        provenance=provenance_of(salvage.path, described.metadata, described.attachments, digest) if result else None,
    )


def _seconds(at_ns: int | None, from_ns: int | None) -> float | None:
    return None if at_ns is None or from_ns is None else ns_to_seconds(at_ns - from_ns)


def _file_facts(salvage: Salvage) -> FileFacts:
    return FileFacts(
        size_bytes=salvage.size_bytes,
        profile=salvage.described.profile,
        library=salvage.described.library,
        chunks=dict(salvage.chunks),
        whole=salvage.whole,
        damages=tuple(salvage.damages),
        last_good_ns=salvage.losses.last_good_ns,
        recovery=Recovery.of_records(salvage.described.metadata),
        absent=salvage.absent,
        notes=salvage.notes,
        attachments={item.name: len(item.data) for item in salvage.described.attachments},
        metadata=tuple(record.name for record in salvage.described.metadata),
        conversion=dict(next((r.values for r in salvage.described.metadata if r.name == CONVERSION_RECORD), ())),
    )


def _channel_facts(channel: Channel, scan: Scan, first_ns: int | None) -> ChannelFacts:
    tally = scan.tallies.get(channel.source_id, Tally(None))
    median_s = tally.intervals.median_s()
    return ChannelFacts(
        topic=channel.topic,
        schema=channel.schema_name,
        schema_encoding=channel.schema_encoding,
        message_encoding=channel.message_encoding,
        result=PRODUCER in channel.metadata,
        messages=tally.messages,
        size_bytes=tally.size_bytes,
        first_ns=tally.first_ns,
        last_ns=tally.last_ns if tally.messages else None,
        rate_hz=1 / median_s if median_s else None,
        jitter_s=tally.intervals.jitter_s(),
        longest_gap_s=None if median_s is None else ns_to_seconds(tally.longest_gap_ns),
        gap_at_s=_seconds(tally.gap_after_ns, first_ns),
        log_times_back=tally.log_times_back,
        stamps_back=tally.stamps_back,
        stamps_back_at_s=_seconds(tally.first_back_ns, first_ns),
        stamps_repeated=tally.stamps_repeated,
        stamps_unset=tally.stamps_unset,
    )


def _replay_facts(scan: Scan) -> ReplayFacts:
    roles, topics = scan.roles, scan.roles.assignment.topics
    return ReplayFacts(
        refusal=roles.refusal,
        options=roles.options,
        notes=roles.assignment.notes,
        roles=roles.states,
        reference=roles.assignment.reference,
        frames=scan.frames,
        segments=scan.segments,
        alone=dict(scan.alone),
        unused=dict(scan.dropped),
        skew_s=_seconds(scan.skew_ns, 0),
        cameras=tuple(_camera_facts(role, camera, scan) for role, camera in scan.latched.cameras.items()),
        tag_table=_tag_table(scan, topics.get("segmentation")),
        unreadable=dict(scan.problems.counts),
        problems=tuple(scan.problems.first.values()),
        findings=scan.findings,
    )


def _camera_facts(role: str, camera: Camera, scan: Scan) -> CameraFacts:
    ego_T_camera = ego_T_camera_of(scan.latched.tree, camera)
    mounting = None if ego_T_camera is None else tuple(map(tuple, ego_T_camera.tolist()))
    return CameraFacts(role, camera, mounting, scan.sizes.get(CAMERA_OF[role]))


def _tag_table(scan: Scan, topic: str | None) -> str | None:
    """The tag table that the segmentation channel names, else the one that the replay of a result used."""
    channels = (channel for channel in scan.salvage.channels.values() if channel.topic == topic)
    named = next((channel.label(TAG_TABLE_KEY) for channel in channels if channel.label(TAG_TABLE_KEY)), None)
    return named or scan.roles.assignment.tag_table or None
