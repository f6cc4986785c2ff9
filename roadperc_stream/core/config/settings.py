"""A configuration as it stands in a file: settings by their dotted keys."""

import tomllib
from collections.abc import Mapping
from typing import Any

from roadperc_stream.errors import ConfigError


def settings_in(toml: bytes) -> dict[str, Any]:
    """The settings of a TOML text by keys such as ``lanes.hold_s``, also those that this version does not know.

    Raises:
        ConfigError: the text is not TOML.
    """
    try:
        return _flat(tomllib.loads(toml.decode()))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"not TOML: {error}") from error


def as_typed(value: Any) -> str:
    """A value as a command line would give it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat
