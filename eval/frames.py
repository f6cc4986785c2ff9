"""Finds the log and the frame that the arguments of ``roadperc-view`` name: a result, a table, or a batch's dataset.

If the result log was not kept, the input is replayed up to the frame.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory

import polars as pl

from roadperc_stream.config.settings import as_typed
from roadperc_stream.errors import LogError, TableError
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.columns import FrameMetrics, columns_of
from roadperc_stream.system.progress import Progress
from roadperc_stream.system.text import nearest

from .dataset.keys import DEFAULT, log_names, settings_by_config
from .dataset.pairs import in_a_folder, run_of_log
from .dataset.place import Dataset, dataset_at, read_runs
from .frame_replay import Recorded, replay_up_to
from .quantities import listed
from .runs import Run, collect, open_run
from .scan import rows_of


@dataclass(frozen=True)
class FrameToShow:
    """A log to show. ``frame`` is the number in the run; in an excerpt that was replayed it has another ``number``."""

    log: Path
    frame: int | None
    number: int | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Wanted:
    """What to show: the arguments of ``roadperc-view``.

    ``runs`` are a log, a table or a dataset, or two of them; ``worst`` is a column.
    """

    runs: Sequence[str]
    frame: int | None
    worst: str | None
    log: str | None
    configs: Sequence[str]
    topics: Sequence[str] = ()


def find_frames(wanted: Wanted, files: ExitStack, progress: Progress) -> list[FrameToShow]:
    """The logs to show, and the frame; temporary files are removed when ``files`` closes.

    Raises:
        RoadpercError: an argument names no run, the run has no such frame, or its log cannot be replayed.
    """
    found = [recorded for argument in wanted.runs for recorded in _recorded(argument, wanted, files)]
    if len(found) > 2:
        raise TableError(f"--config: expected at most two configurations, found {len(found)}")
    frame = wanted.frame if wanted.worst is None else worst_frame(found[-1], wanted.worst)
    return [_shown(recorded, frame, wanted, files, progress) for recorded in found]


def _shown(recorded: Recorded, frame: int | None, wanted: Wanted, files: ExitStack, progress: Progress) -> FrameToShow:
    if recorded.log is not None:
        return FrameToShow(recorded.log, frame, frame)
    if frame is None:
        raise TableError(f"{recorded.name}: its result log was not kept; pass --frame N or --worst COLUMN")
    folder = Path(files.enter_context(TemporaryDirectory(prefix="roadperc-view-")))
    replayed = replay_up_to(recorded, frame, folder, wanted.topics, progress)
    return FrameToShow(replayed.log, frame, replayed.number, replayed.notes)


def _recorded(argument: str, wanted: Wanted, files: ExitStack) -> list[Recorded]:
    """The run of an argument, or two runs of a dataset under two configurations."""
    dataset = dataset_at(argument)
    if dataset is not None:
        if wanted.log is None:
            names = listed(sorted(log_names(_ids(read_runs(dataset)), read_runs(dataset)).values()))
            raise TableError(f"{argument}: is a dataset; pass --log NAME; its logs: {names}")
        here = files.enter_context(in_a_folder(dataset))
        return [_of_dataset(dataset, here, wanted.log, config) for config in wanted.configs or [""]]
    if wanted.log is not None or wanted.configs:
        raise TableError(f"{argument}: is no dataset of a batch; --log and --config need one")
    path = Path(argument)
    table = sidecar_path(path, "metrics") if path.suffix == ".mcap" else path
    if path.suffix == ".mcap" and not table.exists():
        if not path.exists():
            raise LogError(f"{path}: no such file, and no {table.name} beside it")
        return [Recorded(argument, path)]
    run = open_run(table, argument)
    return [_of_run(run, path if path.suffix == ".mcap" else run.beside(".mcap"))]


def _of_run(run: Run, log: Path) -> Recorded:
    return Recorded(run.name, log if log.exists() else None, run, run.source, run.version, config=run.config)


def _ids(runs: pl.DataFrame) -> list[str]:
    return runs["log_id"].drop_nulls().unique(maintain_order=True).to_list()


def _of_dataset(dataset: Dataset, here: Dataset, name: str, config: str) -> Recorded:
    """The run of a log of a dataset.

    Args:
        dataset: as the user named it.
        here: its tables in a local folder.
        name: file name or path of the log, as in the report, or the first digits of its ``log_id``.
        config: name of the configuration, or a setting; empty if the dataset has one configuration.

    Raises:
        TableError: the dataset has no such log, or several.
    """
    runs = read_runs(here).filter(pl.col("log_id").is_not_null())
    names = log_names(_ids(runs), runs)
    paths = {log_id: {PurePath(path).stem for path in known} | set(known) for log_id, known in _paths(runs)}
    matching = [key for key, full in names.items() if full == name] or [
        key for key in names if name in paths[key] or PurePath(name).stem in paths[key] or key.startswith(name)
    ]
    if len(matching) != 1:
        close = nearest(name, names.values())
        hint = f"did you mean {close}?" if close else f"its logs: {listed(sorted(names.values()))}"
        matches = f"matches {len(matching)} logs" if matching else "no such log in the dataset"
        raise TableError(f"{dataset.address}: --log {name}: {matches}; {hint}")
    rows = runs.filter(pl.col("log_id") == matching[0])
    row = rows.filter(pl.col("config") == _config(config, rows, dataset)).row(-1, named=True)
    run = run_of_log(here, matching[0], row["config"], names[matching[0]])
    kept = Path(run.log) if row["logs"] == "whole" and run.log else None
    log = kept if kept is not None and kept.exists() else None
    name = f"{run.name} of {dataset.address}"
    settings = {"config": row["settings"] or "", "options": row["options"] or ""}
    return Recorded(name, log, run, row["path"], row["version"], **settings, recover=bool(row["recover"]))


def _config(name: str, runs: pl.DataFrame, dataset: Dataset) -> str:
    """The configuration that a name, its first digits or a setting means; without a name the only one."""
    configs = settings_by_config(runs, runs["config"].unique(maintain_order=True).to_list())
    texts = {
        config: [f"{key}={as_typed(value)}" for key, value in (settings or {}).items()] or [DEFAULT]
        for config, settings in configs.items()
    }
    matching = [config for config in texts if config.startswith(name)] or [
        config for config, settings in texts.items() if name in settings
    ]
    if len(matching) != 1:
        known = "; ".join(f"{config} ({', '.join(settings)})" for config, settings in texts.items())
        matches = f"matches {len(matching)} configurations" if name else "pass --config NAME"
        raise TableError(f"{dataset.address}: --config {name}: {matches}; the dataset has {known}".replace(" : ", ": "))
    return matching[0]


def _paths(runs: pl.DataFrame) -> list[tuple[str, list[str]]]:
    known = runs.select("log_id", pl.concat_list("path", "names")).rows()
    return [(log_id, [path for path in paths if path]) for log_id, paths in known]


def worst_frame(recorded: Recorded, column: str) -> int:
    """The frame with the largest absolute value of a column, or with the lowest value if high is better.

    Raises:
        TableError: the run has no table, no such column, or no value in it.
    """
    run = recorded.run
    if run is None:
        raise TableError(f"{recorded.name}: --worst {column} needs the metrics table beside the log")
    rows = collect(rows_of(run), run.source_name)
    numbers = [name for name, kind in rows.schema.items() if kind.is_numeric()]
    if column not in numbers:
        close = nearest(column, numbers)
        words = set(column.split("_"))
        near = [name for name in numbers if words & set(name.split("_")) and name != close]
        hint = listed([*([close] if close else []), *near] or numbers, 8)
        raise TableError(f"{run.path}: --worst {column}: no such column of numbers; nearest: {hint}")
    definition = columns_of(FrameMetrics).get(column)
    lowest = definition is not None and definition.better == "high"
    value = pl.col(column).cast(pl.Float64)
    known = rows.filter(value.is_finite())
    if known.is_empty():
        raise TableError(f"{run.path}: --worst {column}: no frame has a value")
    judged = known.select(pl.col("frame").sort_by(value if lowest else -value.abs(), maintain_order=True).first())
    return int(judged.item())
