"""Logs, batches over them, and their datasets."""

from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from subprocess import CompletedProcess

import polars as pl

from roadperc_stream.cli.batch import main
from roadperc_stream.config import load_config
from roadperc_stream.schemas.columns import TIME_COLUMNS
from tests import logs
from tests.commands import run
from tests.replaying import replay

ROAD = replace(logs.SMALL, width=96, height=72)
CFG = load_config(None)
METRICS, OBJECTS = "metrics", "objects"


def write_log(path, frames=4, lane_m=0.0):
    """A small log; another position in the lane makes it another log."""
    path.parent.mkdir(parents=True, exist_ok=True)
    road = replace(ROAD, left_m=ROAD.left_m + lane_m, right_m=ROAD.right_m + lane_m)
    return logs.write(path, logs.items(frames, road=road))


def batch(out, *arguments, env=None):
    """Run the command in this process, or with other variables in its own; it must not crash.

    Workers are forked from one server per process, which has the variables of its start.
    """
    done = run("roadperc-batch", out, *arguments, env=env, timeout=240) if env else called(out, *arguments)
    assert "Traceback" not in done.stderr + done.stdout, done.stderr + done.stdout
    return done


def called(*arguments):
    """The command's exit code and output, called in this process."""
    with redirect_stdout(StringIO()) as stdout, redirect_stderr(StringIO()) as stderr:
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as end:
            code = end.code
    return CompletedProcess(arguments, code, stdout.getvalue(), stderr.getvalue())


def runs(out):
    """The list of runs, sorted by the names of the logs."""
    return (
        pl.read_parquet(out / "runs.parquet")
        .with_columns(pl.col("path").str.split("/").list.last().alias("name"))
        .sort("name", "config")
    )


def statuses(out):
    return dict(runs(out).select("name", "status").iter_rows())


def written(out):
    """The modification times of all metrics tables."""
    return {path: path.stat().st_mtime_ns for path in out.glob("metrics/*/*.parquet")}


def tables(out, kind, log_id):
    """The rows of a log in the dataset, without times and the column of the dataset."""
    (path,) = (out / kind).glob(f"date=*/{log_id}-*.parquet")
    return pl.read_parquet(path, hive_partitioning=False).drop("config", *TIME_COLUMNS, strict=False)


def single(source, folder, cfg=CFG, **options):
    """The id and the tables of a replay of one log."""
    target = folder / f"{source.stem}-single.mcap"
    replay(source, target, cfg, force=True, **options)
    frames = pl.read_parquet(target.with_suffix(".metrics.parquet"))
    objects = pl.read_parquet(target.with_suffix(".objects.parquet"))
    return frames["log_id"][0], frames.drop(TIME_COLUMNS), objects


def assert_as_single(out, source, folder, cfg=CFG):
    """Both tables of a log equal those of a single replay, except for times."""
    log_id, frames, objects = single(source, folder, cfg)
    assert tables(out, METRICS, log_id).equals(frames)
    assert tables(out, OBJECTS, log_id).equals(objects)
