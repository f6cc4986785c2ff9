"""The columns of the two tables: a row per frame and a row per detection.

The one place that knows a column: its name with the unit in it, its type, meaning, label, rounding and better side.
The Parquet schema, the reports, the comparison of runs and docs/metrics.md are made from these classes; the message
roadperc.FrameMetrics has the same fields.
"""

from roadperc_stream.schemas.columns.column import COUNT, RATIO, UNITLESS, Column, columns_of, row_of
from roadperc_stream.schemas.columns.frame import TIME_COLUMNS, FrameKey, FrameMetrics, InputColumns, ObjectMetrics
