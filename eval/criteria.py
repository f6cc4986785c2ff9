"""Criteria files: absolute limits on metrics and columns, and the relevant effect and the limit of a metric.

A file is TOML, with tables ``[[criterion]]`` for roadperc-check, and ``[metrics.NAME]`` for roadperc-compare.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from roadperc_stream.config.complaints import complaint
from roadperc_stream.config.settings import read_toml
from roadperc_stream.errors import ConfigError
from roadperc_stream.system.text import in_brief, nearest

from .compare.metrics import METRICS
from .expressions import parsed

Statistic = Literal["mean", "median", "p1", "p5", "p95", "p99", "min", "max", "share", "rate", "findings"]
DEFAULT_CRITERIA: Final = Path(__file__).with_name("criteria.toml")
BY_NAME: Final = {metric.name: metric for metric in METRICS}
_NAME: Final = r"[A-Za-z0-9_\-./ ]+"
"""Characters that MLflow allows in the name of a metric."""
_LIKENESS: Final = 0.5
_Number = Annotated[float, Field(allow_inf_nan=False)]
_NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Effect(_Table):
    """The smallest relevant effect and the limit of a metric, in its unit; None if the file does not give it."""

    relevant: _NotNegative | None = None
    limit: _NotNegative | None = None


class Criterion(_Table):
    """A bound on a statistic of a metric or a column, over the frames that fulfil ``filter``.

    The values of an error metric are absolute. ``within`` belongs to the share of values, ``event`` (an SQL condition)
    to the rate of its beginnings per minute. The statistic ``findings`` is the largest number of findings of a run.
    """

    name: str = ""
    metric: str | None = None
    column: str | None = None
    statistic: Statistic
    most: _Number | None = None
    least: _Number | None = None
    within: _NotNegative | None = None
    event: str | None = None
    least_coverage: Annotated[float, Field(ge=0, le=1)] = 0.0
    least_frames: Annotated[int, Field(ge=1)] = 1
    filter: str | None = None
    per_log: bool = False

    @model_validator(mode="after")
    def _fits(self) -> Self:
        counted = self.statistic in ("rate", "findings")
        if (self.most is None) == (self.least is None):
            raise ValueError("expected one of most and least")
        if (self.metric is None) + (self.column is None) != 1 + counted:
            found = "no metric and no column" if counted else "one of metric and column"
            raise ValueError(f"{self.statistic} expects {found}")
        for key, value, owner in (("within", self.within, "share"), ("event", self.event, "rate")):
            if (value is not None) != (self.statistic == owner):
                raise ValueError(f"{key} belongs to the statistic {owner}, found {self.statistic}")
        if counted and self.least_coverage:
            raise ValueError(f"least_coverage does not belong to the statistic {self.statistic}")
        if self.filter is not None and self.statistic == "findings":
            raise ValueError("filter does not belong to the statistic findings")
        if self.metric is not None and self.metric not in BY_NAME:
            raise ValueError(f"no metric {self.metric}; {hint(self.metric, BY_NAME)}")
        if self.metric is not None and BY_NAME[self.metric].whole and self.statistic != "mean":
            raise ValueError(f"{self.metric} is one figure of all frames: expected the statistic mean")
        if not re.fullmatch(_NAME, self.title):
            raise ValueError("expected a name of letters, digits, spaces and _-./")
        return self

    @property
    def subject(self) -> str:
        """The metric, the column or the event."""
        return self.metric or self.column or self.event or ""

    @property
    def title(self) -> str:
        """The name, or the metric with the statistic; unique within the file."""
        subject = "event" if self.statistic == "rate" else self.subject
        return self.name or f"{subject} {self.statistic}".strip()

    @property
    def bound(self) -> str:
        """The bound as words, such as ``at most 0.1``."""
        return f"at most {self.most:.4g}" if self.most is not None else f"at least {self.least:.4g}"


class Criteria(_Table):
    """The content of a criteria file."""

    metrics: Mapping[str, Effect] = Field(default_factory=dict)
    criterion: tuple[Criterion, ...] = Field(default=(), strict=False)


def hint(name: str, known: Iterable[str]) -> str:
    """The known name that is nearest to a wrong one, else all known names."""
    names = list(known)
    near = nearest(name, names, _LIKENESS)
    return f"did you mean {near}?" if near else f"known: {', '.join(names)}"


def read_criteria(path: Path) -> tuple[Criterion, ...]:
    """The criteria of a file, at least one.

    Raises:
        ConfigError: the file cannot be read, has no criterion, or a key or value is invalid; the message names it.
    """
    criteria = _read(path).criterion
    if not criteria:
        raise ConfigError(f"{path}: has no [[criterion]]")
    titles = Counter(criterion.title for criterion in criteria)
    title, count = titles.most_common(1)[0]
    if count > 1:
        raise ConfigError(f"{path}: {count} criteria are named {title!r}; give each its own name")
    for criterion in criteria:
        for key, text in (("filter", criterion.filter), ("event", criterion.event)):
            try:
                parsed("true" if text is None else text)
            except ValueError as error:
                where = f"{path}: criterion {criterion.title!r}: {key}"
                raise ConfigError(f"{where}: {in_brief(text)} is no SQL expression: {error}") from error
    return criteria


def effects(path: Path) -> Mapping[str, Effect]:
    """The effects of the tables ``[metrics.NAME]`` of a file, by metric.

    Raises:
        ConfigError: the file cannot be read, or a key or value is invalid; the message names it.
    """
    found = _read(path).metrics
    for name in found:
        if name not in BY_NAME:
            raise ConfigError(f"{path}: metrics.{name}: no such metric; {hint(name, BY_NAME)}")
    return found


def _read(path: Path) -> Criteria:
    tree = read_toml(path)
    try:
        return Criteria.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{path}: {_complaint(error, tree)}") from error


def _complaint(error: ValidationError, tree: Mapping[str, Any]) -> str:
    """The first error, such as ``criterion 2 ('left'): least_frames: expected ..., found 0``."""
    first = min(error.errors(), key=lambda found: found["type"] != "extra_forbidden")
    *place, key = first["loc"] or ("",)
    if first["type"] == "value_error":
        place, key = [*place, key], ""
    where = _place(place, tree)
    if first["type"] == "extra_forbidden":
        model: type[_Table] = {2: Effect if place[:1] == ["metrics"] else Criterion}.get(len(place), Criteria)
        return f"{where}no key {key}; {hint(str(key), model.model_fields)}"
    if first["type"] == "missing":
        return f"{where}expected the key {key}"
    return f"{where}{f'{key}: ' if key else ''}{complaint(first)}"


def _place(place: list[Any], tree: Mapping[str, Any]) -> str:
    if len(place) < 2 or place[0] != "criterion":
        return f"{'.'.join(map(str, place))}: " if place else ""
    table = tree["criterion"][place[1]]
    name = table.get("name") or table.get("metric") or table.get("column") if isinstance(table, Mapping) else None
    return f"criterion {place[1] + 1}{f' ({in_brief(name)})' if name else ''}: "
