"""Errors by hindsight beside those against truth."""

import numpy as np
import polars as pl

from roadperc_stream.system.files import METRICS_SUFFIX, OBJECTS_SUFFIX

_FROM_M = 10.0
_FRAMES = {
    "lane at 10 m": [(f"lane_{side}_hindsight_m", f"lane_{side}_error_m", None) for side in ("left", "right")],
    "step": [("step_hindsight_m", "step_m", "true_step_m")],
}
_OBJECTS = {
    "distance from 10 m": [("object_distance_hindsight_m", "distance_m", "true_distance_m")],
    "closing speed": [("closing_speed_hindsight_mps", "closing_speed_mps", "true_closing_speed_mps")],
    "time to impact": [("time_to_impact_hindsight_s", "time_to_impact_s", "true_time_to_impact_s")],
}


def table(of_kind):
    """A Markdown table with a row for each kind and quantity, from the metrics tables of each kind."""
    head = "| drives | quantity | answered % | correlation | median: hindsight / truth | p95 | beyond 3 std % |"
    lines = [head, "|---|---|---|---|---|---|---|"]
    for kind, paths in of_kind.items():
        frames = pl.concat([pl.read_parquet(path) for path in paths])
        objects = pl.concat([pl.read_parquet(objects_of(path)) for path in paths]).filter("kept")
        for rows, quantities in ((frames, _FRAMES), (objects.filter(pl.col("true_distance_m") >= _FROM_M), _OBJECTS)):
            lines += [f"| {kind} | {name} | {_figures(rows, columns)} |" for name, columns in quantities.items()]
    return "".join(f"{line}\n" for line in lines)


def _figures(rows, columns):
    parts = zip(*(_errors(rows, *names) for names in columns), strict=True)
    later, true, stds = (np.concatenate(part) for part in parts)
    has_truth = np.isfinite(true)
    both = has_truth & np.isfinite(later)
    if np.count_nonzero(both) < 10:
        return "too few | | | |"
    answered, beyond = np.isfinite(later), np.abs(later[both]) > 3 * stds[both]
    later, true = later[both], true[both]
    correlation = np.corrcoef(later, true)[0, 1]
    ends = (f"{np.quantile(abs(later), q):.3f} / {np.quantile(abs(true), q):.3f}" for q in (0.5, 0.95))
    share = 100 * np.count_nonzero(answered & has_truth) / np.count_nonzero(has_truth)
    return f"{share:.0f} | {correlation:.2f} | {' | '.join(ends)} | {100 * beyond.mean():.1f}"


def _errors(rows, later, estimate, truth):
    unit = later.rsplit("_", 1)[1]
    std = f"{later.removesuffix(unit)}std_{unit}"
    error = pl.col(estimate) if truth is None else pl.col(estimate) - pl.col(truth)
    found = rows.select(pl.col(later), error.alias("error"), pl.col(std)).cast(pl.Float64).fill_null(np.nan)
    return [found[name].to_numpy() for name in found.columns]


def objects_of(path):
    """The table of objects beside a metrics table."""
    return path.with_name(path.name.removesuffix(METRICS_SUFFIX) + OBJECTS_SUFFIX)
