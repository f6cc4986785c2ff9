"""What is known of a log: the keys of ``roadperc-info --json`` are these fields. Times of logs are integer ns.

JSON has null for None, and for numbers that are not finite.
"""

import hashlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from roadperc_stream.config import ReplayConfig
from roadperc_stream.config.settings import as_typed, settings_in
from roadperc_stream.errors import ConfigError, TableError
from roadperc_stream.geometry import Camera
from roadperc_stream.info.role_states import RoleState
from roadperc_stream.input.earlier_replay import digest_algorithm, replay_record
from roadperc_stream.log import Attachment, Damage, Metadata, Recovery
from roadperc_stream.output.tables import read_footer, sidecar_path
from roadperc_stream.schemas.record import (
    CONFIG_ATTACHMENT,
    CONTINUES_KEY,
    DIGEST_KEY,
    DROPPED_KEY,
    FRAMES_KEY,
    SEED_KEY,
    VERSION_KEY,
    log_id_of,
)


@dataclass(frozen=True)
class ResolvedSetting:
    """A setting that is not at its default."""

    key: str
    value: str
    default: str | None
    """None where this version knows no such setting."""


@dataclass(frozen=True)
class SidecarTable:
    """A table beside the log."""

    path: str
    rows: int | None
    fault: str = ""
    """Why it does not belong to this log; empty if it does."""


@dataclass(frozen=True)
class Provenance:
    """What a result says of the replay that wrote it."""

    version: str
    seed: str
    digest: str
    digest_algorithm: str
    digest_found: str | None
    """Digest of the input's messages as they are in the file now; None where they are not there or not all readable."""
    frames: int | None
    continues: str | None
    """``log_id`` of the log that it continues; None if it continues none."""
    dropped: Mapping[str, int]
    """Messages by role that belonged to no frame."""
    config_digest: str | None
    settings: tuple[ResolvedSetting, ...]
    config_fault: str
    tables: tuple[SidecarTable, ...]

    @property
    def changed(self) -> bool:
        """Whether the input's messages are not those that were replayed."""
        return self.digest_found is not None and self.digest_found != self.digest


def provenance_of(
    path: Path, metadata: Collection[Metadata], attachments: Iterable[Attachment], digest_found: str | None
) -> Provenance:
    """What the log's metadata record and its configuration say, and whether the tables beside it belong to it."""
    facts = replay_record(metadata)
    toml = next((item.data for item in attachments if item.name == CONFIG_ATTACHMENT), None)
    config_digest = None if toml is None else hashlib.sha256(toml).hexdigest()
    settings, fault = _settings(toml)
    digest = facts.get(DIGEST_KEY, "")
    return Provenance(
        version=facts.get(VERSION_KEY, ""),
        seed=facts.get(SEED_KEY, ""),
        digest=digest,
        digest_algorithm=digest_algorithm(metadata),
        digest_found=digest_found,
        frames=_number(facts.get(FRAMES_KEY, "")),
        continues=facts.get(CONTINUES_KEY),
        dropped={
            name.removeprefix(DROPPED_KEY): _number(value) or 0
            for name, value in facts.items()
            if name.startswith(DROPPED_KEY)
        },
        config_digest=config_digest,
        settings=settings,
        config_fault=fault,
        tables=tuple(_table(sidecar_path(path, name), digest, config_digest) for name in ("metrics", "objects")),
    )


def _settings(toml: bytes | None) -> tuple[tuple[ResolvedSetting, ...], str]:
    """The settings that differ from this version's defaults, or why there is no knowing."""
    if toml is None:
        return (), f"no attachment {CONFIG_ATTACHMENT}"
    try:
        found = settings_in(toml)
    except ConfigError as error:
        return (), f"attachment {CONFIG_ATTACHMENT} is {error}"
    defaults = settings_in(ReplayConfig().to_toml().encode())
    differing = [key for key, value in found.items() if key not in defaults or defaults[key] != value]
    known = {key: as_typed(value) for key, value in defaults.items()}
    return tuple(ResolvedSetting(key, as_typed(found[key]), known.get(key)) for key in differing), ""


def _number(text: str) -> int | None:
    return int(text) if text.isdecimal() else None


def _table(path: Path, digest: str, config_digest: str | None) -> SidecarTable:
    if not path.exists():
        return SidecarTable(str(path), None, "is not there")
    try:
        footer = read_footer(path)
    except TableError as error:
        return SidecarTable(str(path), None, str(error).removeprefix(f"{path}: "))
    if footer.log_id not in (None, log_id_of(digest)):
        return SidecarTable(str(path), footer.rows, f"is of log {footer.log_id}")
    if footer.facts.get("config_digest") != config_digest:
        return SidecarTable(str(path), footer.rows, "is of another configuration")
    return SidecarTable(str(path), footer.rows)


@dataclass(frozen=True)
class FileFacts:
    """The file itself, and how whole it is."""

    size_bytes: int
    profile: str
    library: str
    """What wrote it."""
    chunks: Mapping[str, int]
    """Chunks by compression, empty for none."""
    whole: bool
    damages: tuple[Damage, ...]
    last_good_ns: int | None
    """Log time of the last message before the first damage."""
    recovery: Recovery | None
    """What an earlier repair saved and lost, as the repaired log records it."""
    absent: tuple[str, ...]
    """What a log may do without and this one does: index, CRCs."""
    attachments: Mapping[str, int]
    """Bytes by name."""
    metadata: tuple[str, ...]
    """Names of its records."""
    conversion: Mapping[str, str]
    """What ``roadperc-convert`` says of how it made the log; empty of other logs."""


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
    """Of the median interval of log times; None without intervals."""
    jitter_s: float | None
    """95 % of the intervals differ from the median by no more than this."""
    longest_gap_s: float | None
    gap_at_s: float | None
    """Where the longest gap starts, seconds from the log's first message; so are all times that end in ``at_s``."""
    log_times_back: int
    """Messages after one of the same channel with a later log time."""
    stamps_back: int
    """Messages whose own stamp is before that of the message before."""
    stamps_back_at_s: float | None
    stamps_repeated: int
    """Messages whose own stamp is that of the message before."""
    stamps_unset: int
    """Messages of a schema with a stamp whose stamp is zero or cannot be read."""


@dataclass(frozen=True)
class CameraFacts:
    """What a calibration says, the last one of its role."""

    role: str
    camera: Camera
    ego_T_camera: tuple[tuple[float, ...], ...] | None
    """The camera's place by the transforms; None where they do not give it."""
    image_size: tuple[int, int] | None
    """(width, height) of the first of its images that can be decoded; None without images."""


@dataclass(frozen=True)
class ReplayFacts:
    """What a replay would make of the log."""

    refusal: str | None
    """Why it would stop before its first frame."""
    notes: tuple[str, ...]
    """What was guessed."""
    roles: tuple[RoleState, ...]
    reference: str | None
    """The role whose messages make the frames."""
    frames: int
    segments: int
    """Parts with continuous stamps: more than one after a second recording or a looped bag."""
    alone: Mapping[str, int]
    """Frames for which an assigned role has no message within the tolerance, by role."""
    unused: Mapping[str, int]
    """Messages by role that belong to no frame."""
    skew_s: float | None
    """Largest difference of stamps within a frame."""
    cameras: tuple[CameraFacts, ...]
    tag_table: str | None
    """As the segmentation's channel names it, else as the user of the replay did that made the log."""
    unreadable: Mapping[str, int]
    """Messages of assigned roles that cannot be decoded, by topic."""
    problems: tuple[str, ...]
    """The first of each in words."""


@dataclass(frozen=True)
class LogFacts:
    """All that is known of a log."""

    log: str
    """Its path."""
    kind: Literal["input", "result"]
    log_id: str | None
    """What a replay of the whole log calls it; None where not all messages can be read."""
    file: FileFacts
    messages: int
    first_ns: int | None
    last_ns: int | None
    span_s: float
    log_times_back: int
    """Messages after one of any channel with a later log time."""
    channels: tuple[ChannelFacts, ...]
    replay: ReplayFacts
    provenance: Provenance | None
    """Of results alone."""
