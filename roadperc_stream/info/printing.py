"""Prints the facts of a log: file, channels and their times, roles for a replay, provenance of a result."""

from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote
from typing import Final

from rich.console import Console
from rich.filesize import decimal

from roadperc_stream.info.facts import CameraFacts, ChannelFacts, LogFacts, Provenance, ReplayFacts
from roadperc_stream.info.role_states import RoleState
from roadperc_stream.log import number_of
from roadperc_stream.output.terminal import print_lines, print_table
from roadperc_stream.output.text_table import Row, Table
from roadperc_stream.schemas.record import PIXEL_ORIGIN_KEY, log_id_of
from roadperc_stream.system.text import listed, number, shown
from roadperc_stream.system.time import ns_to_seconds


def rounded(value: float | None) -> str:
    """The value with two decimals, with one decimal from 10 on; empty for None."""
    return "" if value is None else f"{value:z.1f}" if abs(value) >= 10 else f"{value:z.2f}"


_CAMERA_OF: Final = {"depth_calibration": "depth", "left_calibration": "left", "right_calibration": "right"}
"""Calibrations by the camera they need; they are not reported as missing without that camera."""
_CHOICES: Final = {
    "contract": "",
    "known": " (a name that other recorders use)",
    "guessed": " (guessed: no other topic fits)",
    "--topic": " (--topic)",
}


def print_roles(console: Console, states: Sequence[RoleState]) -> None:
    """Print the topic of each role, and what a replay lacks without it."""
    filled = {state.role for state in states if state.state == "filled"}
    rows = tuple((state.role, _role_text(state)) for state in states if _is_listed(state, filled))
    headers = ("topic, or what a replay lacks without it",)
    print_table(console, Table("Role", headers, rows, last_is_text=True, label_columns=18))


def _is_listed(state: RoleState, filled: set[str]) -> bool:
    """Whether the role is filled, or its absence matters."""
    if state.state != "missing" or state.candidates or state.why:
        return True
    camera = _CAMERA_OF.get(state.role)
    return bool(state.cost) and (camera is None or camera in filled)


def _role_text(state: RoleState) -> str:
    if state.state == "filled":
        return f"{state.topic or ''}{_CHOICES[state.why]}"
    where = f" {state.topic}:" if state.topic else ""
    fault = f"{where} {state.why}" if state.why else ""
    cost = f": {state.cost}" if state.cost else ""
    could = [f"--topic {state.role}={topic}" for topic in state.candidates]
    return f"{state.state}{fault}{cost}" + (f"; try {listed(could, 3)}" if could else "")


def _frame_lines(whole: bool, replay: ReplayFacts) -> Iterator[str]:
    if not whole:
        yield "a replay refuses this damaged file; pass --recover to use the readable part"
    if replay.refusal is not None:
        yield f"a replay stops: {replay.refusal}"
    if replay.reference is not None:
        skew = "" if replay.skew_s is None else f", stamps within a frame differ by up to {1000 * replay.skew_s:.1f} ms"
        yield f"{number(replay.frames, 'frame')}, one per message of role {replay.reference}{skew}"
    if replay.segments > 1:
        why = "as in a second recording, a bag played in a loop, or after the clock was set"
        yield f"{replay.segments} segments: the stamps restart or jump ahead by more than an hour, {why}"
    yield from _alone_lines(replay)
    if replay.unused:
        unused = ", ".join(f"{role} {count}" for role, count in sorted(replay.unused.items()))
        yield f"messages that belong to no frame: {unused}"
    if any(state.role == "segmentation" and state.state == "filled" for state in replay.roles):
        advice = "the log names no tag table; if the tags are numbers, pass one: --set tag_table=0.9.15"
        yield f"tag table {replay.tag_table}" if replay.tag_table else advice
    for topic, count in replay.unreadable.items():
        yield f"{topic}: {number(count, 'message')} cannot be decoded"
    for problem in replay.problems:
        yield f"first of these: {problem}"
    for finding in replay.findings:
        yield f"finding {finding}"


def _proposals(replay: ReplayFacts, source: Path) -> Iterator[str]:
    """The command with topics for the roles that stop a replay, else for missing images."""
    missing = [state for state in replay.roles if state.role == "image" and state.state == "missing"]
    options = replay.options or {state.role: state.candidates[0] for state in missing if state.candidates}
    if options:
        named = " ".join(f"--topic {quote(f'{role}={topic}')}" for role, topic in options.items())
        what = "these topics" if len(options) > 1 else "this topic"
        yield f"to use {what}: roadperc-replay {quote(str(source))} OUT.mcap {named}"


def _alone_lines(replay: ReplayFacts) -> Iterator[str]:
    """Frames without a message of a role; roles with unreadable messages have their own line."""
    unreadable = {state.role for state in replay.roles if state.topic in replay.unreadable}
    reasons = {False: "within the tolerance", True: "that is readable and within the tolerance"}
    for broken, reason in reasons.items():
        alone = [f"{role} {n}" for role, n in sorted(replay.alone.items()) if (role in unreadable) is broken]
        if alone:
            yield f"frames without a message of a role {reason}: {', '.join(alone)}"


def _camera(found: CameraFacts) -> Row:
    camera, height_m = found.camera, None if found.ego_T_camera is None else found.ego_T_camera[2][3]
    width, height = found.image_size or camera.size[::-1]
    remarks = [] if (height, width) == camera.size else [f"images of {width}x{height}"]
    remarks += [] if camera.square_pixels else [f"fy {rounded(camera.fy)}: differs from fx by more than 5 %"]
    remarks += ["not rectified"] if camera.lens is not None or camera.distortion else []
    remarks += ["no transform from ego"] if height_m is None else []
    cells = (f"{camera.width}x{camera.height}", rounded(camera.fx), rounded(camera.baseline_m), rounded(height_m))
    return (found.role, *cells, ", ".join(remarks))


_DAMAGES_SHOWN: Final = 5
_ODD_GAP: Final = 1.5
"""Gaps are listed from this many median intervals on: a message is missing."""
_FEWEST: Final = 4
_NUMBERS_WIDTH: Final = 20
"""Width of the columns messages and Hz with their gaps."""
_LAST_DATE_S: Final = 253_402_300_800
_NATURAL: Final = {".": "protobuf", "/": "cdr"}
_TIMES_NOTE: Final = (
    "gap: the longest interval, listed from 1.5 medians on; from s: its start after the log's first message; "
    "back, same: own stamps earlier than or equal to the previous one; "
    "late: messages after one with a later log time in the file"
)


def print_log(console: Console, facts: LogFacts, source: Path) -> None:
    """Print the facts of a log; ``source`` is the argument that names it, such as the folder of a bag."""
    print_lines(console, *_file_lines(facts), unbroken=True)
    print_table(console, _channels(facts.channels, console.width))
    print_table(console, _odd_times(facts.channels))
    print_roles(console, facts.replay.roles)
    print_lines(console, "", *_frame_lines(facts.file.whole, facts.replay))
    print_lines(console, *_proposals(facts.replay, source), unbroken=True)
    headers = ("pixels", "fx px", "baseline m", "height m", "remark")
    cameras = tuple(map(_camera, facts.replay.cameras))
    print_table(console, Table("Camera", headers, cameras, last_is_text=True, label_columns=18))
    if facts.provenance is not None:
        print_lines(console, "", *_provenance_lines(facts.provenance, facts.replay), unbroken=True)
        settings = facts.provenance.settings
        rows = tuple(
            (item.key, item.value, "no such setting" if item.default is None else item.default) for item in settings
        )
        print_table(console, Table("Settings not at their defaults", ("value", "default"), rows))


def _file_lines(facts: LogFacts) -> Iterator[str]:
    file = facts.file
    called = f", log {facts.log_id}" if facts.log_id else ""
    kind = "an input" if facts.kind == "input" else "a result of roadperc-replay"
    yield f"{facts.log}: {'whole' if file.whole else 'DAMAGED'}, {kind}{called}"
    written = f" written by {file.library}" if file.library else ""
    profile = f", profile {file.profile}" if file.profile else ""
    chunks = ", ".join(f"{number(n, 'chunk')} ({name or 'not compressed'})" for name, n in file.chunks.items())
    yield f"{decimal(file.size_bytes)}{written}{profile}, {chunks or 'no chunks'}"
    yield f"{number(facts.messages, 'message')} on {number(len(facts.channels), 'channel')}{_span(facts)}"
    beside = [f"attachment {name} ({decimal(length)})" for name, length in file.attachments.items()]
    beside += [f"metadata {name}" for name in file.metadata]
    if beside:
        yield listed(beside)
    if PIXEL_ORIGIN_KEY in file.conversion:
        yield f"converted with a K that counts pixels from {shown(file.conversion[PIXEL_ORIGIN_KEY])}"
    yield from _damage_lines(facts)
    if file.absent:
        yield f"without {', without '.join(file.absent)}"
    yield from (f"note: {note}" for note in file.notes)
    if facts.log_times_back:
        yield f"{number(facts.log_times_back, 'message')} after one with a later log time in the file"


def _span(facts: LogFacts) -> str:
    if facts.first_ns is None:
        return ""
    seconds = ns_to_seconds(facts.first_ns)
    if seconds >= _LAST_DATE_S:
        return f" over {facts.span_s:.2f} s from {facts.first_ns} ns"
    return f" over {facts.span_s:.2f} s from {datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _damage_lines(facts: LogFacts) -> Iterator[str]:
    file = facts.file
    for damage in file.damages[:_DAMAGES_SHOWN]:
        lost = f"; messages lost {damage.span.words(facts.first_ns)}" if damage.span and damage.is_loss else ""
        yield f"byte {damage.byte}: {damage.words}{lost}"
    if len(file.damages) > _DAMAGES_SHOWN:
        yield f"and {number_of(file.damages) - _DAMAGES_SHOWN} more damaged places"
    if file.damages and file.last_good_ns is not None and facts.first_ns is not None:
        after_s = ns_to_seconds(file.last_good_ns - facts.first_ns)
        where = f"{after_s:.3f} s ({file.last_good_ns} ns)"
        yield f"the last message before that is at {where}; the rest describes the readable part"
    if file.damages and facts.messages:
        yield f"roadperc-info {quote(facts.log)} --recover OUT.mcap writes the readable part as a new log"
    if file.recovery is not None:
        yield "repaired after damage:"
        yield from (f"  {line}" for line in file.recovery.lines(facts.first_ns))


def _channels(channels: Sequence[ChannelFacts], width: int) -> Table:
    """The table of channels; schemas are the last column, or below the topics if a line is too long."""
    ordered = sorted(channels, key=lambda channel: (channel.result, channel.topic))
    topics, schemas = [shown(channel.topic) for channel in ordered], [shown(_schema(channel)) for channel in ordered]
    numbers = [(str(channel.messages), rounded(channel.rate_hz)) for channel in ordered]
    found = list(zip(topics, schemas, numbers, strict=True))
    if max(map(len, topics), default=0) + max(map(len, schemas), default=0) + _NUMBERS_WIDTH <= width:
        rows = tuple((topic, *cells, schema) for topic, schema, cells in found)
        return Table("Channel", ("messages", "Hz", "schema"), rows, last_is_text=True, label_columns=12)
    lines = (line for topic, schema, cells in found for line in ((topic, *cells), (f"  {schema}",)))
    return Table("Channel, schema", ("messages", "Hz"), tuple(lines))


def _schema(channel: ChannelFacts) -> str:
    """The schema's name, with the encoding unless it is the usual one of such names."""
    name = channel.schema or "no schema"
    natural = next((encoding for sign, encoding in _NATURAL.items() if sign in name), "")
    return name if channel.message_encoding == natural else f"{name} ({channel.message_encoding})"


def _odd_times(channels: Iterable[ChannelFacts]) -> Table:
    found = ((channel.topic, *_gap(channel), *_counts(channel)) for channel in channels)
    rows = tuple(row for row in found if any(row[1:]))
    return Table("Odd times", ("gap s", "from s", "back", "same", "late"), rows, (_TIMES_NOTE,) if rows else ())


def _gap(channel: ChannelFacts) -> tuple[str, str]:
    """The longest gap and its start, empty if usual; results follow the frames."""
    if channel.result or channel.rate_hz is None or channel.messages < _FEWEST:
        return "", ""
    is_odd = (channel.longest_gap_s or 0) * channel.rate_hz >= _ODD_GAP
    return (rounded(channel.longest_gap_s), rounded(channel.gap_at_s)) if is_odd else ("", "")


def _counts(channel: ChannelFacts) -> Iterator[str]:
    counts = channel.stamps_back, channel.stamps_repeated, channel.log_times_back
    return (str(count or "") for count in counts)


def _provenance_lines(provenance: Provenance, replay: ReplayFacts) -> Iterator[str]:
    """Lines about the replay of a result, without the findings that ``replay`` has too."""
    config = (provenance.config_digest or "unknown")[:8]
    version, seed = provenance.version or "unknown", provenance.seed or "unknown"
    frames = "" if provenance.frames is None else f", {number(provenance.frames, 'frame')}"
    yield f"replayed by version {version}, configuration {config}, seed {seed}{frames}"
    if provenance.continues:
        yield f"continues the result of log {provenance.continues}"
    shown = {finding.code for finding in replay.findings}
    yield from (f"finding {finding}" for finding in provenance.findings if finding.code not in shown)
    yield _digest_line(provenance)
    if provenance.dropped:
        dropped = ", ".join(f"{role} {count}" for role, count in provenance.dropped.items())
        yield f"messages that belonged to no frame: {dropped}"
    for table in provenance.tables:
        rows = "" if table.rows is None else f" ({number(table.rows, 'row')})"
        yield f"{table.path}{rows}: {table.fault or 'belongs to this log'}"
    if provenance.config_fault:
        yield f"settings: {provenance.config_fault}"
    elif not provenance.settings:
        yield "settings: all at their defaults"


def _digest_line(provenance: Provenance) -> str:
    digest = log_id_of(provenance.digest) or "unknown"
    if provenance.digest_found is None:
        return f"input {digest}: not in the file (--results-only), or not fully readable"
    if provenance.changed:
        return f"input {digest}: CHANGED since the replay, its messages now give {log_id_of(provenance.digest_found)}"
    return f"input {digest}: unchanged since the replay"
