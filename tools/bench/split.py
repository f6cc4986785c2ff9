"""What a log replayed in parts has otherwise than in one pass: which columns, by how much, how far behind a cut.

Run it with ``make bench-split`` or ``python -m roadperc_stream.tools.bench.split FOLDER``. The logs are drives through
town with a change of lane, by depth, by a stereo pair, and by one camera alone. What FOLDER holds is not made again.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl

from roadperc_stream.batch.joining import POSE
from roadperc_stream.cli.plumbing import positive_seconds, run, seconds, whole_number
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.geometry import Float, inverse
from roadperc_stream.core.rotations import rotation_from_quaternion
from roadperc_stream.core.time import NS_PER_S
from roadperc_stream.output.text_table import TextTable, row

from .printing import print_tables, write_page
from .split_replays import LEFT_OUT, SplitRun, make_logs, replay_all, runs_of

_LEAST: Final = 0.001
"""Metres, degrees or seconds by which a value must differ to count."""
_GROUPS: Final = {
    "camera pitch, deg": ("camera_pitch_deg",),
    "offset of a boundary, m": ("lane_left_offset_m", "lane_right_offset_m"),
    "heading of the lane, deg": ("lane_heading_deg",),
    "step, m": ("step_m",),
    "turn, deg": ("turn_deg",),
    "nearest object, m": ("nearest_object_m",),
    "time to impact, s": ("time_to_impact_s",),
    "objects kept, carried, in the path, cutting in": (
        "detections_kept",
        "objects_carried",
        "objects_in_path",
        "cut_ins",
    ),
}
"""What is compared of the frames, by the names of the tables."""
_TRUE_POSE: Final = tuple(name.replace("odom", "true") for name in POSE)


@dataclass(frozen=True)
class Differing:
    """Where a group of columns differs: share of its values, of those the median and the largest, and the latest one.

    ``latest_s`` is seconds behind the cut before it.
    """

    share: float
    median: float = 0.0
    largest: float = 0.0
    latest_s: float = 0.0

    def __str__(self) -> str:
        if not self.share:
            return "-"
        return f"{self.share:.1%}: {self.median:.2g}, {self.largest:.2g}; {self.latest_s:.1f} s"


def main(argv: list[str] | None = None) -> int:
    """Replay what is missing, compare and print."""
    parser = argparse.ArgumentParser(prog="python -m roadperc_stream.tools.bench.split", description=__doc__)
    add = parser.add_argument
    add("folder", metavar="FOLDER", type=Path, help="gets logs and tables, and keeps them")
    add("--seeds", type=int, nargs="+", default=[1, 2], metavar="N", help="of the drives (1 2)")
    add("--splits", type=positive_seconds, nargs="+", default=[10.0, 20.0], metavar="S", help="lengths (10 20)")
    add("--warm-ups", type=seconds, nargs="+", default=[0.0, 1.0, 2.0, 5.0, 10.0], metavar="S", help="(0 1 2 5 10)")
    add("--seconds", type=positive_seconds, default=60.0, metavar="S", help="of a drive (60)")
    add("--width", type=whole_number, default=480, metavar="PX", help="of the images, 4:3 (480)")
    add("--page", type=Path, metavar="FILE", help="write the tables into their place in a page, too")
    arguments = parser.parse_args(argv)
    return run(lambda: _bench(arguments))


def _bench(arguments: argparse.Namespace) -> None:
    folder: Path = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    for seed in arguments.seeds:
        make_logs(folder, seed, arguments.seconds, arguments.width)
    runs = runs_of(arguments.seeds, arguments.splits, arguments.warm_ups)
    replay_all(folder, runs)
    found = [difference_table(folder, runs), path_table(folder, runs)]
    print_tables(found)
    if arguments.page:
        write_page(arguments.page, found)


def difference_table(folder: Path, runs: Sequence[SplitRun]) -> TextTable:
    """A row for each group of columns, a column for each warm-up; all seeds and lengths of parts together."""
    warm_ups = sorted({run.warm_up_s for run in runs})
    rows = []
    for sensors in LEFT_OUT:
        ours = {w: [run for run in runs if (run.sensors, run.warm_up_s) == (sensors, w)] for w in warm_ups}
        for name, columns in _GROUPS.items():
            cells = [str(differing(folder, ours[w], columns)) for w in warm_ups]
            rows += [row(f"{sensors}: {name}", *cells)] if any(cell != "-" for cell in cells) else []
        rows.append(row(f"{sensors}: tracks that begin anew", *(_torn(folder, ours[w]) for w in warm_ups)))
    note = (
        f"Share of the values behind the first cut that differ by more than {_LEAST}, of those the median and the "
        "largest difference, and how far behind its cut the latest one lies."
    )
    return TextTable("warm-up", tuple(f"{w:g} s" for w in warm_ups), tuple(rows), (note,), label_columns=40)


def path_table(folder: Path, runs: Sequence[SplitRun]) -> TextTable:
    """A row a run: how far the joined path's end is from one pass's, and how far both are from the truth."""
    rows = []
    for item in runs:
        whole, joined = (pl.read_parquet(run.table(folder, "metrics")) for run in (item.one_pass, item))
        true = _poses(whole, _TRUE_POSE)
        ends_m = float(np.linalg.norm((_poses(whole, POSE) - _poses(joined, POSE))[-1, :3, 3]))
        errors_m = (path_error_m(_poses(table, POSE), true) for table in (whole, joined))
        label = f"{item.sensors}, seed {item.seed}, {item.split_s:g} s, warm-up {item.warm_up_s:g} s"
        rows.append(row(label, f"{ends_m:.2f}", *(f"{error_m:.2f}" for error_m in errors_m)))
    note = "Errors are the root mean square distance from the true path, both begun at the first frame."
    headers = ("ends apart m", "one pass: error m", "joined: error m")
    return TextTable("path", headers, tuple(rows), (note,), label_columns=40)


def differing(folder: Path, runs: Sequence[SplitRun], columns: Sequence[str]) -> Differing:
    """Where some columns of runs differ from one pass, behind the first cut."""
    amounts, behind_s = list[float](), list[float]()
    for item in runs:
        whole, joined = (pl.read_parquet(run.table(folder, "metrics")) for run in (item.one_pass, item))
        times_s = seconds_behind(whole["stamp_ns"].to_numpy(), item)
        for name in columns:
            amounts += difference(whole[name], joined[name])[times_s >= 0].tolist()
            behind_s += times_s[times_s >= 0].tolist()
    found = np.array(amounts) > _LEAST
    if not found.any():
        return Differing(0.0)
    there = np.array(amounts)[found]
    known = there[np.isfinite(there)] if np.isfinite(there).any() else np.zeros(1)
    latest_s = float(np.array(behind_s)[found].max())
    return Differing(float(found.mean()), float(np.median(known)), float(known.max()), latest_s)


def difference(ours: pl.Series, theirs: pl.Series) -> Float:
    """(N,) absolute differences of two columns, infinite where only one has a value, 0 where none has."""
    apart = (ours.cast(pl.Float64) - theirs.cast(pl.Float64)).abs()
    one_alone = ours.is_null() != theirs.is_null()
    return np.where(one_alone.to_numpy(), np.inf, apart.fill_null(0.0).to_numpy())


def seconds_behind(stamps_ns: Float, item: SplitRun) -> Float:
    """(N,) seconds since the last frame that was taken from the part before; negative in the first part."""
    times_s = (stamps_ns - stamps_ns[0]) / NS_PER_S
    split_s = item.split_s or np.inf
    parts = max(int(times_s[-1] / split_s + 0.5), 1)
    since_s = times_s + ReplayConfig().sync.max_wait_s  # the seam is in the middle of what parts have in common
    part = np.minimum(np.floor(since_s / split_s), parts - 1)
    return np.where(part > 0, since_s - part * split_s, -1.0)


def _torn(folder: Path, runs: Sequence[SplitRun]) -> str:
    """How many tracks of one pass have several names in the joined table, or share one, of how many."""
    torn = total = 0
    for item in runs:
        whole, joined = (pl.read_parquet(run.table(folder, "objects")) for run in (item.one_pass, item))
        keys = ["frame", "label", "x_min_px", "y_min_px", "x_max_px", "y_max_px"]
        both = (
            whole.unique(keys).join(joined.unique(keys), on=keys, how="inner", suffix="_joined").drop_nulls("track_id")
        )
        names = both.group_by("track_id").agg(pl.col("track_id_joined").n_unique())
        torn, total = torn + int((names["track_id_joined"] > 1).sum()), total + len(names)
    return f"{torn} of {total}"


def _poses(table: pl.DataFrame, columns: Sequence[str]) -> Float:
    """(N, 4, 4) poses of a table."""
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    rows = table.select(columns).to_numpy()
    poses[:, :3, 3] = rows[:, :3]
    poses[:, :3, :3] = [rotation_from_quaternion(*row) for row in rows[:, 3:]]
    return poses


def path_error_m(estimated: Float, true: Float) -> float:
    """Root mean square distance of (N, 4, 4) poses from the true ones, both counted from their first."""
    places = (inverse(poses[0]) @ poses for poses in (estimated, true))
    ours, theirs = (poses[:, :3, 3] for poses in places)
    return float(np.sqrt(np.mean(np.sum((ours - theirs) ** 2, axis=1))))


if __name__ == "__main__":
    sys.exit(main())
