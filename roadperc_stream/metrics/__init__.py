"""One row of numbers per frame and one per detection: pure functions of what the chain made and what is true.

An error is estimate minus truth; a column is None where it could not be measured. docs/metrics.md has the formulas.
"""

from roadperc_stream.metrics.frame import frame_metrics
from roadperc_stream.metrics.lanes import lane_error_m
from roadperc_stream.metrics.objects import object_metrics
from roadperc_stream.metrics.surface import intersection_over_union, surface_height_error_m

__all__ = [
    "frame_metrics",
    "intersection_over_union",
    "lane_error_m",
    "object_metrics",
    "surface_height_error_m",
]
