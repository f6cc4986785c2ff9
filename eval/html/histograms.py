"""How the errors are distributed: a histogram of each truth metric."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from roadperc_stream.core.geometry import Float

from ..quantities import TRUTH, Quantity
from ..sections import better
from .figures import Figure, Trace, colour_of, layout, line
from .series import Series

MOST_BINS, LEAST_BINS = 40, 8
COLUMNS: Final = tuple(quantity.column for quantity in TRUTH)
"""What these charts need of a table, where it has them."""


def histograms(runs: Sequence[Series]) -> Iterator[Figure]:
    """A histogram of each truth metric that has values, the runs over each other on the same bins."""
    for quantity in TRUTH:
        having = [(place, run) for place, run in enumerate(runs) if quantity.column in run.values]
        if having:
            edges = bin_edges([run.values[quantity.column] for _, run in having])
            traces = [_trace(run, quantity, edges, place) for place, run in having]
            look = layout(quantity.label, "% of values", height=230, showlegend=len(runs) > 1)
            yield Figure(quantity.label, better(quantity), traces, look)


def bin_edges(values: Sequence[Float]) -> Float:
    """Edges over all finite values, in bins of some width even where all are equal.

    Of N values there are 2 sqrt(N) bins: more would show single values, not how they are distributed.
    """
    joined = np.concatenate(values)
    known = joined[np.isfinite(joined)]
    bins = int(np.clip(2 * np.sqrt(len(known)), LEAST_BINS, MOST_BINS))
    span = float(known.max() - known.min()) if known.size else 0.0
    if known.size and 0 <= span < bins * np.spacing(np.abs(known).max()):  # no room for so many between neighbours
        return np.linspace(known.min() - abs(known.min()) / 2, known.max() + abs(known.max()) / 2, bins + 1)
    edges: Float = np.histogram_bin_edges(known, bins)
    return edges


def _trace(run: Series, quantity: Quantity, edges: Float, place: int) -> Trace:
    values = run.values[quantity.column]
    counts, _ = np.histogram(values[np.isfinite(values)], edges)
    percent = 100 * counts / max(counts.sum(), 1)
    # A step line rather than bars: the outlines of several runs stay visible over each other.
    outline = np.concatenate([[0.0], np.repeat(percent, 2), [0.0]])
    return line(run.name, np.repeat(edges, 2), outline, colour_of(place), fill="tozeroy", width=1.2)
