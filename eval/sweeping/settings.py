"""The configuration of each combination of the values a sweep varies."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product
from pathlib import Path
from typing import Final

from roadperc_stream.core.config import ReplayConfig, load_config
from roadperc_stream.output.tables import Scalar

from .varied import Varied

AT_ONCE: Final = 32
"""Combinations that go through a log together: each has up to 1000 rows, some 4 MB, waiting to be written."""


@dataclass(frozen=True)
class Combination:
    """One value of every varied setting, and the configuration with them; ``number`` counts from 0."""

    number: int
    settings: Mapping[str, Scalar]
    cfg: ReplayConfig

    @property
    def folder(self) -> str:
        """Name of its folder in the dataset: names in alphabetical order are in the order of the combinations."""
        return f"{self.number:04}"

    def __str__(self) -> str:
        return " ".join(f"{key}={shown(value)}" for key, value in self.settings.items())


def combinations(config: Path | None, settings: Sequence[str], vary: Sequence[Varied]) -> tuple[Combination, ...]:
    """Every combination of the varied values over the configuration of a file and settings, the last varied fastest.

    Raises:
        ConfigError: a key or value does not fit; the message names it.
    """
    choices = product(*([f"{item.key}={text}" for text in item.texts] for item in vary))
    cfgs = [load_config(config, (*settings, *choice)) for choice in choices]
    columns = {item.key: _of_one_type([setting_of(cfg, item.key) for cfg in cfgs]) for item in vary}
    return tuple(
        Combination(number, {key: values[number] for key, values in columns.items()}, cfg)
        for number, cfg in enumerate(cfgs)
    )


def reference_of(made: Sequence[Combination], cfg: ReplayConfig) -> Combination:
    """The combination that others are compared with: that of a configuration, else the first."""
    return next((item for item in made if item.cfg == cfg), made[0])


def passes(made: Sequence[Combination]) -> list[tuple[Combination, ...]]:
    """Combinations that may take the same samples, so that a log is read and decoded once for all of them."""
    groups: dict[Hashable, list[Combination]] = {}
    for item in made:
        groups.setdefault(_decoding(item.cfg), []).append(item)
    return [tuple(group[at : at + AT_ONCE]) for group in groups.values() for at in range(0, len(group), AT_ONCE)]


def shown(value: Scalar) -> str:
    """A value as one types it."""
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def setting_of(cfg: ReplayConfig, key: str) -> Scalar:
    """The value of a setting such as ``lanes.hold_s``; a list of words is joined by commas."""
    value = reduce(getattr, key.split("."), cfg)
    return ",".join(value) if isinstance(value, tuple) else value  # type: ignore[return-value]


def _decoding(cfg: ReplayConfig) -> Hashable:
    """All that samples depend on besides the log: see ``ReplayInput.samples`` and ``assemble.sample_of``."""
    return (cfg.sync, cfg.limits, cfg.tag_table, cfg.surface.assumed_height_m)


def _of_one_type(values: Sequence[Scalar]) -> Sequence[Scalar]:
    """Values as one Parquet column can hold them: numbers and words together, as in ``auto,64``, become words."""
    types = {type(value) for value in values}
    return values if len(types) == 1 else [shown(value) for value in values]
