"""The tables of a sweep: which setting is best for which metric, and what each value does."""

from collections.abc import Mapping, Sequence
from typing import Final

from rich.table import Table

from roadperc_stream.cli.terminal import grid
from roadperc_stream.output.tables import Scalar

from ..grid import percent, rounded
from .ranking import Metric, Score, best, effect
from .settings import Combination, shown

LEGEND: Final = (
    "median of absolute values, of shares the mean; frames %: those with a value",
    "best: of the settings that see most; sees less: better, but in fewer frames",
    "time: compares settings, for they share what is decoded; a replay's is longer",
)
Scored = tuple[Metric, Sequence[Score]]
"""A metric, and the score of every combination."""


def best_settings(found: Sequence[Scored], made: Sequence[Combination], reference: Combination) -> Table:
    """A row per metric on which settings differ: score and coverage of the best and the reference, what it changes."""
    headers = ("best", "frames %", "reference", "frames %")
    table = grid("Which setting is best?", *headers, text="setting", label_columns=22)
    for metric, scores in found:
        ranked = best(metric, scores, made, reference)
        if ranked is not None and _differ(metric, scores):
            held_against = _cells(metric, scores[reference.number])
            for label, at in ((metric.quantity.label, ranked.winner), ("  sees less", ranked.sees_less)):
                if at is not None:
                    table.add_row(label, *_cells(metric, scores[at]), *held_against, _changes(made[at], reference))
    return table


def without_effect(found: Sequence[Scored]) -> str:
    """The metrics that are the same under all settings, as a line; those without any value are left out."""
    known = [(metric, scores) for metric, scores in found if any(score.value is not None for score in scores)]
    same = [metric.quantity.name for metric, scores in known if not _differ(metric, scores)]
    return f"no difference: {', '.join(same)}" if same else ""


def effects(found: Sequence[Scored], made: Sequence[Combination], key: str) -> Table:
    """A row per metric on which the setting has an effect: the mean score of the combinations with each value.

    Where the values see differently, a second row has the mean shares of frames, in percent.
    """
    values = dict.fromkeys(item.settings[key] for item in made)
    table = grid(key, *(shown(value) for value in values), label_columns=22)
    for metric, scores in found:
        means = effect(scores, made, key)
        if _differ(metric, list(means.values())):
            table.add_row(metric.quantity.label, *(_cell(metric, score) for score in means.values()))
            _add_coverage(table, means)
    return table


def _add_coverage(table: Table, means: Mapping[Scalar, Score]) -> None:
    shares = [percent(score.coverage) for score in means.values()]
    if len(set(shares)) > 1:
        table.add_row("  frames %", *shares)


def _differ(metric: Metric, scores: Sequence[Score]) -> bool:
    """Whether scores differ by more than their noise, or coverage in the digits that are shown."""
    known = [score.value for score in scores if score.value is not None]
    return len({percent(score.coverage) for score in scores}) > 1 or (bool(known) and not metric.alike(known))


def _cells(metric: Metric, score: Score) -> list[str]:
    return [_cell(metric, score), percent(score.coverage)]


def _cell(metric: Metric, score: Score) -> str:
    return "" if score.value is None else rounded(score.value, metric.quantity)


def _changes(item: Combination, reference: Combination) -> str:
    """What is set otherwise than in the reference."""
    names = _short(list(reference.settings))
    pairs = zip(names, item.settings.values(), reference.settings.values(), strict=True)
    return " ".join(f"{name}={shown(value)}" for name, value, before in pairs if value != before) or "reference"


def _short(keys: Sequence[str]) -> Sequence[str]:
    """Settings without their sections, where they are told apart without."""
    names = [key.rpartition(".")[2] for key in keys]
    return names if len(set(names)) == len(names) else keys
