"""Replays logs under every combination of some settings, and prints the best setting for each metric."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from roadperc_stream.chain.own_stage import own_stages
from roadperc_stream.config import load_config
from roadperc_stream.output.terminal import console_for, frame_progress
from roadperc_stream.output.text_table import Row, Table
from roadperc_stream.system.files import METRICS_SUFFIX
from roadperc_stream.system.text import print_line
from roadperc_stream.system.time import WHOLE, TimeRange

from ..replaying import require_log
from ..report_columns import percent, rounded
from ..results import Case, ResultFiles, Results
from . import robustness
from .combinations import Combination, combinations, dataset, degradations, describe, reference_of, shown, table_names
from .jobs import Job, run_jobs
from .ranking import METRICS, Scored, SettingScore, SweepMetric, best, effect, scores, without_influence

LEGEND: Final = (
    "scores: median of absolute values, for shares the mean; frames %: those with a value",
    "best: among the settings with the highest coverage; lower coverage: better, but in fewer frames",
)
UNTIMED: Final = "times are not compared, because several replays run at a time; pass --jobs 1"
CURVES: Final = "curves.svg"


@dataclass(frozen=True)
class SweepOptions:
    """What to replay: the values of each setting ``varied``, or the severities of each corruption ``degraded``.

    ``config`` is a file of settings and ``changed`` more of them as KEY=VALUE; ``topics`` are by role. ``baseline`` is
    the folder of an earlier sweep with the same corruptions. ``jobs`` replays run at a time, and ``out`` is the result.
    """

    out: Path
    varied: Mapping[str, Sequence[str]] = field(default_factory=dict)
    degraded: Mapping[str, Sequence[int]] = field(default_factory=dict)
    config: Path | None = None
    changed: Sequence[str] = ()
    topics: Mapping[str, str] = field(default_factory=dict)
    time_range: TimeRange = WHOLE
    seed: int = 0
    baseline: Path | None = None
    jobs: int = 1
    force: bool = False


def sweep(logs: Sequence[Path], options: SweepOptions, files: ResultFiles) -> None:
    """Replay logs under every combination of settings, or with corruptions, and print the scores.

    Raises:
        RoadpercError: a log cannot be replayed, a setting is invalid, or the dataset cannot be written.
    """
    cfg = own_stages(load_config(options.config, options.changed))[0]
    varied = combinations(options.config, options.changed, options.varied)
    made = degradations(cfg, options.degraded) if options.degraded else varied
    for path in logs:  # fail before any log is replayed
        require_log(path)
    facts: dict[str, Any] = {"logs": [str(path.absolute()) for path in logs]}
    if options.degraded:
        facts |= {"degrade": {name: list(several) for name, several in options.degraded.items()}, "seed": options.seed}
    if options.baseline is not None:
        robustness.require_baseline(options.baseline, facts)
    with dataset(options.out, options.force) as folder:
        jobs = list(_jobs(logs, options, made, folder))
        with frame_progress(f"{len(made)} combinations", enabled=True) as bar:
            notes = run_jobs(jobs, options.jobs, bar)
        describe(folder, made, facts)
    found = (f"note: {job.source.name}: {note}" for job, texts in zip(jobs, notes, strict=True) for note in texts)
    for line in dict.fromkeys(found):
        print_line(line)
    _print(options, files, made, reference_of(made, cfg))


def _jobs(logs: Sequence[Path], options: SweepOptions, made: Sequence[Combination], folder: Path) -> Iterator[Job]:
    """A job per log and combination; each corruption replays another log."""
    for path, name in zip(logs, table_names(logs), strict=True):
        for item in made:
            job = Job(path, folder / item.folder / name, item, options.topics, options.time_range)
            if options.degraded and item.number:
                from roadperc_stream.tools.degrade import degrade_log  # noqa: PLC0415 - only corruptions need it

                chosen = {str(item.settings["corruption"]): int(item.settings["severity"])}
                degrade = partial(degrade_log, severities=chosen, seed=options.seed, overrides=options.topics)
                job = replace(job, degrade=degrade)
            yield job


def _print(options: SweepOptions, files: ResultFiles, made: Sequence[Combination], reference: Combination) -> None:
    """Print the best settings or the effect of corruptions, and write them to the files for other programs."""
    folder = options.out
    tables_found = sorted(folder.rglob(f"*{METRICS_SUFFIX}"))
    is_timed = options.jobs == 1 and not options.degraded
    judged = [metric for metric in METRICS if is_timed or not metric.noise]
    found = [(metric, scores(tables_found, made, metric)) for metric in judged]
    heading = f"{len(tables_found)} tables in {folder}: {len(made)} settings, reference {reference}"
    values = {key: dict.fromkeys(shown(item.settings[key]) for item in made) for key in reference.settings}
    taken = (f"  {key} {', '.join(texts)}" for key, texts in values.items())
    as_json = _as_json(found, made, reference)
    if options.degraded:
        rated = robustness.robustness_of_all(found, made, options.baseline)
        tables = (*_by_severity(found, made), *robustness.rate_tables(rated, options.baseline))
        as_json["robustness"] = {name: {"rr": rates, "ce": errors} for name, (rates, errors) in rated.items()}
        drawn = robustness.curves([scored for scored in found if _differ(*scored)], made)
        (folder / CURVES).write_text(drawn, encoding="utf-8")
        notes = [f"curves: {folder / CURVES}", without_effect(found), LEGEND[0]]
    else:
        tables = (best_settings(found, made, reference), *(effects(found, made, key) for key in reference.settings))
        idle = [f"{key} changed nothing" for key in without_influence(folder, tables_found, made)]
        notes = [*idle, without_effect(found), *LEGEND, *([] if is_timed else [UNTIMED])]
    cases, tail = [_case(scored, made, reference) for scored in found], list(filter(None, notes))
    results = Results("sweep", f"Sweep: {folder}", (heading, *taken), (*tables, "", *tail), (), as_json, cases)
    results.write(files)
    results.print(console_for(sys.stdout))


def best_settings(found: Sequence[Scored], made: Sequence[Combination], reference: Combination) -> Table:
    """A row per metric on which settings differ: scores and coverage of the best and the reference, and the changes."""
    headers = ("best", "frames %", "reference", "frames %", "setting")
    rows = (line for scored in found if _differ(*scored) for line in _best_rows(scored, made, reference))
    return Table("Best setting", headers, tuple(rows), last_is_text=True, label_columns=22)


def _best_rows(scored: Scored, made: Sequence[Combination], reference: Combination) -> Iterator[Row]:
    metric, scores = scored
    places = best(metric, scores, made, reference) or ()
    for label, at in zip((metric.quantity.label, "  lower coverage"), places, strict=False):
        if at is not None:
            pair = scores[at], scores[reference.number]
            cells = (text for score in pair for text in (_cell(metric, score), percent(score.coverage)))
            yield (label, *cells, _changes(made[at], reference))


def _changes(item: Combination, reference: Combination) -> str:
    """The settings that differ from the reference; without their sections if that is unambiguous."""
    keys = list(reference.settings)
    short = [key.rpartition(".")[2] for key in keys]
    names = short if len(set(short)) == len(keys) else keys
    pairs = zip(names, item.settings.values(), reference.settings.values(), strict=True)
    return " ".join(f"{name}={shown(value)}" for name, value, before in pairs if value != before) or "reference"


def without_effect(found: Sequence[Scored]) -> str:
    """A line with the metrics that are equal under all settings; metrics without values are left out."""
    known = [(metric, scores) for metric, scores in found if any(score.value is not None for score in scores)]
    same = [metric.quantity.name for metric, scores in known if not _differ(metric, scores)]
    return f"no difference: {', '.join(same)}" if same else ""


def effects(found: Sequence[Scored], made: Sequence[Combination], key: str) -> Table:
    """A row per metric on which the setting has an effect: the mean score of the combinations with each value.

    If coverage differs between the values, a second row has the mean shares of frames, in percent.
    """
    values = dict.fromkeys(item.settings[key] for item in made)
    rows: list[Row] = []
    for metric, scored in found:
        means = list(effect(scored, made, key).values())
        shares = [percent(score.coverage) for score in means]
        if _differ(metric, means):
            rows.append((metric.quantity.label, *(_cell(metric, score) for score in means)))
            rows += [("  frames %", *shares)] if len(set(shares)) > 1 else []
    return Table(key, tuple(shown(value) for value in values), tuple(rows), label_columns=22)


def _by_severity(found: Sequence[Scored], made: Sequence[Combination]) -> Iterator[Table]:
    """A table per corruption: the scores by severity, 0 is the clean log."""
    for name in robustness.names_of(made):
        own = [(metric, robustness.of_corruption(several, made, name)) for metric, several in found]
        yield replace(effects(own, robustness.of_corruption(made, made, name), "severity"), title=f"{name}, severity")


def _differ(metric: SweepMetric, scores: Sequence[SettingScore]) -> bool:
    """Whether scores differ by more than their noise, or coverage differs in the printed digits."""
    known = [score.value for score in scores if score.value is not None]
    return len({percent(score.coverage) for score in scores}) > 1 or (bool(known) and not metric.alike(known))


def _cell(metric: SweepMetric, score: SettingScore) -> str:
    return "" if score.value is None else rounded(score.value, metric.quantity)


def _as_json(found: Sequence[Scored], made: Sequence[Combination], reference: Combination) -> dict[str, Any]:
    """The combinations by their folders, and the scores of each metric with a value."""
    metrics = {}
    for metric, scored in found:
        if places := best(metric, scored, made, reference):
            by_folder = {item.folder: vars(score) for item, score in zip(made, scored, strict=True)}
            best_folder = made[places[0]].folder
            metrics[metric.quantity.name] = {"unit": metric.quantity.unit, "best": best_folder, "scores": by_folder}
    settings = {item.folder: item.settings for item in made}
    return {"reference": reference.folder, "settings": settings, "metrics": metrics}


def _case(scored: Scored, made: Sequence[Combination], reference: Combination) -> Case:
    """A metric with the scores of all combinations; skipped without values."""
    metric, scores = scored
    if not best(metric, scores, made, reference):
        return Case("sweep", metric.quantity.name, "skipped", "no frame has a value")
    pairs = zip(made, scores, strict=True)
    lines = (f"{item}: {_cell(metric, score)} {metric.quantity.unit}" for item, score in pairs)
    return Case("sweep", metric.quantity.name, "passed", "\n".join(lines))
