"""Whether a log holds anything that this project shows."""

from collections.abc import Iterable
from pathlib import Path
from shlex import quote

from roadperc_stream.errors import LogError
from roadperc_stream.input.earlier_replay import is_result_of
from roadperc_stream.input.roles import RoleAssignment
from roadperc_stream.log import LogSummary


def require_shown(summary: LogSummary, roles: RoleAssignment) -> None:
    """See that some messages of a log have a role or are a result.

    Raises:
        LogError: none are; the message names the topics that could serve a role, where there are any.
    """
    holding = [channel for channel in summary.channels if summary.counts.get(channel.source_id)]
    if not holding:
        raise LogError(f"{summary.path}: no message to show")
    if not roles.topics and not any(is_result_of(channel, channel.topic) for channel in holding):
        raise nothing_shown(summary.path, roles.unassigned)


def nothing_shown(path: Path, reasons: Iterable[str]) -> LogError:
    """The error of a log of which a viewer would stay empty; it names the commands that take a log as it is."""
    named = quote(str(path))
    elsewhere = f"rerun {named} or roadperc-view {named} --foxglove may show what there is"
    return LogError("; ".join((f"{path}: nothing here that this project shows", *reasons, elsewhere)))
