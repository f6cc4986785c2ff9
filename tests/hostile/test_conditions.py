"""Conditions of ``find``, ``--by`` and criteria read the table's columns and nothing else."""

import pytest

from roadperc_stream.cli import check, find, report
from roadperc_stream.eval.expressions import parsed
from tests.eval.tables import outcome, row, write

SECRET = "top-secret"


@pytest.fixture
def table(tmp_path):
    (tmp_path / "secret.csv").write_text(f"x\n{SECRET}\n")
    return write(tmp_path / "a.metrics.parquet", [row(k, lane_left_status="lost") for k in range(3)])


READING = (
    "frame in (select x from read_csv('{file}'))",
    "frame in (with t as (select x from read_csv('{file}')) select x from t)",
    "frame in (select x from \"read_csv\"('{file}'))",
    "read_parquet('{file}') = 1",
    "frame > 1; select x from read_csv('{file}')",
)


@pytest.mark.parametrize("text", READING)
def test_a_condition_reads_only_columns(table, text, capsys):
    text = text.replace("{file}", str(table.with_name("secret.csv")))
    criteria = table.with_name("criteria.toml")
    criteria.write_text(f"[[criterion]]\ncolumn = 'frame'\nstatistic = 'max'\nmost = 9\nfilter = '''{text}'''\n")
    for main, arguments in ((find.main, (table, text)), (report.main, (table, "--by", text.replace(",", " "))),
                            (check.main, (table, "--criteria", criteria))):  # fmt: skip
        code, out, err = outcome(main, capsys, *arguments)
        assert (code, out, err.count("\n")) == (1 if main is not check.main else code, "", 1)
        assert code
        assert SECRET not in err


def test_functions_are_those_of_one_row():
    for text in ("lpad(a, 9999999999, 'x')", "rpad(a, 9999999999, 'x')", "repeat(a, 9999999999)", "replace(a, b, c)"):
        with pytest.raises(ValueError, match="no function"):
            parsed(text)
    for text in (
        "abs(a) > 0.3 and lane <> 'none' or not b is null",
        "coalesce(a, 0) between -1.5 and 2e3",
        "case when a > 1 then round(a, 1) else floor(a / 10) * 10 end = 4",
        "array_contains(missing, 'depth') and 'x' = any(reasons)",
        "lower(lane) like '%left%' or lane in ('it''s', 'select x from y')",
        'cast(a as int) % 2 = 0 and a is distinct from "objects.label"',
    ):
        assert parsed(text).meta.root_names()


@pytest.mark.parametrize("text", ["case when a then " * 50 + "1", "(" * 900, "not " * 200, "a in (" * 150, "-" * 999])
def test_nested_conditions_take_no_time(text):
    with pytest.raises(ValueError, match=r"expected|unable"):
        parsed(text)
