"""Completers for the shell: file names of the right kind, and names of settings, roles and stages.

A completer takes the typed prefix and returns whole words; ``argcomplete`` finds it on the parser's action. Modules
are imported when the shell asks.
"""

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Final

from roadperc_stream.system.files import METRICS_SUFFIX

if TYPE_CHECKING:
    from roadperc_stream.config.catalogue import Setting

Completer = Callable[..., Iterable[str]]
LOGS: Final = (".mcap", ".db3", ".bag")
RUNS: Final = (".mcap", METRICS_SUFFIX)
"""Suffixes of the files that name a finished run."""


def files(*suffixes: str) -> Completer:
    """Completer of folders, and of files with one of the suffixes."""

    def complete(prefix: str, **_: Any) -> Iterable[str]:
        from argcomplete.completers import DirectoriesCompleter, FilesCompleter

        return (FilesCompleter(suffixes) if suffixes else DirectoriesCompleter())(prefix)

    return complete


def settings(prefix: str, **_: Any) -> Iterable[str]:
    """``KEY=`` for every setting, ``KEY=VALUE`` for settings with a choice; lists take several values."""
    return _settings(prefix, lambda setting: setting.type == "array")


def varied_settings(prefix: str, **_: Any) -> Iterable[str]:
    """As ``settings``, for ``--vary``: commas separate the values to try."""
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
    """``ROLE=`` for every role; topics are not completed."""
    from roadperc_stream.schemas.roles import ROLES

    return [] if "=" in prefix else [f"{role}=" for role in ROLES]


def words(names: Iterable[str]) -> Completer:
    """Completer of names from a list, several joined by commas."""

    def complete(prefix: str, **_: Any) -> Iterable[str]:
        *before, _last = prefix.split(",")
        return [",".join((*before, name)) for name in names if name not in before]

    return complete
