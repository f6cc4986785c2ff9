"""What the logs and the groups of a dataset are called."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, Final

import polars as pl

from roadperc_stream.storage.patterns import natural

from .keys import UNKNOWN_GROUP, Key

_DIGITS: Final = 8
"""Of a log's digest that tell logs of one name apart."""


def log_names(log_ids: Iterable[str], runs: pl.DataFrame) -> dict[str, str]:
    """What each log is called: its file's name, with digits of its digest where that is another's too.

    Args:
        log_ids: of the dataset's tables.
        runs: the list of runs; logs that it does not know are called by their digest.
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

    Args:
        keys: of the groups.
        columns: what the keys are values of.
        configs: in the order in which they were first finished.
        logs: what each log is called.
    """
    return sorted(keys, key=lambda key: [_place(*item, configs, logs) for item in zip(columns, key, strict=True)])


def _place(column: str, value: str | None, configs: Sequence[str], logs: Mapping[str, str]) -> tuple[bool, float, Any]:
    if value is None:
        return (True, 0.0, "")
    if column == "log_id":
        return (False, 0.0, natural(logs.get(value, value)))
    if column == "config":
        return (False, float(configs.index(value)) if value in configs else float("inf"), value)
    try:
        return (False, float(value), value)
    except ValueError:
        return (False, float("inf"), value)
