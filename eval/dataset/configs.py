"""Which configurations of a dataset are meant, and what tells them apart."""

from collections.abc import Mapping, Sequence

import polars as pl

from roadperc_stream.core.config.settings import as_typed, settings_in
from roadperc_stream.errors import ConfigError, TableError

Settings = Mapping[str, object]
DEFAULT: str = "default"


def settings_by_config(runs: pl.DataFrame, configs: Sequence[str]) -> dict[str, Settings | None]:
    """Of each configuration the settings that are not the default, and the options; None where nothing says them."""
    return {config: _settings(runs, config) for config in configs}


def _settings(runs: pl.DataFrame, config: str) -> Settings | None:
    rows = runs.filter(pl.col("config") == config).select("settings", "options")
    if not rows.height:
        return None
    settings, options = rows.row(-1)
    try:
        return {**settings_in((settings or "").encode()), **({"options": options} if options else {})}
    except ConfigError:
        return None


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
    if key != other_key:
        return False
    try:
        return float(value) == float(other_value)
    except ValueError:
        return value == other_value


def _texts(settings: Settings) -> list[str]:
    return [f"{key}={as_typed(value)}" for key, value in settings.items()] or [DEFAULT]


def _listed(configs: Mapping[str, Settings | None]) -> str:
    said = {name: ["unknown"] if settings is None else _texts(settings) for name, settings in configs.items()}
    known = (f"{name} ({', '.join(texts)})" for name, texts in said.items())
    return f"the dataset has {'; '.join(known)}"
