"""The settings of a configuration file by their dotted keys."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from roadperc_stream.config.stages import ABOUT_THE_LOG, OWN_STAGES, StageSection
from roadperc_stream.errors import ConfigError
from roadperc_stream.system.files import read_file
from roadperc_stream.system.text import in_brief

MOST_BYTES: Final = 1_000_000
"""Largest size of a configuration; all settings with their comments take 30 kB."""
_MOST_DOTS: Final = 100
"""Largest number of dots in a line; keys of settings have one."""
NOT_SET: Final = "not set"
"""Text for a setting about the log that a configuration does not contain, because the log itself says it."""
BUILT_IN_STAGES: Final = {
    f"{stage}.{name}": StageSection.model_fields[name].default
    for stage in OWN_STAGES
    for name in StageSection.written_if_set or ()
}
"""Settings that a configuration contains only with other values."""


def settings_in(toml: bytes) -> dict[str, Any]:
    """The settings of a TOML text by keys such as ``lanes.hold_s``, including unknown ones.

    Raises:
        ConfigError: the text is not TOML.
    """
    return _flat(parsed_toml(toml))


def is_about_log(key: str) -> bool:
    """Whether a key such as ``calibration.fov_deg`` says something about the log."""
    return key.partition(".")[0] in ABOUT_THE_LOG


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as nested mappings.

    Raises:
        ConfigError: the file cannot be read, or as in ``parsed_toml``; the message begins with the path.
    """
    try:
        return parsed_toml(read_file(path, MOST_BYTES))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def parsed_toml(toml: bytes) -> dict[str, Any]:
    """A TOML text as nested mappings.

    Raises:
        ConfigError: the text is not TOML, too long, nested too deeply, or a number in it has too many digits.
    """
    if len(toml) > MOST_BYTES:
        raise ConfigError(f"not TOML of settings: more than {MOST_BYTES} bytes")
    if any(line.count(b".") > _MOST_DOTS for line in toml.splitlines()):
        raise ConfigError("not TOML of settings: nested too deeply")  # the parser takes quadratic time
    try:
        return tomllib.loads(toml.decode())
    except RecursionError as error:
        raise ConfigError("not TOML of settings: nested too deeply") from error
    except ValueError as error:
        raise ConfigError(f"not TOML: {error}") from error


def as_typed(value: Any) -> str:
    """A value as on the command line."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else in_brief(value)


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat
