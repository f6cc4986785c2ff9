"""A rendered scene with one camera, tags, detections and a lidar, from the dump's PLY files to the tables."""

import numpy as np
import polars as pl
import pytest

from roadperc_stream.cli import convert, render, report
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.output.tables import sidecar_path

OPTIONS = ("--size", "640x480", "--scene", "straight", "--seconds", "0.3", "--lidar")


@pytest.mark.long
def test_the_points_give_road_lane_distances_and_scale(tmp_path, capsys):
    without = ("--without", "depth", "--without", "right")
    assert render.main([str(tmp_path / "dump"), *OPTIONS, *without]) == 0
    assert convert.main([str(tmp_path / "dump"), str(tmp_path / "in.mcap"), "--quiet"]) == 0
    assert replay_main([str(tmp_path / "in.mcap"), str(tmp_path / "out.mcap"), "--quiet"]) == 0
    table = pl.read_parquet(sidecar_path(tmp_path / "out.mcap", "metrics"))
    assert set(table["surface_source"]) == {"lidar"}
    assert table["surface_angle_error_deg"].max() < 0.1
    assert table["camera_height_error_m"].abs().max() < 0.01
    for side in ("left", "right"):
        assert set(table[f"lane_{side}_status"]) == {"measured"}
        assert table[f"lane_{side}_error_m"].abs().max() < 0.05
    assert table["odometry_status"].to_list() == ["first", *["tracked"] * (table.height - 1)]
    assert table["missing"].to_list() == [[]] * table.height
    assert set(table["reason_codes"].explode()) == {"stereo.no_right_image"}
    table = pl.read_parquet(sidecar_path(tmp_path / "out.mcap", "objects"))
    known = table.filter(pl.col("kept") & (pl.col("true_distance_m") < 15)).drop_nulls("distance_m")
    error_m = (known["distance_m"] - known["true_distance_m"]).abs()
    assert len(error_m) >= 10
    assert np.median(error_m) < 0.2
    assert report.main([str(sidecar_path(tmp_path / "out.mcap", "metrics")), "--full"]) == 0
    assert "surface_source: lidar" in capsys.readouterr().out
