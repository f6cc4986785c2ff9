"""The arrangement of a result log's channels that Foxglove and Lichtblick open: a file shipped with the package."""

import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Final

from roadperc_stream import log
from roadperc_stream.channels import ROLES
from roadperc_stream.roles import roles_of_log
from roadperc_stream.targets import completing, require_free

_WITHOUT_IMAGE: Final = {"image": "left", "calibration": "left_calibration"}
"""Whose topics stand for the front camera's where a log has a pair only."""
_CONTRACT: Final[Mapping[str, str]] = {}


def foxglove_layout(topics: Mapping[str, str] = _CONTRACT) -> str:
    """The layout as JSON; it names this project's own topics, those on request included.

    Args:
        topics: the topics that stand in a log for this project's own, by these.
    """
    shipped = resources.files(__package__).joinpath("foxglove_layout.json").read_text("utf-8")
    return json.dumps(_renamed(json.loads(shipped), topics), indent=2, ensure_ascii=False) + "\n"


def topics_in(path: Path, overrides: Mapping[str, str]) -> dict[str, str]:
    """The topics that fill a log's roles, by those that the layout names.

    Args:
        path: an input log or the result of a replay.
        overrides: topic by role, from ``--topic``.

    Raises:
        RoadpercError: the log cannot be read, or its channels do not fit the roles.
    """
    filled = dict(roles_of_log(log.summarise(path), overrides).topics)
    if "image" not in filled:
        filled |= {role: filled[other] for role, other in _WITHOUT_IMAGE.items() if other in filled}
    return {ROLES[role].topic: topic for role, topic in filled.items()}


def write_layout(
    target: Path, source: Path | None = None, overrides: Mapping[str, str] = _CONTRACT, *, force: bool
) -> None:
    """Write the layout to a file for the viewers' "import from file".

    Args:
        target: the file.
        source: the log whose topics it names; None for this project's own.
        overrides: topic of each role of ``source`` that another topic fills than the one found.
        force: replace an existing file.

    Raises:
        RoadpercError: the log cannot be read, or the file's name is taken, or it cannot be written.
    """
    require_free(target, force=force, source=source)
    layout = foxglove_layout(topics_in(source, overrides) if source else _CONTRACT)
    with completing(target) as temporary:
        temporary.write_text(layout, "utf-8")


def _renamed(node: Any, topics: Mapping[str, str]) -> Any:
    """A part of a JSON document with topics replaced, as values and as keys."""
    if isinstance(node, dict):
        return {topics.get(key, key): _renamed(value, topics) for key, value in node.items()}
    if isinstance(node, list):
        return [_renamed(child, topics) for child in node]
    return topics.get(node, node) if isinstance(node, str) else node
