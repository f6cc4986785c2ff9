"""The columns of the two tables: a row per frame and a row per detection.

These classes define each column: name with unit, type, meaning, label, rounding and better side. The Parquet schema,
the reports, the comparison of runs and docs/metrics.md are generated from them. The message roadperc.FrameMetrics has
the same fields.
"""

from roadperc_stream.schemas.columns.column import COUNT, RATIO, UNITLESS, Column, columns_of, row_of
from roadperc_stream.schemas.columns.frame import (
    EXTRA_COLUMNS,
    TIME_COLUMNS,
    FrameKey,
    FrameMetrics,
    InputColumns,
    ObjectMetrics,
    cells,
)
