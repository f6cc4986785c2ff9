"""A metric of your own: how far the lane's centre lies from the true one, over a run."""

import polars as pl

import roadperc_stream as rp

rp.replay("logs/sample.mcap", "metric.mcap", force=True)
centre_m = (pl.col("lane_left_offset_m") + pl.col("lane_right_offset_m")) / 2
true_m = (pl.col("lane_left_true_offset_m") + pl.col("lane_right_true_offset_m")) / 2
error_m = rp.read_metrics("metric.mcap").select(error_m=centre_m - true_m)["error_m"]
coverage = error_m.is_not_null().mean()
print(f"centre of the lane: median {error_m.abs().median():.3f} m, worst {error_m.abs().max():.3f} m")
print(f"coverage {coverage:.0%}")
