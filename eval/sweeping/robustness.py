"""Resilience and error under corruptions, as Robo3D defines them.

Source: Kong et al., "Robo3D: Towards Robust and Reliable 3D Perception against Corruptions", ICCV 2023, section 4.
"""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any, Final

from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import TableError
from roadperc_stream.output.text_table import TextTable, row
from roadperc_stream.schemas.columns import RATIO
from roadperc_stream.system.files import METRICS_SUFFIX

from ..quantities import percent
from .ranking import SettingScore, SweepMetric, scores
from .settings import MARK, Combination

CLEAN: Final = "clean"
Scored = tuple[SweepMetric, Sequence[SettingScore]]
"""A metric, and the score of every combination."""


Rates = dict[str, float | None]
"""A rate by corruption, after its mean with the key ``mean``; None if undefined."""
MEAN: Final = "mean"


@dataclass(frozen=True)
class Robustness:
    """Resilience rates and corruption errors of a metric; the errors are empty without a baseline."""

    resilience: Rates
    error: Rates


def _with_mean(rates: Rates) -> Rates:
    known = [value for value in rates.values() if value is not None]
    return {MEAN: fmean(known) if known and len(known) == len(rates) else None, **rates} if rates else {}


def degradations(cfg: ReplayConfig, severities: Mapping[str, Sequence[int]]) -> tuple[Combination, ...]:
    """The clean log, then each corruption with each severity, under one configuration."""
    pairs = [(CLEAN, 0), *((name, severity) for name, several in severities.items() for severity in several)]
    return tuple(
        Combination(at, {"corruption": name, "severity": severity}, cfg) for at, (name, severity) in enumerate(pairs)
    )


def of_corruption(found: Sequence[Any], made: Sequence[Combination], name: str) -> list[Any]:
    """The items of the clean log and of one corruption; ``found`` has an item for each combination."""
    return [item for item, at in zip(found, made, strict=True) if at.settings["corruption"] in (CLEAN, name)]


def names_of(made: Sequence[Combination]) -> list[str]:
    """The corruptions in their order."""
    return list(dict.fromkeys(str(item.settings["corruption"]) for item in made[1:]))


def is_rated(metric: SweepMetric) -> bool:
    """Whether the rates are defined for a metric: it lies in 0 to 1, and 1 is best."""
    return metric.quantity.unit == RATIO and metric.quantity.better == "high"


def robustness(
    found: Sequence[SettingScore], made: Sequence[Combination], baseline: Sequence[SettingScore] | None
) -> Robustness:
    """Rates of a metric m in 0 to 1, over the severities of each corruption. Frames without a value count as 0.

    RR = sum(m) / (n m_clean), CE = sum(1 - m) / sum(1 - m_baseline).
    """
    rates, errors = Rates(), Rates()
    for name in names_of(made):
        clean, *values = map(_m, of_corruption(found, made, name))
        rates[name] = fmean(values) / clean if clean else None
        if baseline is not None:
            worse = sum(1 - _m(score) for score in of_corruption(baseline, made, name)[1:])
            errors[name] = sum(1 - value for value in values) / worse if worse else None
    return Robustness(_with_mean(rates), _with_mean(errors))


def _m(score: SettingScore) -> float:
    return (score.value or 0.0) * score.coverage


def rates(found: Sequence[Scored], made: Sequence[Combination], baseline: Path | None) -> dict[str, Robustness]:
    """The rates of each metric in 0 to 1, by the metric's name.

    Raises:
        TableError: the baseline cannot be read.
    """
    tables = sorted(baseline.rglob(f"*{METRICS_SUFFIX}")) if baseline is not None else []
    return {
        metric.quantity.name: robustness(own, made, scores(tables, made, metric) if tables else None)
        for metric, own in found
        if is_rated(metric) and any(score.value is not None for score in own)
    }


def require_baseline(folder: Path, facts: Mapping[str, Any]) -> None:
    """Check that a folder is a sweep over the same corruptions, severities, seed and logs.

    Raises:
        TableError: it is another folder.
    """
    mark = folder / MARK
    known = tomllib.loads(mark.read_text(encoding="utf-8")) if mark.is_file() else {}
    for key in ("degrade", "seed", "logs"):
        if known.get(key) != facts[key]:
            raise TableError(f"{folder}: {key} {known.get(key)}, expected a sweep with {facts[key]}")


def rates_tables(rated: Mapping[str, Robustness], baseline: Path | None) -> Iterator[TextTable]:
    """A row per metric: mRR and the rate of each corruption; with a baseline also mCE and the errors."""
    note = "RR: mean over the severities, in percent of the clean log; frames without a value count as 0"
    yield _table("mRR", {name: item.resilience for name, item in rated.items()}, note)
    if baseline is not None:
        note = f"CE: sum of 1 - value, in percent of the baseline {baseline}"
        yield _table("mCE", {name: item.error for name, item in rated.items()}, note)


def _table(mean: str, rates: Mapping[str, Rates], note: str) -> TextTable:
    headers = tuple(mean if key == MEAN else key for key in next(iter(rates.values()), ()))
    rows = (row(name, *("" if v is None else percent(v) for v in item.values())) for name, item in rates.items())
    return TextTable(f"{mean}, %", headers, tuple(rows), (note,))
