"""The facts of a log; their fields are the keys of ``roadperc-info --json``.

Log times are integer nanoseconds. JSON has null for None and for numbers that are not finite.
"""

import hashlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from roadperc_stream.config import ReplayConfig
from roadperc_stream.config.settings import NOT_SET, as_typed, is_about_log, settings_in
from roadperc_stream.errors import ConfigError, TableError
from roadperc_stream.geometry import Camera
from roadperc_stream.info.role_states import RoleState
from roadperc_stream.input.earlier_replay import replay_record
from roadperc_stream.log import Attachment, Damage, Metadata, Recovery
from roadperc_stream.model.finding import Finding, decoded_findings
from roadperc_stream.output.tables import read_footer, sidecar_path
from roadperc_stream.schemas import record
from roadperc_stream.system.text import whole_number


@dataclass(frozen=True)
class ResolvedSetting:
    """A setting that differs from its default."""

    key: str
    value: str
    default: str | None
    """None if this version does not have the setting."""


@dataclass(frozen=True)
class SidecarTable:
    """A table beside the log."""

    path: str
    rows: int | None
    fault: str = ""
    """Why it does not belong to this log; empty if it belongs."""


@dataclass(frozen=True)
class Provenance:
    """The replay that wrote a result, as the result records it."""

    version: str
    seed: str
    digest: str
    digest_found: str | None
    """Digest of the input's messages in the file; None if they are missing or not all readable."""
    frames: int | None
    continues: str | None
    """``log_id`` of the log that it continues; None for a new replay."""
    dropped: Mapping[str, int]
    """Messages by role that belonged to no frame."""
    config_digest: str | None
    settings: tuple[ResolvedSetting, ...]
    config_fault: str
    tables: tuple[SidecarTable, ...]
    findings: tuple[Finding, ...] = ()
    """Contradictions that the replay found."""

    @property
    def changed(self) -> bool:
        """Whether the input's messages differ from the replayed ones."""
        return self.digest_found is not None and self.digest_found != self.digest


def provenance_of(
    path: Path, metadata: Collection[Metadata], attachments: Iterable[Attachment], digest_found: str | None
) -> Provenance:
    """The provenance from a result's metadata record, its configuration and the tables beside it."""
    facts = replay_record(metadata)
    toml = next((item.data for item in attachments if item.name == record.CONFIG_ATTACHMENT), None)
    config_digest = None if toml is None else hashlib.sha256(toml).hexdigest()
    settings, fault = _settings(toml)
    digest = facts.get(record.DIGEST_KEY, "")
    return Provenance(
        version=facts.get(record.VERSION_KEY, ""),
        seed=facts.get(record.SEED_KEY, ""),
        digest=digest,
        digest_found=digest_found,
        frames=whole_number(facts.get(record.FRAMES_KEY, "")),
        continues=facts.get(record.CONTINUES_KEY),
        dropped={
            name.removeprefix(record.DROPPED_KEY): whole_number(value) or 0
            for name, value in facts.items()
            if name.startswith(record.DROPPED_KEY)
        },
        config_digest=config_digest,
        settings=settings,
        config_fault=fault,
        tables=tuple(_table(sidecar_path(path, name), digest, config_digest) for name in ("metrics", "objects")),
        findings=decoded_findings(facts.get(record.FINDINGS_KEY, "")),
    )


def _settings(toml: bytes | None) -> tuple[tuple[ResolvedSetting, ...], str]:
    """The settings that differ from this version's defaults, or why they are unknown."""
    if toml is None:
        return (), f"no attachment {record.CONFIG_ATTACHMENT}"
    try:
        found = settings_in(toml)
    except ConfigError as error:
        return (), f"attachment {record.CONFIG_ATTACHMENT} is {error}"
    defaults = settings_in(ReplayConfig().to_toml().encode())
    differing = [key for key, value in found.items() if key not in defaults or defaults[key] != value]
    known = {key: as_typed(value) for key, value in defaults.items()}
    known |= {key: NOT_SET for key in differing if is_about_log(key)}
    return tuple(ResolvedSetting(key, as_typed(found[key]), known.get(key)) for key in differing), ""


def _table(path: Path, digest: str, config_digest: str | None) -> SidecarTable:
    if not path.exists():
        return SidecarTable(str(path), None, "missing")
    try:
        footer = read_footer(path)
    except TableError as error:
        return SidecarTable(str(path), None, str(error).removeprefix(f"{path}: "))
    log_id = footer.facts.get(record.LOG_ID_KEY)
    if log_id != record.log_id_of(digest):
        return SidecarTable(str(path), footer.rows, f"belongs to log {log_id}")
    if footer.facts.get("config_digest") != config_digest:
        return SidecarTable(str(path), footer.rows, "belongs to another configuration")
    return SidecarTable(str(path), footer.rows)


@dataclass(frozen=True)
class FileFacts:
    """The file and its damage."""

    size_bytes: int
    profile: str
    library: str
    """The library that wrote it."""
    chunks: Mapping[str, int]
    """Chunks by compression, empty for none."""
    whole: bool
    damages: tuple[Damage, ...]
    last_good_ns: int | None
    """Log time of the last message before the first damage."""
    recovery: Recovery | None
    """Counts of an earlier repair, as the repaired log records them."""
    absent: tuple[str, ...]
    """Optional parts of a log that this one lacks: index, CRCs."""
    notes: tuple[str, ...]
    """What is wrong in the log without harm."""
    attachments: Mapping[str, int]
    """Bytes by name."""
    metadata: tuple[str, ...]
    """Names of its records."""
    conversion: Mapping[str, str]
    """The conversion that ``roadperc-convert`` recorded; empty for other logs."""


@dataclass(frozen=True)
class ChannelFacts:
    """A channel and the times of its messages, in the order of the file."""

    topic: str
    schema: str
    schema_encoding: str
    message_encoding: str
    result: bool
    """Whether a replay wrote it."""
    messages: int
    size_bytes: int
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    """From the median interval of log times; None without intervals."""
    jitter_s: float | None
    """95 % of the intervals differ from the median by at most this."""
    longest_gap_s: float | None
    gap_at_s: float | None
    """Start of the longest gap. All ``at_s`` times are seconds from the log's first message."""
    log_times_back: int
    """Messages after one of the same channel with a later log time."""
    stamps_back: int
    """Messages whose own stamp is earlier than that of the previous message."""
    stamps_back_at_s: float | None
    stamps_repeated: int
    """Messages whose own stamp equals that of the previous message."""
    stamps_unset: int
    """Messages whose schema has a stamp that is zero or unreadable."""


@dataclass(frozen=True)
class CameraFacts:
    """The last calibration of a role."""

    role: str
    camera: Camera
    ego_T_camera: tuple[tuple[float, ...], ...] | None
    """The camera's mounting from the transforms; None if they lack it."""
    image_size: tuple[int, int] | None
    """(width, height) of its first readable image; None without images."""


@dataclass(frozen=True)
class ReplayFacts:
    """What a replay would do with the log."""

    refusal: str | None
    """Why a replay would stop before its first frame."""
    options: Mapping[str, str]
    """Topics by role, for ``--topic``, with which it would not stop."""
    notes: tuple[str, ...]
    """Notes on guessed and missing roles."""
    roles: tuple[RoleState, ...]
    reference: str | None
    """The role whose messages make the frames."""
    frames: int
    segments: int
    """Sections with increasing stamps; several after a second recording, a looped bag, or a clock that was set."""
    alone: Mapping[str, int]
    """Frames without a message of an assigned role within the tolerance, by role."""
    unused: Mapping[str, int]
    """Messages by role that belong to no frame."""
    skew_s: float | None
    """Largest difference of stamps within a frame."""
    cameras: tuple[CameraFacts, ...]
    tag_table: str | None
    """From the segmentation channel, else from the replay that wrote the log."""
    unreadable: Mapping[str, int]
    """Messages of assigned roles that cannot be decoded, by topic."""
    problems: tuple[str, ...]
    """The first problem of each topic, as text."""
    findings: tuple[Finding, ...]
    """Contradictions in the input."""


@dataclass(frozen=True)
class LogFacts:
    """The facts of a log."""

    log: str
    """Its path."""
    kind: Literal["input", "result"]
    log_id: str | None
    """The id that a replay of the whole log gives it; None if a message is unreadable."""
    file: FileFacts
    messages: int
    first_ns: int | None
    last_ns: int | None
    span_s: float
    """Without pauses of more than an hour."""
    log_times_back: int
    """Messages after one of any channel with a later log time."""
    channels: tuple[ChannelFacts, ...]
    replay: ReplayFacts
    provenance: Provenance | None
    """Only for results."""
