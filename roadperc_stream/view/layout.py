"""The arrangement of a result log's channels that Foxglove and Lichtblick open: a file shipped with the package."""

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import Any, Final

from roadperc_stream import log
from roadperc_stream.core.datatypes import DepthImage
from roadperc_stream.core.files import completing, require_free
from roadperc_stream.errors import DecodeError
from roadperc_stream.input.decoding import context_of_channel, decode
from roadperc_stream.input.roles import assignment_of_log
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.view.shown import require_shown

_WITHOUT_IMAGE: Final = {"image": "left", "calibration": "left_calibration"}
"""Whose topics stand for the front camera's where a log has a pair only."""
_CONTRACT: Final[Mapping[str, str]] = {}
_DEPTH_PANEL: Final = "Image!depth"
_MM_PER_M: Final = 1000


def foxglove_layout(topics: Mapping[str, str] = _CONTRACT, *, depth_in_metres: bool = False) -> str:
    """The layout as JSON; it names this project's own topics, those on request included.

    Args:
        topics: the topics that stand in a log for this project's own, by these.
        depth_in_metres: the log's depth is not in millimetres, as this project's own: viewers colour bare numbers.
    """
    layout = json.loads(resources.files(__package__).joinpath("foxglove_layout.json").read_text("utf-8"))
    if depth_in_metres:
        layout["configById"][_DEPTH_PANEL]["imageMode"]["maxValue"] /= _MM_PER_M
    return json.dumps(_renamed(layout, topics), indent=2, ensure_ascii=False) + "\n"


def topics_in(path: Path, overrides: Mapping[str, str]) -> dict[str, str]:
    """The topics that fill a log's roles, by those that the layout names.

    Args:
        path: an input log or the result of a replay.
        overrides: topic by role, from ``--topic``.

    Raises:
        RoadpercError: the log cannot be read or holds nothing to show, or its channels do not fit the roles.
    """
    summary = log.summarise(path)
    roles = assignment_of_log(summary, overrides)
    require_shown(summary, roles)
    filled = dict(roles.topics)
    if "image" not in filled:
        filled |= {role: filled[other] for role, other in _WITHOUT_IMAGE.items() if other in filled}
    return {ROLES[role].topic: topic for role, topic in filled.items()}


def write_layout(
    target: Path, source: Path | None = None, overrides: Mapping[str, str] = _CONTRACT, *, force: bool
) -> None:
    """Write the layout to a file for the viewers' "import from file".

    Args:
        target: the file, ``.json``.
        source: the log whose topics it names; None for this project's own.
        overrides: topic of each role of ``source`` that another topic fills than the one found.
        force: replace an existing file.

    Raises:
        RoadpercError: the log cannot be read or holds nothing to show, or the file's name is taken, or it
            cannot be written.
    """
    require_free(target, force=force, source=source, suffix=".json")
    layout = _layout_of(source, overrides) if source else foxglove_layout()
    with completing(target, force=force) as temporary:
        temporary.write_text(layout, "utf-8")


def _layout_of(path: Path, overrides: Mapping[str, str]) -> str:
    topics = topics_in(path, overrides)
    depth = topics.get(ROLES["depth"].topic)
    return foxglove_layout(topics, depth_in_metres=depth is not None and _in_metres(path, depth))


def _in_metres(path: Path, topic: str) -> bool:
    """Whether a log's depth is in metres, as 32FC1 is, by the first message that tells: their numbers have no end."""
    for message in log.read(path, topics=[topic]):
        channel, time_ns = message.channel, message.log_time_ns
        context = context_of_channel(channel, "auto")
        with suppress(DecodeError):
            decoded = decode("depth", channel.schema_name, channel.message_encoding, message.data, time_ns, context)
            return isinstance(decoded.payload, DepthImage) and math.isinf(decoded.payload.limit_m)
    return False


def _renamed(node: Any, topics: Mapping[str, str]) -> Any:
    """A part of a JSON document with topics replaced, as values and as keys."""
    if isinstance(node, dict):
        return {topics.get(key, key): _renamed(value, topics) for key, value in node.items()}
    if isinstance(node, list):
        return [_renamed(child, topics) for child in node]
    return topics.get(node, node) if isinstance(node, str) else node
