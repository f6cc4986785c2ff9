"""One row of numbers per frame and one per detection: pure functions of what the chain made and what is true.

An error is estimate minus truth; a column is None where it could not be measured. docs/metrics.md has the formulas.
"""

from roadperc_stream.metrics.frame import frame_metrics
from roadperc_stream.metrics.objects import object_metrics

__all__ = ["frame_metrics", "object_metrics"]
