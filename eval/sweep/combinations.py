"""The combinations of a sweep, and the folder with their tables."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final

import tomli_w

from roadperc_stream import __version__
from roadperc_stream.chain.own_stage import own_stages
from roadperc_stream.config import ReplayConfig, load_config
from roadperc_stream.errors import TableError
from roadperc_stream.output.tables import Scalar
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT
from roadperc_stream.system.files import METRICS_SUFFIX, completing_folder, target_errors

from ..configurations import setting_of
from ..runs import distinct_names

MARK: Final = "sweep.toml"
"""The file that marks the folder of a sweep and holds its settings and logs."""
CLEAN: Final = "clean"


@dataclass(frozen=True)
class Combination:
    """One value of every varied setting, and the configuration with these values; ``number`` counts from 0."""

    number: int
    settings: Mapping[str, Scalar]
    cfg: ReplayConfig

    @property
    def folder(self) -> str:
        """Name of its folder; names sort in the order of the combinations."""
        return f"{self.number:04}"

    def __str__(self) -> str:
        return " ".join(f"{key}={shown(value)}" for key, value in self.settings.items())


def combinations(
    config: Path | None, settings: Sequence[str], vary: Mapping[str, Sequence[str]]
) -> tuple[Combination, ...]:
    """All combinations of the varied values, on top of a configuration file and settings; the last key varies fastest.

    Raises:
        ConfigError: a key or value is invalid; the message names it.
    """
    choices = product(*([f"{key}={text}" for text in texts] for key, texts in vary.items()))
    cfgs = [own_stages(load_config(config, (*settings, *choice)))[0] for choice in choices]
    columns = {key: _of_one_type([setting_of(cfg, key) for cfg in cfgs]) for key in vary}
    return tuple(
        Combination(number, {key: values[number] for key, values in columns.items()}, cfg)
        for number, cfg in enumerate(cfgs)
    )


def degradations(cfg: ReplayConfig, severities: Mapping[str, Sequence[int]]) -> tuple[Combination, ...]:
    """The clean log, then each corruption with each severity, under one configuration."""
    pairs = [(CLEAN, 0), *((name, severity) for name, several in severities.items() for severity in several)]
    return tuple(Combination(at, {"corruption": name, "severity": s}, cfg) for at, (name, s) in enumerate(pairs))


def reference_of(made: Sequence[Combination], cfg: ReplayConfig) -> Combination:
    """The combination with this configuration, else the first one; others are compared with it."""
    return next((item for item in made if item.cfg == cfg), made[0])


def shown(value: Scalar) -> str:
    """A value as a user types it."""
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def _of_one_type(values: Sequence[Scalar]) -> Sequence[Scalar]:
    """Values of one Parquet column: numbers beside texts, as in ``auto,64``, become texts."""
    types = {type(value) for value in values}
    return values if len(types) == 1 else [shown(value) for value in values]


@contextmanager
def dataset(target: Path, force: bool) -> Iterator[Path]:
    """A partial folder that is renamed to ``target`` on success and removed on failure.

    Raises:
        TableError: the target is a file, an earlier sweep without ``force``, or a folder with other files.
    """
    if target.exists() and not target.is_dir():
        raise TableError(f"{target}: is a file, expected the name of a folder")
    if target.is_dir() and any(target.iterdir()):
        if not (target / MARK).is_file():
            raise TableError(f"{target}: the folder holds other files; pass another one")
        if not force:
            raise TableError(f"{target}: exists; pass --force to overwrite it")
    with completing_folder(target) as hidden:
        yield hidden


def describe(folder: Path, made: Sequence[Combination], facts: Mapping[str, Any]) -> None:
    """Write the varied settings, more facts, and the whole configuration of each combination.

    Raises:
        TargetError: a file cannot be written.
    """
    vary = {key: list(dict.fromkeys(item.settings[key] for item in made)) for key in made[0].settings}
    texts = {folder / MARK: tomli_w.dumps({"version": __version__, **facts, "vary": vary})}
    texts |= {folder / item.folder / CONFIG_ATTACHMENT: item.cfg.to_toml() for item in made}
    for path, text in texts.items():
        with target_errors(path):
            path.write_text(text, encoding="utf-8")


def table_names(logs: Sequence[Path]) -> list[str]:
    """A table name for each log; logs of equal names get as many folders as needed to make them unique."""
    names = distinct_names([log.with_suffix(METRICS_SUFFIX) for log in logs])
    return [f"{name.lstrip('/')}{METRICS_SUFFIX}" for name in names]
