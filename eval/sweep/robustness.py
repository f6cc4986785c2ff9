"""Resilience and error under corruptions, as Robo3D defines them, and the curves of each metric by severity.

Source: Kong et al., "Robo3D: Towards Robust and Reliable 3D Perception against Corruptions", ICCV 2023, section 4.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, Final

from roadperc_stream.config.settings import read_toml
from roadperc_stream.errors import TableError
from roadperc_stream.output.text_table import Table
from roadperc_stream.schemas.columns import RATIO
from roadperc_stream.system.files import METRICS_SUFFIX

from ..html.figures import colour_of, escaped
from ..report_columns import percent, rounded
from .combinations import CLEAN, MARK, Combination
from .ranking import Scored, SettingScore, scores

MEAN: Final = "mean"
Rates = dict[str, float | None]
"""A rate by corruption, after the mean of all; None if undefined."""
_ACROSS: Final = 3
_WIDTH, _HEIGHT = 300, 190
"""Pixels of a panel."""
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 12, 30, 22
"""Pixels around the curves of a panel."""
_LEGEND: Final = 24
_WORST: Final = 5


def names_of(made: Sequence[Combination]) -> list[str]:
    """The corruptions in their order."""
    return list(dict.fromkeys(str(item.settings["corruption"]) for item in made[1:]))


def of_corruption(found: Sequence[Any], made: Sequence[Combination], name: str) -> list[Any]:
    """The items of the clean log and of one corruption; ``found`` has an item for each combination."""
    return [item for item, at in zip(found, made, strict=True) if at.settings["corruption"] in (CLEAN, name)]


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


def rate_tables(rated: Mapping[str, tuple[Rates, Rates]], baseline: Path | None) -> Iterator[Table]:
    """A row per metric: mRR and the rate of each corruption; with a baseline also mCE and the errors."""
    notes = ["RR: mean over the severities, in percent of the clean log; frames without a value count as 0"]
    notes += [f"CE: sum of 1 - value, in percent of the baseline {baseline}"] if baseline else []
    for at, (mean, note) in enumerate(zip(("mRR", "mCE"), notes, strict=False)):
        headers = tuple(mean if key == MEAN else key for key in next(iter(rated.values()), ({}, {}))[at])
        cells = {name: ["" if v is None else percent(v) for v in both[at].values()] for name, both in rated.items()}
        yield Table(f"{mean}, %", headers, tuple((name, *texts) for name, texts in cells.items()), (note,))


def curves(found: Sequence[Scored], made: Sequence[Combination]) -> str:
    """SVG of a panel per metric, with a curve per corruption. A severity without a value has no point."""
    names = names_of(made)
    rows = -(-len(found) // _ACROSS)
    legend_rows = -(-len(names) // _ACROSS)
    size = _ACROSS * _WIDTH, rows * _HEIGHT + legend_rows * _LEGEND
    parts = [part for at, scored in enumerate(found) for part in _panel(at, scored, made)]
    for at, name in enumerate(names):
        x, y = at % _ACROSS * _WIDTH + _LEFT, rows * _HEIGHT + at // _ACROSS * _LEGEND + 12
        parts.append(f'<path d="M{x} {y}h24" stroke="{colour_of(at)}" stroke-width="3"/>{_text(x + 30, y + 4, name)}')
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size[0]} {size[1]}" font-family="sans-serif"'
    return "\n".join((f'{head} font-size="12"><rect width="100%" height="100%" fill="white"/>', *parts, "</svg>\n"))


def _panel(at: int, scored: Scored, made: Sequence[Combination]) -> Iterator[str]:
    """Title, axes and curves of a metric; the vertical axis begins at 0."""
    (metric, scores), (row, column) = scored, divmod(at, _ACROSS)
    left, top, bottom = column * _WIDTH + _LEFT, row * _HEIGHT + _TOP, (row + 1) * _HEIGHT - _BOTTOM
    most = max((score.value or 0.0 for score in scores), default=0.0) or 1.0
    yield _text(left, top - 12, metric.quantity.label)
    yield f'<path d="M{left} {top}V{bottom}H{(column + 1) * _WIDTH - _RIGHT}" fill="none" stroke="grey"/>'
    yield _text(left - 4, top + 8, rounded(most, metric.quantity), "end") + _text(left - 4, bottom, "0", "end")
    step = (_WIDTH - _LEFT - _RIGHT) / _WORST
    for severity in range(_WORST + 1):
        yield _text(left + severity * step, bottom + 14, str(severity) if severity else "clean", "middle")
    for place, name in enumerate(names_of(made)):
        own: list[tuple[SettingScore, Combination]] = of_corruption(list(zip(scores, made, strict=True)), made, name)
        points = [
            f"{left + int(item.settings['severity']) * step:.0f},{bottom - (bottom - top) * score.value / most:.1f}"
            for score, item in own
            if score.value is not None
        ]
        yield f'<polyline points="{" ".join(points)}" fill="none" stroke="{colour_of(place)}" stroke-width="2"/>'


def _text(x: float, y: float, text: str, anchor: str = "start") -> str:
    return f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}">{escaped(text)}</text>'
