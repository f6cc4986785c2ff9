"""The lines a report begins with: which runs, over how long, and what their inputs lacked."""

from collections.abc import Sequence

from .configurations import UNKNOWN, short_digest
from .grid import percent
from .names import listed
from .quantities import SKEW
from .summary import Summary


def identity(summary: Summary) -> str:
    """Which log, made by which configuration and version."""
    if summary.runs > 1:
        return contents([summary])
    config, version = short_digest(summary.configs[0]), summary.versions[0] or UNKNOWN
    return f"{summary.name}: log {listed(summary.log_ids)}, configuration {config}, version {version}"


def contents(summaries: Sequence[Summary]) -> str:
    """How many runs, of how many logs, configurations and versions."""
    kinds = {
        "log": [name for summary in summaries for name in summary.log_ids],
        "configuration": [name for summary in summaries for name in summary.configs],
        "version": [name for summary in summaries for name in summary.versions],
    }
    numbers = {kind: len(set(names)) for kind, names in kinds.items()}
    counts = ", ".join(f"{number} {kind}{'s' * (number > 1)}" for kind, number in numbers.items())
    return f"{sum(summary.runs for summary in summaries)} runs: {counts}"


def extent(summary: Summary) -> str:
    """How many frames over how long."""
    frames = f"{summary.frames} frame{'s' * (summary.frames > 1)}{in_segments(summary)}"
    if summary.rate_hz is None:
        return frames
    return (
        f"{frames} over {summary.span_s:.2f} s, {summary.rate_hz:.1f} frames/s, "
        f"longest gap {summary.longest_gap_s:.2f} s"
    )


def in_segments(summary: Summary) -> str:
    """How often stamps began anew, where they did."""
    return f" in {summary.segments} segments" if summary.segments > summary.runs else ""


def inputs(summary: Summary) -> str:
    """Whose messages were missing, usable or not, and how far apart the sensors' stamps lie."""
    if summary.incomplete:
        roles = ", ".join(f"{role} {percent(n / summary.frames)} %" for role, n in summary.missing.most_common())
        text = f"something missing in {percent(summary.incomplete / summary.frames)} % of the frames: {roles}"
    else:
        text = "no message missing in any frame"
    skew = summary.statistics.get(SKEW.column)
    return text if skew is None else f"{text}; sync skew median {skew.median:.1f} ms, p95 {skew.p95:.1f} ms"


def precision(summary: Summary) -> str:
    """How exact the quantiles are where not all values were at hand."""
    error = 100 * summary.rank_error
    return (
        f"quantiles over all {summary.frames} frames are within {error:.2f} % in rank, "
        f"those of absolute values within {2 * error:.2f} %"
    )
