"""Collects the facts of a log."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ConfigError, DumpError, LogError
from roadperc_stream.geometry import Camera
from roadperc_stream.info.facts import CameraFacts, FileFacts, LogFacts
from roadperc_stream.info.measures import Measures
from roadperc_stream.info.provenance import provenance_of
from roadperc_stream.info.role_states import roles_of, with_given
from roadperc_stream.info.scan import Scan, channel_facts
from roadperc_stream.input.assemble import ego_T_camera_of
from roadperc_stream.input.earlier_replay import is_result, is_result_log, recorded_tag_table, recorded_topics
from roadperc_stream.input.findings import InputEvidence
from roadperc_stream.input.replaced import given_for, replaced, with_recorded
from roadperc_stream.input.topics import CAMERA_OF
from roadperc_stream.log import AnyLog, LogSummary, Recovery, Salvage
from roadperc_stream.schemas.record import CONVERSION_RECORD, TAG_TABLE_KEY, log_id_of
from roadperc_stream.system.time import ns_to_seconds


def examine(
    source: AnyLog,
    overrides: Mapping[str, str],
    cfg: ReplayConfig | None = None,
    measures: Measures | None = None,
) -> LogFacts:
    """Return the facts of a log.

    ``overrides`` are topics by role, from ``--topic``; ``cfg`` says what the log does not. ``measures`` collects what a
    contract limits.

    Raises:
        LogError: the file cannot be opened, or is not a log. A damaged log raises no error.
    """
    first, cfg = log.audited(source), cfg or ReplayConfig()
    metadata = first.described.metadata
    present = tuple(first.channels[number] for number in sorted(first.channels) if first.counts[number])
    roles = roles_of(present, {**recorded_topics(metadata, present), **overrides})
    roles = replace(roles, assignment=replace(roles.assignment, tag_table=recorded_tag_table(metadata)))
    with suppress(ConfigError):  # the record of a result is listed with its fault
        cfg = with_recorded(cfg, first.described.attachments, first.path)
    tags = [c.source_id for c in present if c.topic == roles.assignment.topics.get("segmentation")]
    if measures is not None:
        for channel in present:
            measures.topics[channel.topic].expected += first.counts[channel.source_id]
    scan = Scan(roles, cfg, InputEvidence(cfg.labels, sum(first.counts[number] for number in tags)), measures)
    salvage, summary = Salvage(source), None
    scan.run(salvage.messages())
    if first.whole:
        with suppress(LogError):
            summary = log.summarise(source)
    _finish_replay(scan, salvage, summary)
    facts = _facts(scan, salvage, summary)
    if measures is not None:
        measures.end(facts, scan.latched, scan.evidence)
    return facts


def _finish_replay(scan: Scan, salvage: Salvage, summary: LogSummary | None) -> None:
    """Fill in the facts that need the whole log: cameras, tag table, findings."""
    roles, replay = scan.roles, scan.replay
    replay.tag_table = next(_tag_tables(roles.topics.get("segmentation"), salvage), roles.tag_table) or None
    if roles.reference is not None:
        if summary is not None:
            try:
                given = given_for(summary, roles, scan.cfg)
                scan.latched = replaced(scan.latched, given, roles.reference)
                replay.roles = with_given(replay.roles, given.cameras, mounted=bool(given.tree.edges))
            except DumpError as error:  # a wrong camera in the configuration
                replay.refusal = str(error)
        replay.findings = scan.evidence.findings(scan.cfg, roles.topics, roles.reference, scan.latched)
    replay.cameras = tuple(_camera_facts(role, camera, scan) for role, camera in scan.latched.cameras.items())


def _facts(scan: Scan, salvage: Salvage, summary: LogSummary | None) -> LogFacts:
    described, channels = salvage.described, sorted(salvage.channels.items())
    first_ns = scan.first_ns
    last_ns = max((tally.facts.last_ns or 0 for tally in scan.tallies.values()), default=None)
    result = is_result_log((item.name for item in described.metadata), salvage.channels.values())
    digest = _digest(scan, summary) if salvage.whole else None
    return LogFacts(
        log=str(salvage.source),
        kind="result" if result else "input",
        log_id=None if digest is None else log_id_of(digest),
        file=_file_facts(salvage),
        messages=salvage.counts.total(),
        first_ns=first_ns,
        last_ns=last_ns,
        span_s=0.0 if last_ns is None else ns_to_seconds(last_ns - (first_ns or 0) - scan.pauses_ns),
        log_times_back=scan.log_times_back,
        channels=tuple(scan.tallies[i].facts if i in scan.tallies else channel_facts(c) for i, c in channels),
        replay=scan.replay,
        provenance=provenance_of(salvage.path, described.metadata, described.attachments, digest) if result else None,
    )


def _digest(scan: Scan, summary: LogSummary | None) -> str | None:
    """Digest of the input's messages in log-time order; None if there are none or the log cannot be read.

    Reads the messages again if the file is in another order.
    """
    if summary is None or not scan.inputs:
        return None
    if not scan.inputs_back:
        return scan.digest.hexdigest()
    digest = log.MessageDigest()
    for message in log.read(summary):
        if not is_result(message.channel):
            digest.update(message)
    return digest.hexdigest()


def _file_facts(salvage: Salvage) -> FileFacts:
    described = salvage.described
    return FileFacts(
        size_bytes=salvage.size_bytes,
        profile=described.profile,
        library=described.library,
        chunks=dict(salvage.chunks),
        whole=salvage.whole,
        damages=tuple(salvage.damages),
        last_good_ns=salvage.losses.last_good_ns,
        recovery=Recovery.of_records(described.metadata),
        absent=salvage.absent,
        notes=salvage.notes,
        attachments={item.name: len(item.data) for item in described.attachments},
        metadata=tuple(record.name for record in described.metadata),
        conversion=dict(next((r.values for r in described.metadata if r.name == CONVERSION_RECORD), ())),
    )


def _camera_facts(role: str, camera: Camera, scan: Scan) -> CameraFacts:
    ego_T_camera = ego_T_camera_of(scan.latched.tree, camera)
    mounting = None if ego_T_camera is None else tuple(map(tuple, ego_T_camera.tolist()))
    return CameraFacts(role, camera, mounting, scan.sizes.get(CAMERA_OF[role]))


def _tag_tables(topic: str | None, salvage: Salvage) -> Iterator[str]:
    """The tag tables that the channels of a topic name."""
    for channel in salvage.channels.values():
        if channel.topic == topic and (name := channel.label(TAG_TABLE_KEY)):
            yield name
