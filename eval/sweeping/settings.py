"""The configuration of each combination of the values a sweep varies, and the folder that gets their tables."""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from itertools import product
from pathlib import Path
from typing import Final

import tomli_w

from roadperc_stream import __version__
from roadperc_stream.config import ReplayConfig, load_config
from roadperc_stream.errors import TableError
from roadperc_stream.output.tables import Scalar
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT
from roadperc_stream.system.files import METRICS_SUFFIX, completing_folder, target_errors

from ..options import Varied
from ..runs import distinct_names

AT_ONCE: Final = 32
"""Combinations that go through a log together: each has up to 1000 rows, some 4 MB, waiting to be written."""
MARK: Final = "sweep.toml"
"""The file that makes a folder a sweep's: what was varied, over which logs."""


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


@contextmanager
def dataset(target: Path, force: bool) -> Iterator[Path]:
    """A folder to fill, which takes its name when all went well and is removed when not.

    Raises:
        TableError: the name is taken: by a former sweep without ``force``, or by anything else.
    """
    if target.exists():
        if not target.is_dir():
            raise TableError(f"{target}: is a file, expected the name of a folder")
        if any(target.iterdir()):
            if not (target / MARK).is_file():
                raise TableError(f"{target}: is a folder with other things in it; name a new one")
            if not force:
                raise TableError(f"{target}: exists; pass --force to overwrite it")
    with completing_folder(target) as hidden:
        yield hidden


def describe(folder: Path, made: Sequence[Combination], logs: Sequence[Path]) -> None:
    """Write what was varied over which logs, and the whole configuration of each combination.

    Raises:
        TargetError: a file cannot be written.
    """
    vary = {key: list(dict.fromkeys(item.settings[key] for item in made)) for key in made[0].settings}
    facts = {"version": __version__, "logs": [str(log.absolute()) for log in logs], "vary": vary}
    texts = {folder / MARK: tomli_w.dumps(facts)}
    texts |= {folder / item.folder / CONFIG_ATTACHMENT: item.cfg.to_toml() for item in made}
    for path, text in texts.items():
        with target_errors(path):
            path.write_text(text, encoding="utf-8")


def table_names(logs: Sequence[Path]) -> list[str]:
    """A file name for each log's tables: after the log, where two share one with the folders that tell them apart."""
    return [
        f"{name.lstrip('/')}{METRICS_SUFFIX}"
        for name in distinct_names([log.with_suffix(METRICS_SUFFIX) for log in logs])
    ]


def tables(folder: Path) -> list[Path]:
    """All tables of a dataset, in the order of the combinations."""
    return sorted(folder.rglob(f"*{METRICS_SUFFIX}"))
