"""The facts of a log; their fields are the keys of ``roadperc-info --json``.

Log times are integer nanoseconds. JSON has null for None and for numbers that are not finite.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from roadperc_stream.geometry import Camera
from roadperc_stream.info.role_states import RoleState
from roadperc_stream.log import Damage, Recovery
from roadperc_stream.model.finding import Finding


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


@dataclass
class ChannelFacts:
    """A channel and the times of its messages, in the order of the file."""

    topic: str
    schema: str
    schema_encoding: str
    message_encoding: str
    result: bool
    """Whether a replay wrote it."""
    messages: int = 0
    size_bytes: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    rate_hz: float | None = None
    """From the median interval of log times; None without intervals."""
    longest_gap_s: float | None = None
    gap_at_s: float | None = None
    """Start of the longest gap, in seconds from the log's first message."""
    log_times_back: int = 0
    """Messages after one of the same channel with a later log time."""
    stamps_back: int = 0
    """Messages of a role whose own stamp is earlier than that of the previous message."""
    stamps_repeated: int = 0
    """Messages of a role whose own stamp equals that of the previous message."""


@dataclass(frozen=True)
class CameraFacts:
    """The last calibration of a role."""

    role: str
    camera: Camera
    ego_T_camera: tuple[tuple[float, ...], ...] | None
    """The camera's mounting from the transforms; None if they lack it."""
    image_size: tuple[int, int] | None
    """(width, height) of its first readable image; None without images."""


@dataclass
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
    frames: int = 0
    segments: int = 1
    """Sections with increasing stamps; several after a second recording, a looped bag, or a clock that was set."""
    alone: Mapping[str, int] = field(default_factory=dict)
    """Frames without a message of an assigned role within the tolerance, by role."""
    unused: Mapping[str, int] = field(default_factory=dict)
    """Messages by role that belong to no frame."""
    skew_s: float | None = None
    """Largest difference of stamps within a frame."""
    cameras: tuple[CameraFacts, ...] = ()
    tag_table: str | None = None
    """From the segmentation channel, else from the replay that wrote the log."""
    unreadable: Mapping[str, int] = field(default_factory=dict)
    """Messages of assigned roles that cannot be decoded, by topic."""
    problems: tuple[str, ...] = ()
    """The first problem of each topic, as text."""
    findings: tuple[Finding, ...] = ()
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
