"""The one table of columns, and all that is made from it."""

import re
from dataclasses import fields
from pathlib import Path
from typing import get_type_hints

import pyarrow as pa
import pytest

from roadperc_stream.eval.metrics_page import with_tables
from roadperc_stream.eval.report_columns import DERIVED, NUMBERS
from roadperc_stream.output.tables import arrow_schema
from roadperc_stream.schemas.columns import EXTRA_COLUMNS, TIME_COLUMNS, FrameMetrics, ObjectMetrics, columns_of
from roadperc_stream.schemas.columns.hindsight import FRAME_HINDSIGHT, TRACK_HINDSIGHT, FrameHindsight
from roadperc_stream.schemas.columns.places import OBJECT_PLACE, TRUE_OBJECTS
from roadperc_stream.schemas.row_messages import FrameMetrics as FrameMetricsProto

PAGE = Path(__file__).parents[2] / "docs" / "metrics.md"
ROWS = pytest.mark.parametrize("row_type", [FrameMetrics, ObjectMetrics])


@ROWS
def test_every_column_has_a_meaning(row_type):
    columns = columns_of(row_type)
    assert list(columns) == [field.name for field in fields(row_type)]
    assert all(column.meaning for column in columns.values())
    for name, column in columns.items():
        ending = name.rsplit("_", 1)[-1]
        known = {"m": "m", "s": "s", "deg": "deg", "px": "px", "ns": "ns", "ms": "ms", "mps": "m/s", "ratio": "ratio"}
        assert column.unit == known.get(ending, column.unit), name


@ROWS
def test_a_nullable_column_says_when_it_is_null(row_type):
    hints, shared = get_type_hints(row_type), ("lane_tusimple", "lane_culane", "filter_", "stereo_", "lane_")
    for name, column in columns_of(row_type).items():
        optional = type(None) in getattr(hints[name], "__args__", ())
        assert optional or not column.null, name
        assert column.null or not optional or name.startswith(shared) or name.startswith("detections"), name


def test_the_message_has_the_columns_in_the_order_of_the_table():
    found = {field.name: field for field in FrameMetricsProto.DESCRIPTOR.fields}
    assert list(found) == ["timestamp", "frame_id", *columns_of(FrameMetrics)]
    assert found["lane_width_m"].has_presence
    assert not found["stamp_ns"].has_presence
    assert found["reasons"].is_repeated
    assert found["reasons"].message_type.full_name == "roadperc.Reason"


def test_the_table_has_every_column_in_its_order():
    schema = arrow_schema(FrameMetrics, EXTRA_COLUMNS)
    assert schema.names == [*columns_of(FrameMetrics), *columns_of(FrameHindsight), *TIME_COLUMNS]
    assert schema.field("missing").type == pa.list_(pa.string())
    assert not schema.field("stamp_ns").nullable
    assert schema.field("lane_width_m").nullable
    assert schema.names[:4] == ["log_id", "frame", "stamp_ns", "surface_inlier_ratio"]


def test_labels_of_reports_are_unique():
    columns = {**columns_of(FrameMetrics), **columns_of(FrameHindsight), **dict.fromkeys(TIME_COLUMNS)}
    stored = [quantity for quantity in NUMBERS if quantity not in DERIVED]
    assert {quantity.column for quantity in stored} <= columns.keys()
    assert {name for name, column in columns.items() if column and column.label} <= {q.column for q in stored}


def test_the_page_defines_every_column():
    page = PAGE.read_text(encoding="utf-8")
    assert page == with_tables(page), "run `make pages`"
    extra = (*FRAME_HINDSIGHT, *TRACK_HINDSIGHT, TRUE_OBJECTS, *OBJECT_PLACE)
    for name in (*columns_of(FrameMetrics), *columns_of(ObjectMetrics), *extra):
        assert re.search(rf"^\| (`\w+`, )*`{name}`[, |]", page, re.MULTILINE), name
