"""Unusable configurations and tables give a one-line error that names the place."""

from contextlib import suppress

import polars as pl
import pyarrow.parquet as pq
import pytest

import roadperc_stream as rp
from roadperc_stream.cli import check, compare, find, report, trajectory
from roadperc_stream.config import load_config
from roadperc_stream.config.settings import as_typed, settings_in
from roadperc_stream.errors import ConfigError, TableError
from roadperc_stream.eval.runs import collect, open_run
from tests.commands import run_forked
from tests.eval.tables import outcome
from tests.hostile.inputs import write_log

pytestmark = pytest.mark.commands

TEXTS = {
    "a number of 5000 digits": f"seed = {'9' * 5000}",
    "a hexadecimal number of 5000 digits": f"seed = 0x{'f' * 5000}",
    "50000 nested keys": f"{'a.' * 50_000}a = 1",
    "50000 nested lists": f"seed = {'[' * 50_000}",
    "too long": f"# {'x' * 1_000_000}",
    "not UTF-8": "seed = '\ud800'",
}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_a_configuration_is_read_or_refused_with_one_line(tmp_path, text):
    path, data = tmp_path / "a.toml", text.encode("utf-8", "surrogatepass")
    path.write_bytes(data)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value)) < 1000
    with suppress(ConfigError):  # attached to a log or a table
        assert all(len(as_typed(value)) < 1000 for value in settings_in(data).values())


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables")
    source = write_log(folder / "in.mcap", "plain")
    topics = {role: f"/{role}/plain" for role in ("image", "calibration", "depth", "tf")}
    rp.replay(source, folder / "out.mcap", topics=topics)
    return pl.read_parquet(folder / "out.metrics.parquet")


@pytest.mark.parametrize(
    ("column", "values", "words"),
    [
        ("odom_x_m", pl.lit(1e308), "column odom_x_m holds 1e+308, expected 1e+100 at most"),
        ("odom_x_m", pl.lit("x"), "column odom_x_m is of type String, expected Float64"),
        ("odom_x_m", pl.lit([1.0]), "column odom_x_m is of type"),
        ("stamp_ns", pl.lit(1.5), "column stamp_ns is of type Float64, expected Int64"),
        ("total_ms", pl.lit(None), "total_ms"),
        ("reasons", pl.lit(3), "column reasons is of type Int32"),
        ("log_id", pl.lit(b"\xff"), "column log_id is of type"),
        ("detections", pl.lit(2**64 - 1, pl.UInt64), "column detections holds 1.84467e+19"),
    ],
)
def test_an_unusable_column_is_named(tmp_path, table, column, values, words):
    path = tmp_path / "a.metrics.parquet"
    table.with_columns(values.alias(column)).write_parquet(path)
    with pytest.raises(TableError, match=words.replace("+", r"\+")):
        open_run(path, "a")


def test_a_column_of_nulls_counts_as_missing(tmp_path, table):
    path = tmp_path / "a.metrics.parquet"
    table.with_columns(pl.lit(None).alias("odom_x_m")).write_parquet(path)
    assert run_forked("roadperc-report", path).returncode == 0


def test_a_table_of_another_program_is_read_or_refused(tmp_path, table, capsys):
    plain, nameless, endless = (tmp_path / f"{name}.metrics.parquet" for name in ("plain", "nameless", "endless"))
    pq.write_table(table.to_arrow().replace_schema_metadata(None), plain, store_schema=False)
    table.with_columns(frame=pl.when(pl.col("frame") > 0).then("frame")).write_parquet(nameless)
    table.with_columns(total_ms=pl.lit(float("inf"))).write_parquet(endless)
    for main, *more in (
        (report.main,),
        (check.main,),
        (trajectory.main,),
        (find.main, "frame >= 0"),
        (compare.main, plain),
    ):
        code, _, err = outcome(main, capsys, plain, *more)
        without_truth = main is trajectory.main
        assert (code, "no errors without truth" in err) == (without_truth, without_truth), err
        for path, column in ((nameless, "frame"), (endless, "total_ms")):
            code, out, err = outcome(main, capsys, path, *more)
            assert (out, err.count("\n")) == ("", 1)
            assert f"column {column} has rows without a value" in err


def test_a_panic_in_polars_is_a_table_error():
    def panic(_):
        raise pl.exceptions.PanicException("index out of bounds")

    with pytest.raises(TableError, match=r"a\.parquet: its data cannot be read"):
        collect(pl.LazyFrame({"a": [1]}).map_batches(panic), "a.parquet")
