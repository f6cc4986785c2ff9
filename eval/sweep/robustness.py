"""Resilience and error under corruptions, as Robo3D defines them.

Source: Kong et al., "Robo3D: Towards Robust and Reliable 3D Perception against Corruptions", ICCV 2023, section 4.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, Final

from roadperc_stream.config import ReplayConfig
from roadperc_stream.config.settings import read_toml
from roadperc_stream.errors import TableError
from roadperc_stream.output.text_table import Table
from roadperc_stream.schemas.columns import RATIO
from roadperc_stream.system.files import METRICS_SUFFIX

from ..report_columns import percent
from .ranking import SettingScore, SweepMetric, scores
from .settings import MARK, Combination

CLEAN: Final = "clean"
MEAN: Final = "mean"
Scored = tuple[SweepMetric, Sequence[SettingScore]]
"""A metric, and the score of every combination."""
Rates = dict[str, float | None]
"""A rate by corruption, after the mean of all; None if undefined."""


def degradations(cfg: ReplayConfig, severities: Mapping[str, Sequence[int]]) -> tuple[Combination, ...]:
    """The clean log, then each corruption with each severity, under one configuration."""
    pairs = [(CLEAN, 0), *((name, severity) for name, several in severities.items() for severity in several)]
    return tuple(Combination(at, {"corruption": name, "severity": s}, cfg) for at, (name, s) in enumerate(pairs))


def of_corruption(found: Sequence[Any], made: Sequence[Combination], name: str) -> list[Any]:
    """The items of the clean log and of one corruption; ``found`` has an item for each combination."""
    return [item for item, at in zip(found, made, strict=True) if at.settings["corruption"] in (CLEAN, name)]


def names_of(made: Sequence[Combination]) -> list[str]:
    """The corruptions in their order."""
    return list(dict.fromkeys(str(item.settings["corruption"]) for item in made[1:]))


def robustness(
    found: Sequence[SettingScore], made: Sequence[Combination], baseline: Sequence[SettingScore] | None
) -> tuple[Rates, Rates]:
    """Resilience rates and corruption errors of a metric m in 0 to 1; no errors without a baseline.

    RR = sum(m) / (n m_clean), CE = sum(1 - m) / sum(1 - m_baseline), over n severities. Frames without a value count as
    0, so m is the score times the coverage.
    """
    rates, errors = Rates(), Rates()
    values, base = ([(s.value or 0.0) * s.coverage for s in several] for several in (found, baseline or found))
    for name in names_of(made):
        clean, *own = of_corruption(values, made, name)
        worse = sum(1 - value for value in of_corruption(base, made, name)[1:])
        rates[name] = fmean(own) / clean if clean else None
        errors[name] = sum(1 - value for value in own) / worse if worse else None
    return _with_mean(rates), _with_mean(errors) if baseline else {}


def _with_mean(rates: Rates) -> Rates:
    known = [value for value in rates.values() if value is not None]
    return {MEAN: fmean(known) if known and len(known) == len(rates) else None, **rates}


def robustness_of_all(
    found: Sequence[Scored], made: Sequence[Combination], baseline: Path | None
) -> dict[str, tuple[Rates, Rates]]:
    """Rates and errors of each metric that lies in 0 to 1, where 1 is best, by its name.

    Raises:
        TableError: the tables of the baseline, the folder of another sweep, cannot be read.
    """
    tables = sorted(baseline.rglob(f"*{METRICS_SUFFIX}")) if baseline else []
    return {
        metric.quantity.name: robustness(own, made, scores(tables, made, metric) if tables else None)
        for metric, own in found
        if metric.quantity.unit == RATIO and metric.quantity.better == "high" and own[0].value is not None
    }


def require_baseline(folder: Path, facts: Mapping[str, Any]) -> None:
    """Check that a folder is a sweep over the same corruptions, severities, seed and logs.

    Raises:
        TableError: it is another folder.
    """
    mark = folder / MARK
    known = read_toml(mark) if mark.is_file() else {}
    for key in ("degrade", "seed", "logs"):
        if known.get(key) != facts[key]:
            raise TableError(f"{folder}: {key} {known.get(key)}, expected a sweep with {facts[key]}")


def tables_of(rated: Mapping[str, tuple[Rates, Rates]], baseline: Path | None) -> Iterator[Table]:
    """A row per metric: mRR and the rate of each corruption; with a baseline also mCE and the errors."""
    notes = ["RR: mean over the severities, in percent of the clean log; frames without a value count as 0"]
    notes += [f"CE: sum of 1 - value, in percent of the baseline {baseline}"] if baseline else []
    for at, (mean, note) in enumerate(zip(("mRR", "mCE"), notes, strict=False)):
        headers = tuple(mean if key == MEAN else key for key in next(iter(rated.values()), ({}, {}))[at])
        cells = {name: ["" if v is None else percent(v) for v in both[at].values()] for name, both in rated.items()}
        yield Table(f"{mean}, %", headers, tuple((name, *texts) for name, texts in cells.items()), (note,))
