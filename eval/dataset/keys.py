"""The names of a dataset's logs and configurations."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Final

import polars as pl

from roadperc_stream.config.settings import as_typed, settings_in
from roadperc_stream.errors import ConfigError, TableError

from ..configurations import Settings
from ..options import number_or_text

LOG: Final = ("log_id", "config")
"""Columns that identify a run of a dataset."""
LogKey = tuple[str, str]
"""Log and configuration."""
_DIGITS: Final = 8
"""Digits of a log's digest that distinguish logs of equal names."""
DEFAULT: str = "default"
_OPTIONS: Final = ("--base-config", "--new-config")


def log_names(log_ids: Iterable[str], runs: pl.DataFrame) -> dict[str, str]:
    """The name of each log: its file name, with digits of its digest if another log has the same file name.

    Logs that are missing in the list of runs have their digest as name.
    """
    known = runs.filter(pl.col("log_id").is_not_null())
    paths = dict(known.select("log_id", "path").iter_rows())
    stems = {log_id: PurePosixPath(paths[log_id]).stem if log_id in paths else log_id for log_id in log_ids}
    shared = Counter(stems.values())
    return {log_id: stem if shared[stem] == 1 else f"{stem} {log_id[:_DIGITS]}" for log_id, stem in stems.items()}


def settings_by_config(runs: pl.DataFrame, configs: Sequence[str]) -> dict[str, Settings | None]:
    """Options and non-default settings of each configuration; None if unknown."""
    found: dict[str, Settings | None] = dict.fromkeys(configs)
    for config, settings, options in runs.select("config", "settings", "options").iter_rows():  # the last row counts
        if config in found:
            try:
                found[config] = {**settings_in((settings or "").encode()), **({"options": options} if options else {})}
            except ConfigError:
                found[config] = None
    return found


def in_order_of_runs(present: Sequence[str], runs: pl.DataFrame) -> list[str]:
    """Configurations in the order of their first finished run; those without a run come last."""
    known = runs.sort("finished_ns", maintain_order=True)["config"].unique(maintain_order=True).to_list()
    return [*(name for name in known if name in present), *(name for name in present if name not in known)]


def two_configs(names: tuple[str | None, str | None], configs: Mapping[str, Settings | None]) -> tuple[str, str]:
    """The configurations of the base and of the new runs.

    Args:
        names: of base and new: a name, its first digits, or a setting such as ``lanes.hold_s=2``. In a dataset of two
            configurations they may be None; without both, the older configuration is the base.
        configs: the configurations of the dataset, the oldest first, with their settings.

    Raises:
        TableError: ``names`` are not two different configurations of the dataset.
    """
    base, new = (name and config_named(option, name, configs) for option, name in zip(_OPTIONS, names, strict=True))
    if len(configs) == 2:
        older, newer = configs
        base = base or (older if new != older else newer)
        new = new or (newer if base != newer else older)
    if not base or not new:
        raise TableError(f"pass --base-config and --new-config; {_listed(configs)}")
    if base == new:
        raise TableError(f"--base-config and --new-config: expected two configurations; {_listed(configs)}")
    return base, new


def config_named(option: str, name: str, configs: Mapping[str, Settings | None]) -> str:
    """The configuration that a name, its first digits or a setting means; an empty name means the only one.

    Raises:
        TableError: no configuration fits, or several.
    """
    matching = [config for config in configs if config.startswith(name)] or [
        config
        for config, settings in configs.items()
        if settings is not None and any(_is_same(name, text) for text in _texts(settings))
    ]
    if len(matching) != 1:
        matches = "no configuration" if not matching else f"{len(matching)} configurations"
        raise TableError(f"{f'{option} {name}'.strip()}: matches {matches}; {_listed(configs)}")
    return matching[0]


def _is_same(setting: str, other: str) -> bool:
    """Whether two texts are the same setting; 2 equals 2.0."""
    (key, _, value), (other_key, _, other_value) = setting.partition("="), other.partition("=")
    return key == other_key and number_or_text(value) == number_or_text(other_value)


def _texts(settings: Settings | None) -> list[str]:
    if settings is None:
        return ["unknown"]
    return [f"{key}={as_typed(value)}" for key, value in settings.items()] or [DEFAULT]


def _listed(configs: Mapping[str, Settings | None]) -> str:
    known = (f"{name} ({', '.join(_texts(settings))})" for name, settings in configs.items())
    return f"the dataset has {'; '.join(known)}"
