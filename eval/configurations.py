"""The configurations of runs: groups of equal configuration, and the settings that differ."""

import hashlib
import re
from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import chain
from typing import Any, Final

from roadperc_stream.config import ReplayConfig
from roadperc_stream.config.settings import BUILT_IN_STAGES, NOT_SET, as_typed, is_about_log, settings_in
from roadperc_stream.errors import ConfigError
from roadperc_stream.output.tables import Scalar
from roadperc_stream.output.text_table import Table, values_of_subjects
from roadperc_stream.schemas.record import NETWORKS_COMMENT

from .runs import Run

Settings = Mapping[str, Any]
"""Values by keys such as ``lanes.hold_s``."""
UNKNOWN: Final = "unknown"
NO_SUCH_SETTING: Final = "-"
_TITLE: Final = "Settings that differ"
_DIGITS: Final = 8
"""Digits shown of a configuration's digest."""
_DIGEST: Final = re.compile(r"(?<= )[0-9a-f]{64}$")
"""The SHA-256 of a stage's source."""
_MOST_CHARACTERS: Final = 100
"""Longer values are not shown."""


@dataclass(frozen=True)
class Group:
    """Runs of one configuration and version, which may be pooled."""

    name: str
    runs: tuple[Run, ...]

    @property
    def example(self) -> Run:
        """A run that has the settings, which are the same in all runs."""
        return next((run for run in self.runs if run.config), self.runs[0])


def grouped(runs: Sequence[Run]) -> list[Group]:
    """The runs by configuration and version, in the order of appearance.

    A run without a configuration is a separate group. Groups are named by their only run, else by their configuration.
    """
    groups: dict[Hashable, list[Run]] = {}
    for run in runs:
        groups.setdefault(_made_by(run), []).append(run)
    digests = Counter(short_digest(some[0].config_digest) for some in groups.values())

    def name(some: Sequence[Run]) -> str:
        digest = short_digest(some[0].config_digest)
        version = "" if digests[digest] == 1 else f" {some[0].version or UNKNOWN}"
        return some[0].name if len(some) == 1 else f"{digest}{version}"

    return [Group(name(some), tuple(some)) for some in groups.values()]


def short_digest(digest: str) -> str:
    """The first digits of a configuration's digest."""
    return digest[:_DIGITS] or UNKNOWN


def setting_of(cfg: ReplayConfig, key: str) -> Scalar:
    """The value of a setting such as ``lanes.hold_s``; a list is joined by commas."""
    value = reduce(getattr, key.split("."), cfg)
    return ",".join(value) if isinstance(value, tuple) else value  # type: ignore[return-value]


def settings_of(run: Run) -> Settings | None:
    """The settings that a run's table records; None if it has none, or no valid ones."""
    try:
        return {**BUILT_IN_STAGES, **settings_in(run.config.encode(errors="surrogateescape"))} if run.config else None
    except ConfigError:
        return None


def differing(configurations: Sequence[Settings]) -> dict[str, tuple[str, ...]]:
    """The settings that differ between configurations, each with its values."""

    def value(settings: Settings, key: str) -> str:
        unset = NOT_SET if is_about_log(key) else NO_SUCH_SETTING
        return _in_short(as_typed(settings[key])) if key in settings else unset

    keys = dict.fromkeys(chain.from_iterable(configurations))
    rows = {key: tuple(value(settings, key) for settings in configurations) for key in keys}
    return {key: values for key, values in rows.items() if len(set(values)) > 1}


def _in_short(value: str) -> str:
    """The value with short digests; of a long one, such as the picture of a template, its length and digest."""
    value = _DIGEST.sub(lambda found: found[0][:_DIGITS], value)
    if len(value) <= _MOST_CHARACTERS:
        return value
    return f"{len(value)} characters with sha256 {hashlib.sha256(value.encode()).hexdigest()[:_DIGITS]}"


def change(base: Run, new: Run) -> tuple[str, ...]:
    """The changed settings of two runs: a heading and a line for each setting; empty if there are none."""
    if base.config_digest and base.config_digest == new.config_digest:
        return ()
    ours, theirs = settings_of(base), settings_of(new)
    if ours is None or theirs is None:
        return (f"{UNKNOWN}, because a run has no configuration in its table",)
    rows = differing([ours, theirs])
    if _networks(base) != _networks(new):
        rows["networks of the input"] = _networks(base), _networks(new)
    return (
        "" if rows else "none",
        *(f"{key} {' → '.join(value or 'none' for value in values)}" for key, values in rows.items()),
    )


def _networks(run: Run) -> str:
    """The first digits of the digest of the networks that computed channels of the input; ``none`` without them."""
    return run.config.rpartition(NETWORKS_COMMENT)[2][:_DIGITS] if NETWORKS_COMMENT in run.config else "none"


def settings_table(runs: Mapping[str, Run]) -> Table:
    """The settings that differ between runs, by their names in the table; empty for a single configuration."""
    values, notes = settings_that_differ(runs)
    return values_of_subjects(_TITLE, values, tuple(runs), notes)


def settings_that_differ(runs: Mapping[str, Run]) -> tuple[dict[str, dict[str, str]], tuple[str, ...]]:
    """The values of the settings that differ between runs, by setting and name; and notes on them."""
    if len({_made_by(run) for run in runs.values()}) < 2:
        return {}, ()
    found = {name: settings_of(run) for name, run in runs.items()}
    values = _differing_values(found)
    return values, tuple(_notes(found, values))


def table_of_settings(found: Mapping[str, Settings | None]) -> Table:
    """The settings that differ; ``found`` has the settings of each subject, None if they are unknown."""
    return values_of_subjects(_TITLE, _differing_values(found), tuple(found))


def _differing_values(found: Mapping[str, Settings | None]) -> dict[str, dict[str, str]]:
    known = {name: settings for name, settings in found.items() if settings is not None}
    rows = {key: dict(zip(known, row, strict=True)) for key, row in differing(list(known.values())).items()}
    return {key: {name: row.get(name, UNKNOWN) for name in found} for key, row in rows.items()}


def _notes(found: Mapping[str, Settings | None], values: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    unknown = [name for name, settings in found.items() if settings is None]
    if unknown:
        yield f"{UNKNOWN}: no configuration in the table: {', '.join(unknown)}"
    if not values and len(unknown) < len(found) - 1:
        yield "none: the versions differ"
    if any(NO_SUCH_SETTING in row.values() for row in values.values()):
        yield f"{NO_SUCH_SETTING}: the version that made the run has no such setting"


def _made_by(run: Run) -> Hashable:
    return (run.config_digest, run.version) if run.config_digest else run.path
