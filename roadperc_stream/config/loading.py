"""A configuration from a TOML file and single settings."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ValidationError

from roadperc_stream.config.catalogue import catalogue
from roadperc_stream.config.complaints import complaint, key_of
from roadperc_stream.config.settings import parsed_toml, read_toml
from roadperc_stream.config.stages import ReplayConfig
from roadperc_stream.errors import ConfigError
from roadperc_stream.system.text import in_brief, nearest

_KINDS: Final[Mapping[str, str]] = {"integer": "a whole number ", "number": "a number "}
"""Text for types that the range does not show."""


def load_config(path: str | Path | None = None, settings: str | Sequence[str] = ()) -> ReplayConfig:
    """Configuration from a TOML file and ``KEY=VALUE`` settings, which override the file.

    Args:
        path: TOML file with any part of the keys; None for the defaults.
        settings: one or several such as ``lanes.hold_s=0.8``; the value is TOML; a word without quotes is a string.

    Raises:
        ConfigError: the file cannot be read, or a key or value is invalid; the message names it.
    """
    tree = read_toml(Path(path)) if path else {}
    for setting in [settings] if isinstance(settings, str) else settings:
        key, separator, value = setting.partition("=")
        if not separator:
            raise ConfigError(f"setting {setting}: expected KEY=VALUE, such as lanes.hold_s=0.8")
        _assign(tree, key.strip().split("."), _toml_value(value.strip()), setting)
    return validated(tree, f"{path}: " if path else "")


def load_labels(path: Path) -> dict[str, str]:
    """Known labels by other labels, from the table ``[labels]`` of a TOML file.

    Raises:
        ConfigError: the file cannot be read, has other tables, or a label is unknown.
    """
    found = load_config(path)
    if not found.labels or found != ReplayConfig(labels=found.labels):
        raise ConfigError(f'{path}: expected the table [labels] alone, with lines such as auto = "car"')
    return found.labels


def validated(tree: Mapping[str, Any], source: str) -> ReplayConfig:
    """Configuration from nested mappings with any part of the keys.

    ``tree`` is such as ``{"lanes": {"hold_s": 0.8}}``, ``source`` a prefix of errors, such as ``a.toml: ``.

    Raises:
        ConfigError: a key or value is invalid; the message names it.
    """
    try:
        return ReplayConfig.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{source}{_complaint(error)}") from error


def _complaint(error: ValidationError) -> str:
    """The first error, such as ``lanes.hold_s: expected a number 0 to 3600 (s), found -1``."""
    first = error.errors()[0]
    keys = [str(part) for part in first["loc"][:2]]  # the rest are types of values, or positions in a list
    if first["type"] == "extra_forbidden":
        return _unknown(keys)
    key = ".".join(keys)
    setting = next((setting for setting in catalogue() if setting.key == key), None)
    if setting is None or first["type"] == "value_error":
        return ": ".join(filter(None, (key_of(first["loc"]), complaint(first))))
    unit = f" ({setting.unit})" if setting.unit else ""
    return f"{key}: expected {_KINDS.get(setting.type, '')}{setting.range}{unit}, found {in_brief(first['input'])}"


def _unknown(keys: list[str]) -> str:
    """An unknown key, with the nearest setting in this section, else in another one, else all of this section."""
    *sections, name = keys
    model: type[BaseModel] = ReplayConfig
    for section in sections:
        model = type(model.model_fields[section].default)
    known = tuple(model.model_fields)
    if close := nearest(name, known):
        near = [".".join((*sections, close))]
    else:
        elsewhere = nearest(name, sorted({setting.name for setting in catalogue()}))
        near = [setting.key for setting in catalogue() if setting.name == elsewhere]
    hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(known)}"
    return f"no setting {'.'.join(keys)}; {hint}"


def _toml_value(text: str) -> Any:
    try:
        return parsed_toml(f"value = {text}".encode())["value"]
    except ConfigError:
        return text


def _assign(tree: dict[str, Any], keys: list[str], value: Any, setting: str) -> None:
    for key in keys[:-1]:
        tree = tree.setdefault(key, {})
        if not isinstance(tree, dict):
            raise ConfigError(f"setting {setting}: {key} is a value, not a table")
    tree[keys[-1]] = value
