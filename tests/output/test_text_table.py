"""Tables wider than the terminal, tables of several subjects, and Markdown."""

import io

import pytest

from roadperc_stream.output.terminal import console_for, print_table
from roadperc_stream.output.text_table import Table, rows_of_subjects, values_of_subjects


def printed(monkeypatch, table, columns=80):
    monkeypatch.setenv("COLUMNS", str(columns))
    stream = io.StringIO()
    print_table(console_for(stream), table)
    return stream.getvalue()


def test_a_table_has_a_rule_rows_and_notes(monkeypatch):
    text = printed(monkeypatch, Table("Stage", ("ms", "share %"), [("lanes", "1.25", "7.0")], ("a note",)))
    assert [line.split() for line in text.splitlines()] == [
        [],
        ["Stage", "ms", "share", "%"],
        ["─" * (26 + 2 + 4 + 2 + 7)],
        ["lanes", "1.25", "7.0"],
        ["a", "note"],
    ]


def test_a_table_without_rows_prints_title_and_notes(monkeypatch):
    assert printed(monkeypatch, Table("Accuracy", ("x",), (), ("no truth",))) == "\nAccuracy: no truth\n"
    assert printed(monkeypatch, Table("Accuracy", ("x",), ())) == ""


@pytest.mark.parametrize(
    ("several", "rows"), [(True, [("step",), ("  b", "3", "4"), ("  a", "1", "2")]), (False, [("step", "3", "4")])]
)
def test_several_subjects_get_a_line_each(several, rows):
    cells = {"b": ("3", "4"), "a": ("1", "2")} if several else {"b": ("3", "4")}
    assert rows_of_subjects({"step": cells}, several) == rows


def test_subjects_are_columns_if_they_fit_else_lines():
    narrow = values_of_subjects("Setting", {"lanes.hold_s": {"base": "1.0", "slow": "2.0"}}, ("base", "slow"))
    assert (narrow.headers, narrow.rows) == (("base", "slow"), [("lanes.hold_s", "1.0", "2.0")])
    names = tuple(f"run_number_{k}" for k in range(9))
    wide = values_of_subjects("Setting", {"seed": {name: str(k) for k, name in enumerate(names)}}, names)
    assert wide.rows[:3] == [("seed",), ("  run_number_0", "0"), ("  run_number_1", "1")]


def test_a_table_of_many_columns_is_wider_than_the_console(monkeypatch):
    headers = tuple(f"header{k:02}" for k in range(20))
    rows = [("the_name_of_the_first", *(f"{k}.125" for k in range(20))), ("b", "0.5")]
    lines = printed(monkeypatch, Table("Run", headers, rows)).splitlines()
    assert lines[1].split() == ["Run", *headers]
    assert lines[3].split()[1:] == [f"{k}.125" for k in range(20)]
    assert lines[4].strip() == "_first"


def test_only_text_in_the_last_column_wraps(monkeypatch):
    table = Table("Role", ("topic",), [("image", "word " * 30)], last_is_text=True, label_columns=18)
    lines = printed(monkeypatch, table).splitlines()
    assert len(lines) == 6
    assert max(map(len, lines)) <= 80
    assert lines[4].startswith(" " * 20 + "word")


def test_markdown_fills_short_rows_and_escapes_signs():
    table = Table("A|B", ("x", "y"), [("<i>`1`", "2")], ("a *note*",))
    assert table.markdown().splitlines() == [
        "| A\\|B | x | y |",
        "| --- | ---: | ---: |",
        "| &lt;i&gt;\\`1\\` | 2 |  |",
        "",
        "a \\*note\\*",
    ]
