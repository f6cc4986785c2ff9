"""What compare finds by hindsight alone, on runs whose truth is removed."""

import tempfile
from functools import partial
from itertools import combinations, product
from pathlib import Path

import polars as pl

from roadperc_stream.eval.compare.comparison import compare_runs
from roadperc_stream.eval.compare.pairing import logged_runs, pair_runs
from roadperc_stream.eval.options import Rules
from roadperc_stream.eval.report_columns import TRUTH
from tests.hindsight_rates.drives import Drive, tables_of
from tests.hindsight_rates.truth import objects_of

KIND = "tags 5 %, depth 2 %"
SEEDS = 21
PAIRS = 200
MOST_ALARMS = 4
FEWEST_OF_FOUND = 0.9
DRIVES = tuple(Drive(KIND, scene, seed) for scene, seed in product(("bend", "town", "straight"), (821, 822)))
CHANGES = tuple(
    f"{key}={value}"
    for key, values in {
        "lanes.median_px": (1, 15, 25),
        "lanes.hough_threshold": (250, 400),
        "lanes.hough_min_length_px": (20, 200, 300),
        "lanes.hough_max_gap_px": (5, 200),
        "lanes.hough_rho_px": (6, 10),
        "lanes.fit_strip_m": (0.05, 1.0, 2.0),
        "lanes.gate": (3, 10),
        "lanes.hold_s": (0.1,),
        "lanes.use_odometry": ("false",),
        "lanes.process_noise": (5, 20),
        "surface.inlier_m": (0.01, 0.3, 0.6, 1.0),
        "surface.hypotheses": (2, 4),
        "surface.max_depth_m": (10, 15),
        "objects.distance_quantile": (0.3, 0.5),
        "objects.distance_pixels": ("box",),
        "objects.min_overlap": (0.6, 0.8),
        "objects.process_noise": (0.1, 20),
        "objects.gate": (1, 1000),
        "odometry.min_rows": (100, 200),
    }.items()
    for value in values
)
"""Settings that may make results worse."""


def verdict_rates(folder, pool):
    """Regressions found by hindsight of those found with truth; these; alarms; and pairs that differ in the seed."""
    base = _replayed(folder, pool, ())
    changed = [_replayed(folder, pool, (change,)) for change in CHANGES]
    seeded = [base, *(_replayed(folder, pool, (f"seed={seed}",)) for seed in range(1, SEEDS))]
    with_truth = [bool(_worse(base, new)) for new in changed]
    alone = [bool(worse) for worse in pool.map(partial(_without_truth, base), changed)]
    for change, truth, later in zip(CHANGES, with_truth, alone, strict=True):
        print(f"{change}: {'found' if truth else 'nothing'} with truth, {'found' if later else 'nothing'} by hindsight")
    pairs = list(combinations(seeded, 2))[:PAIRS]
    alarms = sum(bool(worse) for worse in pool.map(_without_truth, *zip(*pairs, strict=True)))
    both = sum(truth and later for truth, later in zip(with_truth, alone, strict=True))
    return both, sum(with_truth), alarms, len(pairs)


def _replayed(folder, pool, settings):
    """The folder with the tables of all drives."""
    return list(pool.map(partial(tables_of, folder, settings=settings), DRIVES))


def _worse(base, new):
    return _compared([_read(base), _read(new)])


def _without_truth(base, new):
    """What compare calls worse on copies of the tables without truth."""
    return _compared([_read(base, truth=False), _read(new, truth=False)])


def _read(paths, *, truth=True):
    return [(path.name, *(_table(at, truth) for at in (path, objects_of(path)))) for path in paths]


def _table(path, truth):
    rows = pl.read_parquet(path)
    if truth:
        return rows
    errors = {quantity.column for quantity in TRUTH}
    names = [name for name in rows.columns if "true_" in name or name in errors]
    return rows.with_columns(pl.lit(None, rows.schema[name]).alias(name) for name in names)


def _compared(sides):
    with tempfile.TemporaryDirectory() as place:
        folders = []
        for number, tables in enumerate(sides):
            folder = Path(place) / f"{number}"
            folder.mkdir()
            for name, frames, objects in tables:
                frames.write_parquet(folder / name)
                objects.write_parquet(objects_of(folder / name))
            folders.append(folder)
        pairing = pair_runs(*(logged_runs(str(folder)) for folder in folders), other_log=False)
        return compare_runs(pairing, None, Rules()).regressions
