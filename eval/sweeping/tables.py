"""The tables of a sweep: which setting is best for which metric, and what each value does."""

from collections.abc import Iterator, Sequence
from typing import Final

from roadperc_stream.output.text_table import TextRow, TextTable, row

from ..grid import percent, rounded
from .ranking import SettingScore, SweepMetric, best, effect
from .settings import Combination, shown

LEGEND: Final = (
    "median of absolute values, of shares the mean; frames %: those with a value",
    "best: of the settings with the highest coverage; lower coverage: better, but in fewer frames",
    "time: compares settings, for they share what is decoded; a replay's is longer",
)
Scored = tuple[SweepMetric, Sequence[SettingScore]]
"""A metric, and the score of every combination."""


def values_taken(made: Sequence[Combination]) -> Iterator[str]:
    """A line on each varied setting with its values."""
    for key in made[0].settings:
        yield f"  {key} {', '.join(dict.fromkeys(shown(item.settings[key]) for item in made))}"


def best_settings(found: Sequence[Scored], made: Sequence[Combination], reference: Combination) -> TextTable:
    """A row per metric on which settings differ: score and coverage of the best and the reference, what it changes."""
    headers = ("best", "frames %", "reference", "frames %", "setting")
    rows = (line for scored in found if _differ(*scored) for line in _best_rows(scored, made, reference))
    return TextTable("Best setting", headers, tuple(rows), last_is_text=True, label_columns=22)


def _best_rows(scored: Scored, made: Sequence[Combination], reference: Combination) -> Iterator[TextRow]:
    metric, scores = scored
    ranked = best(metric, scores, made, reference)
    places = (
        () if ranked is None else ((metric.quantity.label, ranked.winner), ("  lower coverage", ranked.less_covered))
    )
    compared_with = _cells(metric, scores[reference.number])
    for label, at in places:
        if at is not None:
            yield row(label, *_cells(metric, scores[at]), *compared_with, _changes(made[at], reference))


def without_effect(found: Sequence[Scored]) -> str:
    """The metrics that are the same under all settings, as a line; those without any value are left out."""
    known = [(metric, scores) for metric, scores in found if any(score.value is not None for score in scores)]
    same = [metric.quantity.name for metric, scores in known if not _differ(metric, scores)]
    return f"no difference: {', '.join(same)}" if same else ""


def effects(found: Sequence[Scored], made: Sequence[Combination], key: str) -> TextTable:
    """A row per metric on which the setting has an effect: the mean score of the combinations with each value.

    Where coverage differs between the values, a second row has the mean shares of frames, in percent.
    """
    values = dict.fromkeys(item.settings[key] for item in made)
    rows = (line for scored in found for line in _effect_rows(scored, made, key))
    return TextTable(key, tuple(shown(value) for value in values), tuple(rows), label_columns=22)


def _effect_rows(scored: Scored, made: Sequence[Combination], key: str) -> Iterator[TextRow]:
    metric, scores = scored
    means = list(effect(scores, made, key).values())
    if not _differ(metric, means):
        return
    yield row(metric.quantity.label, *(_cell(metric, score) for score in means))
    shares = [percent(score.coverage) for score in means]
    if len(set(shares)) > 1:
        yield row("  frames %", *shares)


def _differ(metric: SweepMetric, scores: Sequence[SettingScore]) -> bool:
    """Whether scores differ by more than their noise, or coverage in the digits that are shown."""
    known = [score.value for score in scores if score.value is not None]
    return len({percent(score.coverage) for score in scores}) > 1 or (bool(known) and not metric.alike(known))


def _cells(metric: SweepMetric, score: SettingScore) -> list[str]:
    return [_cell(metric, score), percent(score.coverage)]


def _cell(metric: SweepMetric, score: SettingScore) -> str:
    return "" if score.value is None else rounded(score.value, metric.quantity)


def _changes(item: Combination, reference: Combination) -> str:
    """What is set otherwise than in the reference."""
    names = _short(list(reference.settings))
    pairs = zip(names, item.settings.values(), reference.settings.values(), strict=True)
    return " ".join(f"{name}={shown(value)}" for name, value, before in pairs if value != before) or "reference"


def _short(keys: Sequence[str]) -> Sequence[str]:
    """Settings without their sections, where they are unambiguous without."""
    names = [key.rpartition(".")[2] for key in keys]
    return names if len(set(names)) == len(names) else keys
