"""Which of the varied settings changed nothing."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import polars as pl

from roadperc_stream.schemas.columns import TIME_COLUMNS

from .settings import Combination


def without_influence(folder: Path, tables: Sequence[Path], made: Sequence[Combination]) -> Iterator[str]:
    """The settings whose values leave every column of every table the same, times excepted, whatever the others are.

    Args:
        folder: the dataset.
        tables: of all combinations, each in its combination's folder or, where logs share a name, deeper.
        made: the combinations.
    """
    results: dict[str, list[bytes]] = {}
    for path in tables:
        results.setdefault(path.relative_to(folder).parts[0], []).append(_digest(path, made[0].settings))
    for key in made[0].settings:
        others = {_others(item, key) for item in made}
        found = {(_others(item, key), *results[item.folder]) for item in made}
        if len(others) < len(made) and len(found) == len(others):
            yield key


def _others(item: Combination, key: str) -> tuple[object, ...]:
    return tuple(value for name, value in item.settings.items() if name != key)


def _digest(path: Path, varied: Iterable[str]) -> bytes:
    """Of a table's rows, without times and the varied settings."""
    rows = pl.read_parquet(path, glob=False).drop(*TIME_COLUMNS, *varied, strict=False)
    return hashlib.sha256(rows.hash_rows().to_numpy().tobytes()).digest()
