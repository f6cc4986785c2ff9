"""What a shell may put at the cursor: file names of the right kind, names from the project's own tables.

A completer takes what is typed so far and gives whole words; ``argcomplete`` finds it on the parser's action. What it
needs to know is imported when the shell asks.
"""

import argparse
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from roadperc_stream.system.files import METRICS_SUFFIX

if TYPE_CHECKING:
    from roadperc_stream.config.catalogue import Setting

Completer = Callable[..., Iterable[str]]
LOGS: Final = (".mcap",)
RUNS: Final = (".mcap", METRICS_SUFFIX)
"""How the files end that a finished run is known by."""


def completed_by(action: argparse.Action, completer: Completer) -> None:
    """Attach a completer to an argument."""
    action.completer = completer  # type: ignore[attr-defined]  # argcomplete's documented place for it


def files(*suffixes: str) -> Completer:
    """Completer of files that end so, and of the folders on the way to them; folders alone where no ending is named."""
    return lambda prefix, **_: _paths(prefix, suffixes)


def settings(prefix: str, **_: Any) -> Iterable[str]:
    """``KEY=`` for every setting, ``KEY=VALUE`` for those with a choice; several by commas where it is a list."""
    return _settings(prefix, lambda setting: setting.type == "array")


def varied_settings(prefix: str, **_: Any) -> Iterable[str]:
    """The same for ``--vary``, where commas stand between the values that a setting takes in turn."""
    return _settings(prefix, lambda setting: setting.type != "array")


def _settings(prefix: str, takes_several: "Callable[[Setting], bool]") -> Iterable[str]:
    from roadperc_stream.config.catalogue import catalogue

    key, separator, typed = prefix.partition("=")
    if not separator:
        return [f"{setting.key}=" for setting in catalogue()]
    found = next((setting for setting in catalogue() if setting.key == key), None)
    if found is None or ("," in typed and not takes_several(found)):
        return []
    return [f"{key}={value}" for value in words(found.choices)(typed)]


def topics(prefix: str, **_: Any) -> Iterable[str]:
    """``ROLE=`` for every role; the topic is the user's to name."""
    from roadperc_stream.schemas.roles import ROLES

    return [] if "=" in prefix else [f"{role}=" for role in ROLES]


def words(names: Iterable[str]) -> Completer:
    """Completer of names from a list, several joined by commas."""

    def complete(prefix: str, **_: Any) -> Iterable[str]:
        *before, _last = prefix.split(",")
        return [",".join((*before, name)) for name in names if name not in before]

    return complete


def roles_in_dump(roles: Iterable[str]) -> Completer:
    """Completer of ``ROLE=PATH``, the path being one inside the dump where that is named already."""

    def complete(prefix: str, parsed_args: argparse.Namespace, **_: Any) -> Iterable[str]:
        role, separator, typed = prefix.partition("=")
        if not separator:
            return [f"{name}=" for name in roles]
        folder = getattr(parsed_args, "dump", None) or Path()
        return [f"{role}={path}" for path in _paths(typed, ("",), folder)]

    return complete


def _paths(prefix: str, suffixes: tuple[str, ...], base: Path | None = None) -> Iterable[str]:
    """Paths that begin so: files that end in one of ``suffixes``, and folders with a slash behind."""
    head, tail = os.path.split(prefix)
    folder = (base or Path()) / Path(head or ".").expanduser()
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        return
    for entry in entries:
        if not entry.name.startswith(tail) or entry.name.startswith(".") > tail.startswith("."):
            continue
        if entry.is_dir():
            yield f"{os.path.join(head, entry.name)}/"  # noqa: PTH118 - what is typed stays as it is, such as ./ or ~
        elif suffixes and entry.name.endswith(suffixes):
            yield os.path.join(head, entry.name)  # noqa: PTH118
