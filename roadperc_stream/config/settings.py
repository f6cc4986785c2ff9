"""A configuration as it stands in a file: settings by their dotted keys."""

import tomllib
from collections.abc import Mapping
from typing import Any, Final

from roadperc_stream.errors import ConfigError

MOST_BYTES: Final = 1_000_000
"""Of a configuration; all settings with their comments take 30 kB."""
_MOST_DOTS: Final = 100
"""In a line: the keys of settings have one."""
_MOST_SHOWN: Final = 200


def settings_in(toml: bytes) -> dict[str, Any]:
    """The settings of a TOML text by keys such as ``lanes.hold_s``, also those that this version does not know.

    Raises:
        ConfigError: the text is not TOML.
    """
    try:
        return _flat(parsed_toml(toml))
    except RecursionError as error:
        raise ConfigError("not TOML of settings: nested too deeply") from error


def parsed_toml(toml: bytes) -> dict[str, Any]:
    """A TOML text as nested mappings.

    Raises:
        ConfigError: the text is not TOML, too long, nested too deeply, or a number in it has too many digits.
    """
    if len(toml) > MOST_BYTES:
        raise ConfigError(f"not TOML of settings: more than {MOST_BYTES} bytes")
    if any(line.count(b".") > _MOST_DOTS for line in toml.splitlines()):
        raise ConfigError("not TOML of settings: nested too deeply")  # the parser's time goes with the square of that
    try:
        return tomllib.loads(toml.decode())
    except RecursionError as error:
        raise ConfigError("not TOML of settings: nested too deeply") from error
    except ValueError as error:
        raise ConfigError(f"not TOML: {error}") from error


def in_brief(value: Any, most: int = _MOST_SHOWN) -> str:
    """A value of any kind and size, in few characters."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # more digits than Python writes, more levels than it climbs
        return f"a {type(value).__name__} too long to show"
    return text if len(text) <= most else f"{text[:most]}..."


def as_typed(value: Any) -> str:
    """A value as a command line would give it."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else in_brief(value)


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat
