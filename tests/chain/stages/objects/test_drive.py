"""Closing speed and objects tracked by template on rendered logs with truth."""

import numpy as np
import polars as pl
import pytest

import roadperc_stream as rp
from roadperc_stream.cli import convert, render
from roadperc_stream.config import STAGES, load_config, switched_off
from roadperc_stream.output.tables import sidecar_path

NOISE = ("--tag-noise", "0.02", "--depth-noise", "0.01", "--rgb-noise", "3")


ERROR_MPS = (pl.col("closing_speed_mps") - pl.col("true_closing_speed_mps")).abs()
NEAR_M = 30.0


def kept_objects(folder, *options):
    """The rows of the kept objects of a rendered scene."""
    dump, log, out = (folder / name for name in ("dump", "log.mcap", "out.mcap"))
    assert render.main([str(dump), "--size", "640x480", "--without", "right", *options]) == 0
    assert convert.main([str(dump), str(log)]) == 0
    rp.replay(log, out, config=load_config(None, [switched_off(stage) for stage in STAGES if stage != "objects"]))
    return pl.read_parquet(sidecar_path(out, "objects")).filter("kept")


def well_visible(rows):
    """Detections of near objects inside the image whose measured distance is correct.

    The nearest visible point of an object cut by the image's border is not its nearest point. In a row of parked cars,
    a box also contains pixels of the next car, and its quantile may be the distance of that car.
    """
    off_m = (pl.col("distance_m") - pl.col("true_distance_m")).abs()
    return rows.filter(
        pl.col("status") == "measured",
        pl.col("true_distance_m") <= NEAR_M,
        pl.min_horizontal("x_min_px", "y_min_px") > 2,
        (pl.col("x_max_px") < 638) & (pl.col("y_max_px") < 478),
        off_m < pl.max_horizontal(0.3, 0.02 * pl.col("true_distance_m")),
    )


@pytest.mark.long
def test_short_closing_speed_of_near_objects(tmp_path):
    rows = kept_objects(tmp_path, "--scene", "straight", "--seconds", "2", "--rate", "10")
    near = well_visible(rows)
    assert near.select(ERROR_MPS).median().item() < 0.25
    assert near["closing_speed_mps"].is_not_null().mean() > 0.85
    tracked = rows.filter(pl.col("status") == "tracked")
    assert tracked.height > 0
    assert tracked["is_true"].mean() > 0.7


@pytest.mark.accuracy
@pytest.mark.parametrize("seed", ["0", "1", "2"])
@pytest.mark.parametrize(
    ("options", "limit_mps"),
    [(("--scene", "straight"), 0.25), (("--scene", "town", *NOISE), 0.35), (("--scene", "town", "--static"), 0.25)],
    ids=["straight", "town, noise", "town, static"],
)
def test_closing_speed_of_near_objects(tmp_path, options, limit_mps, seed):
    near = well_visible(kept_objects(tmp_path, *options, "--seconds", "5", "--seed", seed))
    errors = near.select(ERROR_MPS).to_series()
    print(f"\n{' '.join(options)} --seed {seed}: median {errors.median():.3f} m/s, {1 - np.mean(errors.is_null()):.0%}")
    assert errors.median() < limit_mps
    assert errors.is_not_null().mean() > 0.85
