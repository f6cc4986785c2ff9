"""What is known of a log: the keys of ``roadperc-info --json`` are these fields. Times of logs are integer ns.

JSON has null for None, and for numbers that are not finite.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from roadperc_stream.core.geometry import Camera
from roadperc_stream.info.provenance import Provenance
from roadperc_stream.info.role_states import RoleState
from roadperc_stream.log import Damage, Recovery


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
    """Of the median interval of log times; None where there is none."""
    jitter_s: float | None
    """95 % of the intervals differ from the median by no more than this."""
    longest_gap_s: float | None
    gap_at_s: float | None
    """Where the longest gap starts, seconds from the log's first message; so are all times that end in ``at_s``."""
    log_times_back: int
    """Messages that stand in the file behind one of the channel with a later log time."""
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
    """(width, height) of the first of its images that can be decoded; None where there is none."""


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
    """Parts of the log whose stamps go on, each begun anew: another recording, or a bag that was played in a loop."""
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
    """Messages that stand in the file behind one with a later log time, of any channel."""
    channels: tuple[ChannelFacts, ...]
    replay: ReplayFacts
    provenance: Provenance | None
    """Of results alone."""
