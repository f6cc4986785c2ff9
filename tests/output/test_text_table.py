"""Tables with several subjects and tables wider than the terminal."""

import io

from roadperc_stream.output.terminal import console_for, print_table
from roadperc_stream.output.text_table import TextRow, TextTable, by_header, row


def printed(monkeypatch, table, columns=80):
    monkeypatch.setenv("COLUMNS", str(columns))
    stream = io.StringIO()
    print_table(console_for(stream), table)
    return stream.getvalue()


def test_a_table_has_a_rule_rows_and_notes(monkeypatch):
    text = printed(monkeypatch, TextTable("Stage", ("ms", "share %"), (row("lanes", "1.25", "7.0"),), ("a note",)))
    assert [line.split() for line in text.splitlines()] == [
        [],
        ["Stage", "ms", "share", "%"],
        ["─" * (26 + 2 + 4 + 2 + 7)],
        ["lanes", "1.25", "7.0"],
        ["a", "note"],
    ]


def test_a_table_without_rows_prints_title_and_notes(monkeypatch):
    assert printed(monkeypatch, TextTable("Accuracy", ("x",), (), ("no truth",))) == "\nAccuracy: no truth\n"
    assert printed(monkeypatch, TextTable("Accuracy", ("x",), ())) == ""


SEVERAL = TextTable(
    "Error", ("median", "worst"), (TextRow("step", (("1", "2"), (), ("3", "4"))),), subjects=("a", "b", "c")
)


def test_subjects_with_values_get_a_line_each():
    assert [(item.label, item.cells[0]) for item in SEVERAL.flat().rows] == [
        ("step", ()),
        ("  a", ("1", "2")),
        ("  c", ("3", "4")),
    ]


def test_only_listed_subjects_get_a_line():
    cells = (("1",), ("2",), ("3",))
    table = TextTable("E", ("x",), (TextRow("step", cells, listed=(2, 0)),), subjects=("a", "b", "c"))
    assert [item.label for item in table.flat().rows] == ["step", "  c", "  a"]


def test_by_header_leaves_out_headers_without_cells():
    assert by_header(SEVERAL.rows[0], SEVERAL.headers) == [("median", ("1", "", "3")), ("worst", ("2", "", "4"))]
    assert by_header(TextRow("depth", (("1",), ("2",))), ("share", "p5")) == [("share", ("1", "2"))]


ONE_VALUE = TextTable("Setting", ("",), (TextRow("lanes.hold_s", (("1.0",), ("2.0",))),), subjects=("base", "slow"))


def test_subjects_with_one_value_become_columns():
    flat = ONE_VALUE.flat()
    assert (flat.headers, flat.rows) == (("base", "slow"), (row("lanes.hold_s", "1.0", "2.0"),))


def test_subjects_that_do_not_fit_as_columns_become_rows(monkeypatch):
    names = tuple(f"run_number_{k}" for k in range(9))
    values = tuple((f"{k}",) for k in range(9))
    rows = tuple(TextRow(key, values) for key in ("lanes.hold_s", "seed"))
    lines = printed(monkeypatch, TextTable("Setting", ("",), rows, subjects=names)).splitlines()
    assert [line.split() for line in lines[3:6]] == [["lanes.hold_s"], ["run_number_0", "0"], ["run_number_1", "1"]]


def test_a_table_of_many_columns_is_wider_than_the_console(monkeypatch):
    headers = tuple(f"header{k:02}" for k in range(20))
    table = TextTable("Run", headers, (row("the_name_of_the_first", *(f"{k}.125" for k in range(20))), row("b", "0.5")))
    lines = printed(monkeypatch, table).splitlines()
    assert lines[1].split() == ["Run", *headers]
    assert lines[3].split()[1:] == [f"{k}.125" for k in range(20)]
    assert lines[4].strip() == "_first"


def test_only_text_in_the_last_column_wraps(monkeypatch):
    table = TextTable("Role", ("topic",), (row("image", "word " * 30),), last_is_text=True, label_columns=18)
    lines = printed(monkeypatch, table).splitlines()
    assert len(lines) == 6
    assert max(map(len, lines)) <= 80
    assert lines[4].startswith(" " * 20 + "word")
