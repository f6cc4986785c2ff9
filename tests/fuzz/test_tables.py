"""Tables of a replay with wrong columns, values and facts."""

import io
import math

import polars as pl
from hypothesis import given
from hypothesis import strategies as st

from tests.fuzz import bases
from tests.fuzz.running import examples, folder_of, require_clear_end
from tests.fuzz.values import floats, integers, texts

TABLE, BASE = "a.metrics.parquet", "out.metrics.parquet"
COMMANDS = st.sampled_from((
    f"report {TABLE} --worst 2 --full", f"report {TABLE} {BASE} --html page.html", f"compare {BASE} {TABLE}",
    f"compare {TABLE} {BASE} --exact", f"compare {TABLE} {BASE} --other-log", f"trajectory {TABLE} --align sim3",
    f"trajectory {TABLE} --align none --export-tum tum", f"check {TABLE}", f"check {TABLE} --init limits.toml",
    f"find {TABLE} frame>0", f"view {TABLE} --foxglove-layout view.json",
))  # fmt: skip
CELLS = (
    floats.map(lambda value: pl.lit(value, pl.Float64))
    | integers(64, signed=True).map(lambda value: pl.lit(value, pl.Int64))
    | texts.map(pl.lit)
    | st.sampled_from((
        pl.lit(None), pl.lit(b"\xff"), pl.lit(2**64 - 1, pl.UInt64), pl.lit([math.nan]), pl.lit(["a"]), pl.lit(True),
        pl.struct(a=pl.lit(1)), pl.lit(1).cast(pl.Duration("ns")), pl.lit(1).cast(pl.Date), pl.lit(1.5, pl.Float32),
    ))
)  # fmt: skip


@st.composite
def changed_table(draw):
    """A table with one to three faults."""
    data = io.BytesIO(bases.results()[BASE])
    table, facts = pl.read_parquet(data), pl.read_parquet_metadata(data)
    facts = {key: value for key, value in facts.items() if not key.startswith("ARROW")}
    for _ in range(draw(st.integers(1, 3))):
        column = draw(st.sampled_from(table.columns))
        how = draw(st.sampled_from(("column", "column", "cell", "cell", "remove", "rename", "rows", "fact")))
        if how == "column":
            table = table.with_columns(draw(CELLS).alias(column))
        elif how == "cell":
            cell = pl.lit(draw(floats | integers(63) | texts | st.none())).cast(table.schema[column], strict=False)
            table = table.with_columns(pl.when(pl.int_range(pl.len()) == 1).then(cell).otherwise(column).alias(column))
        elif how == "rename":
            table = table.rename({column: draw(texts) or column}, strict=False)
        elif how == "rows":
            table = draw(st.sampled_from((table.clear(), table.reverse(), pl.concat([table] * 300))))
        elif how == "remove":
            table = table.drop(column)
        else:
            facts[draw(st.sampled_from(sorted(facts)))] = draw(texts)
    stream = io.BytesIO()
    table.write_parquet(stream, metadata=facts)
    return stream.getvalue()


@examples
@given(st.data(), COMMANDS)
def test_columns_of_a_table(data, command):
    try:
        table = data.draw(changed_table())
    except (pl.exceptions.PolarsError, OverflowError, TypeError):  # no such cast
        return
    with folder_of(bases.results() | {TABLE: table}) as folder:
        require_clear_end(folder, *command.split())
