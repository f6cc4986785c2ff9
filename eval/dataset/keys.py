"""What a report over a dataset is grouped by, and what its groups, logs and configurations are called."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Final

import polars as pl

from roadperc_stream.batch.storage.addresses import natural
from roadperc_stream.config.settings import as_typed, settings_in
from roadperc_stream.errors import ConfigError, TableError

from ..configurations import Settings
from ..options import number_or_text
from ..quantities import listed
from .place import DATE, RUN_COLUMNS

LOG: Final = ("log_id", "config")
"""What tells one run of a dataset from all others."""
_OF_THE_FILE: Final = (*LOG, DATE)
UNKNOWN_GROUP: Final = "none"
Key = tuple[str | None, ...]
"""The values of a group's columns."""
_DIGITS: Final = 8
"""Of a log's digest that tell logs of one name apart."""
DEFAULT: str = "default"


@dataclass(frozen=True)
class Grouping:
    """The columns that rows are grouped by, and where they come from.

    ``of_runs`` are taken from the list of runs, ``of_rows`` may change from frame to frame; the others are a file's.
    """

    columns: tuple[str, ...]
    of_runs: tuple[str, ...]
    of_rows: tuple[str, ...]

    @property
    def asked(self) -> tuple[str, ...]:
        """The columns as ``--by`` calls them."""
        return tuple("log" if name == "log_id" else name for name in self.columns)

    @property
    def of_whole_logs(self) -> bool:
        """Whether all frames of a log under a configuration are in one group."""
        return not self.of_rows


def grouping(by: Sequence[str], table_columns: Collection[str]) -> Grouping:
    """What ``--by`` asks for.

    The name ``log`` stands for the column of the log's digest.

    Raises:
        TableError: there is no such column.
    """
    names = tuple(dict.fromkeys("log_id" if name == "log" else name for name in by))
    of_rows = tuple(name for name in names if name not in _OF_THE_FILE and name in table_columns)
    of_runs = tuple(name for name in names if name not in (*_OF_THE_FILE, *of_rows) and name in RUN_COLUMNS)
    for name in names:
        if name not in (*_OF_THE_FILE, *of_rows, *of_runs):
            near = sorted(
                {other for other in (*table_columns, *RUN_COLUMNS) if name.split("_", maxsplit=1)[0] in other}
            )
            hint = f"; there are {listed(near)}" if near else ""
            raise TableError(f"--by {name}: no column of the metrics tables or of the list of runs{hint}")
    return Grouping(names, of_runs, of_rows)


def as_key(name: str, kind: pl.DataType) -> pl.Expr:
    """A column as text that groups and their names are made of."""
    column = pl.col(name)
    text = column.cast(pl.List(pl.String)).list.join("; ") if isinstance(kind, pl.List) else column.cast(pl.String)
    return pl.when(text.str.len_bytes() > 0).then(text).alias(key_name(name))


def key_name(name: str) -> str:
    """What the column of a group's key is called: other than that of the table, which is a number maybe."""
    return f"by {name}"


def log_names(log_ids: Iterable[str], runs: pl.DataFrame) -> dict[str, str]:
    """What each log is called: its file's name, with digits of its digest where that is another's too.

    Logs that the list of runs does not know are called by their digest.
    """
    known = runs.filter(pl.col("log_id").is_not_null())
    paths = dict(known.select("log_id", "path").iter_rows())
    stems = {log_id: PurePosixPath(paths[log_id]).stem if log_id in paths else log_id for log_id in log_ids}
    shared = Counter(stems.values())
    return {log_id: stem if shared[stem] == 1 else f"{stem} {log_id[:_DIGITS]}" for log_id, stem in stems.items()}


def group_name(key: Key, columns: Sequence[str], logs: Mapping[str, str]) -> str:
    """A group by the values of its key; a log by its name."""
    values = zip(columns, key, strict=True)
    words = (logs.get(value or "", value) if column == "log_id" else value for column, value in values)
    return ", ".join(UNKNOWN_GROUP if word is None else " ".join(word.split()) for word in words) or "all"


def in_order(keys: Iterable[Key], columns: Sequence[str], configs: Sequence[str], logs: Mapping[str, str]) -> list[Key]:
    """Keys of groups: numbers by size, texts by the alphabet, the older configuration first, what is unknown last.

    Keys are values of ``columns``; ``configs`` are in the order of ``in_order_of_runs``, ``logs`` the logs' names.
    """
    return sorted(keys, key=lambda key: [_place(*item, configs, logs) for item in zip(columns, key, strict=True)])


def _place(column: str, value: str | None, configs: Sequence[str], logs: Mapping[str, str]) -> tuple[bool, float, Any]:
    if value is None:
        return (True, 0.0, "")
    if column == "log_id":
        return (False, 0.0, natural(logs.get(value, value)))
    if column == "config":
        return (False, float(configs.index(value)) if value in configs else float("inf"), value)
    number = number_or_text(value)
    return (False, number if isinstance(number, float) else float("inf"), value)


def settings_by_config(runs: pl.DataFrame, configs: Sequence[str]) -> dict[str, Settings | None]:
    """Of each configuration the settings that are not the default, and the options; None where nothing says them."""
    found: dict[str, Settings | None] = dict.fromkeys(configs)
    for config, settings, options in runs.select("config", "settings", "options").iter_rows():  # the last row counts
        if config in found:
            try:
                found[config] = {**settings_in((settings or "").encode()), **({"options": options} if options else {})}
            except ConfigError:
                found[config] = None
    return found


def in_order_of_runs(present: Sequence[str], runs: pl.DataFrame) -> list[str]:
    """Configurations in the order in which they were first finished, those that no run names last."""
    known = runs.sort("finished_ns", maintain_order=True)["config"].unique(maintain_order=True).to_list()
    return [*(name for name in known if name in present), *(name for name in present if name not in known)]


def two_configs(asked: Sequence[str], configs: Mapping[str, Settings | None]) -> tuple[str, str]:
    """The reference and the candidate.

    Args:
        asked: two names, their first digits, or settings such as ``lanes.hold_s=2``; of a dataset of two it may be
            empty: then the older is the reference.
        configs: those of the dataset, the oldest first, with their settings.

    Raises:
        TableError: these are not two, or one is not found.
    """
    if not asked and len(configs) == 2:
        first, second = configs
        return first, second
    if len(asked) != 2:
        raise TableError(f"expected --config twice, found it {len(asked)} times; {_listed(configs)}")
    reference, candidate = (_found(name, configs) for name in asked)
    if reference == candidate:
        raise TableError(f"--config {asked[0]}, --config {asked[1]}: are the same; {_listed(configs)}")
    return reference, candidate


def _found(name: str, configs: Mapping[str, Settings | None]) -> str:
    matching = [config for config in configs if config.startswith(name)] or [
        config
        for config, settings in configs.items()
        if settings is not None and any(_is_same(name, text) for text in _texts(settings))
    ]
    if len(matching) != 1:
        number = "no configuration" if not matching else f"{len(matching)} configurations"
        raise TableError(f"--config {name}: names {number}; {_listed(configs)}")
    return matching[0]


def _is_same(asked: str, text: str) -> bool:
    """Whether two settings are one: 2 is 2.0."""
    (key, _, value), (other_key, _, other_value) = asked.partition("="), text.partition("=")
    return key == other_key and number_or_text(value) == number_or_text(other_value)


def _texts(settings: Settings) -> list[str]:
    return [f"{key}={as_typed(value)}" for key, value in settings.items()] or [DEFAULT]


def _listed(configs: Mapping[str, Settings | None]) -> str:
    said = {name: ["unknown"] if settings is None else _texts(settings) for name, settings in configs.items()}
    known = (f"{name} ({', '.join(texts)})" for name, texts in said.items())
    return f"the dataset has {'; '.join(known)}"
