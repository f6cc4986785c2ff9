"""Logs, batches over them, and their datasets read back."""

from dataclasses import replace

import polars as pl

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


def batch(out, *arguments, **options):
    """Run the command; its result must not be a crash."""
    done = run("roadperc-batch", out, *arguments, **({"timeout": 240} | options))
    assert "Traceback" not in done.stderr + done.stdout, done.stderr + done.stdout
    return done


def runs(out):
    """The list of runs: status by the name of the log."""
    return (
        pl.read_parquet(out / "runs.parquet")
        .with_columns(pl.col("path").str.split("/").list.last().alias("name"))
        .sort("name", "config")
    )


def change_rows(out, **columns):
    path = out / "runs.parquet"
    pl.read_parquet(path).with_columns(**columns).write_parquet(path)


def statuses(out):
    return dict(runs(out).select("name", "status").iter_rows())


def tables(out, kind, log_id):
    """The rows of a log in the dataset, times and what only a dataset has left out."""
    (path,) = (out / kind).glob(f"date=*/{log_id}-*.parquet")
    return pl.read_parquet(path, hive_partitioning=False).drop("config", *TIME_COLUMNS, strict=False)


def single(source, folder, cfg=CFG, **options):
    """The tables of a single replay of a log, and its id."""
    target = folder / f"{source.stem}-single.mcap"
    replay(source, target, cfg, force=True, **options)
    frames = pl.read_parquet(target.with_suffix(".metrics.parquet"))
    objects = pl.read_parquet(target.with_suffix(".objects.parquet"))
    return frames["log_id"][0], frames.drop(TIME_COLUMNS), objects


def assert_as_single(out, source, folder, cfg=CFG):
    """Both tables of a log are those of a replay by itself, cell for cell, but for the times."""
    log_id, frames, objects = single(source, folder, cfg)
    assert tables(out, METRICS, log_id).equals(frames)
    assert tables(out, OBJECTS, log_id).equals(objects)
