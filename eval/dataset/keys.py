"""The columns that group a dataset's frames, and the names of groups, logs and configurations."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Final

import polars as pl

from roadperc_stream.batch.addresses import natural
from roadperc_stream.config.settings import as_typed, settings_in
from roadperc_stream.errors import ConfigError, TableError

from ..configurations import Settings
from ..expressions import roots, unknown
from ..options import number_or_text
from .place import DATE, RUN_COLUMNS

LOG: Final = ("log_id", "config")
"""Columns that identify a run of a dataset."""
_OF_THE_FILE: Final = (*LOG, DATE)
UNKNOWN_GROUP: Final = "none"
Key = tuple[str | None, ...]
"""The values of a group's columns."""
_DIGITS: Final = 8
"""Digits of a log's digest that distinguish logs of equal names."""
DEFAULT: str = "default"
_OPTIONS: Final = ("--base-config", "--new-config")


@dataclass(frozen=True)
class Grouping:
    """The columns and expressions that group the rows, and their origin.

    ``of_runs`` come from the list of runs, ``of_rows`` may change from frame to frame; the others belong to a file.
    """

    columns: tuple[str, ...]
    of_runs: tuple[str, ...]
    of_rows: tuple[str, ...]

    @property
    def as_options(self) -> tuple[str, ...]:
        """The names of the columns in ``--by``."""
        return tuple("log" if name == "log_id" else name for name in self.columns)

    @property
    def of_whole_logs(self) -> bool:
        """Whether all frames of a log under a configuration are in one group."""
        return not self.of_rows


def grouping(by: Sequence[str], table_columns: Collection[str]) -> Grouping:
    """The grouping by the columns of ``--by``; ``log`` means the column ``log_id``.

    Raises:
        TableError: a column does not exist.
    """
    names = tuple(dict.fromkeys("log_id" if name == "log" else name for name in by))
    tables, lists = {*_OF_THE_FILE, *table_columns}, set(RUN_COLUMNS)
    of_rows = tuple(name for name in names if name not in _OF_THE_FILE and tables.issuperset(roots(name)))
    of_runs = tuple(name for name in names if not tables.issuperset(roots(name)) and lists.issuperset(roots(name)))
    for name in names:
        if name not in (*_OF_THE_FILE, *of_rows, *of_runs):
            lacking = next(root for root in roots(name) if root not in tables)
            raise unknown(name, lacking, tables | lists, "the metrics tables or of runs.parquet")
    return Grouping(names, of_runs, of_rows)


def log_names(log_ids: Iterable[str], runs: pl.DataFrame) -> dict[str, str]:
    """The name of each log: its file name, with digits of its digest if another log has the same file name.

    Logs that are missing in the list of runs have their digest as name.
    """
    known = runs.filter(pl.col("log_id").is_not_null())
    paths = dict(known.select("log_id", "path").iter_rows())
    stems = {log_id: PurePosixPath(paths[log_id]).stem if log_id in paths else log_id for log_id in log_ids}
    shared = Counter(stems.values())
    return {log_id: stem if shared[stem] == 1 else f"{stem} {log_id[:_DIGITS]}" for log_id, stem in stems.items()}


def group_name(key: Key, columns: Sequence[str], logs: Mapping[str, str]) -> str:
    """The values of a group's key, with names of logs."""
    values = zip(columns, key, strict=True)
    texts = (logs.get(value or "", value) if column == "log_id" else value for column, value in values)
    return ", ".join(UNKNOWN_GROUP if text is None else " ".join(text.split()) for text in texts) or "all"


def in_order(keys: Iterable[Key], columns: Sequence[str], configs: Sequence[str], logs: Mapping[str, str]) -> list[Key]:
    """Keys of groups, sorted: numbers by size, texts alphabetically, configurations by age, unknown values last.

    Keys are values of ``columns``; ``configs`` are in the order of ``in_order_of_runs``, ``logs`` are names of logs.
    """
    return sorted(keys, key=lambda key: [_place(*item, configs, logs) for item in zip(columns, key, strict=True)])


def _place(column: str, value: str | None, configs: Sequence[str], logs: Mapping[str, str]) -> tuple[bool, float, Any]:
    if value is None:
        return (True, 0.0, "")
    if column == "log_id":
        return (False, 0.0, natural(logs.get(value, value)))
    if column == "config":
        return (False, float(configs.index(value)) if value in configs else float("inf"), value)
    typed = number_or_text(value)
    return (False, typed if isinstance(typed, float) else float("inf"), value)


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
