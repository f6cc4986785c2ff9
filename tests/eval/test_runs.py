"""The tables that arguments name, errors of other files, and names of runs."""

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.errors import TableError
from roadperc_stream.eval.report_columns import legend, short_names
from roadperc_stream.eval.runs import find_runs
from tests.eval.tables import row, write


def test_folder_glob_log_and_file_mean_the_same_table(tmp_path):
    table = write(tmp_path / "deep" / "drive.metrics.parquet", [row(0)])
    log = tmp_path / "deep" / "drive.mcap"
    log.touch()
    (tmp_path / "deep" / "drive.objects.parquet").touch()
    arguments = [str(tmp_path), str(tmp_path / "deep" / "*"), str(tmp_path / "*" / "dr*.parquet"), str(log), str(table)]
    for argument in arguments:
        assert [run.path for run in find_runs([argument])] == [table]
    assert len(find_runs(arguments)) == 1


def test_relative_glob(tmp_path, monkeypatch):
    write(tmp_path / "a" / "drive.metrics.parquet", [row(0)])
    write(tmp_path / "b" / "drive.metrics.parquet", [row(0)])
    monkeypatch.chdir(tmp_path)
    assert [run.name for run in find_runs(["?/drive*"])] == ["a/drive", "b/drive"]
    assert [run.name for run in find_runs(["**/*.parquet"])] == ["a/drive", "b/drive"]


def test_names_have_enough_folders_to_be_unique(tmp_path):
    for name in ("base/x/drive", "slow/x/drive", "slow/x/other"):
        write(tmp_path / f"{name}.metrics.parquet", [row(0)])
    assert [run.name for run in find_runs([str(tmp_path)])] == ["base/x/drive", "slow/x/drive", "other"]


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("nowhere", "nowhere: no such file"),
        ("nowhere/x.metrics.parquet", r"x\.metrics\.parquet: no such file"),
        ("nowhere.mcap", r"nowhere\.mcap: no such file"),
        ("in.mcap", r"in\.mcap: no in\.metrics\.parquet beside it"),
        ("metrics", "is part of a batch.s dataset; pass the dataset.s folder, .+"),
        (".", r"no \*\.metrics\.parquet in this folder"),
        ("in*", r"matches no metrics table \(1 file of other kinds\)"),
        ("x*", r"x\*: matches no metrics table \(no file"),
    ],
)
def test_arguments_without_tables_are_errors(tmp_path, argument, message):
    (tmp_path / "in.mcap").touch()
    (tmp_path / "metrics" / "date=2026-01-01").mkdir(parents=True)
    with pytest.raises(TableError, match=message):
        find_runs([str(tmp_path / argument)])


def test_a_parquet_file_of_detections_is_an_error(tmp_path):
    path = tmp_path / "out.objects.parquet"
    pq.write_table(pa.table({"log_id": ["a"], "frame": [0], "stamp_ns": [1], "label": ["Car"]}), path)
    with pytest.raises(TableError, match=r"no column surface_inlier_ratio; .* in out\.metrics\.parquet"):
        find_runs([str(path)])


@pytest.mark.parametrize("content", [b"", b"not a table", None])
def test_other_and_truncated_files_are_errors(tmp_path, content):
    path = write(tmp_path / "cut.metrics.parquet", [row(index) for index in range(50)])
    path.write_bytes(path.read_bytes()[:-100] if content is None else content)
    with pytest.raises(TableError, match=r"cut\.metrics\.parquet: is not a Parquet file, or is truncated"):
        find_runs([str(path)])


NAMES = st.lists(st.text("abcdefg/_0123456789", min_size=1, max_size=60), unique=True, min_size=1, max_size=12)


def test_names_that_differ_in_the_middle_are_numbered():
    names = short_names(["runs_of_today/a/town_drive", "runs_of_today/b/town_drive", "c"], 15)
    assert list(names.values()) == ["1 runs_o…_drive", "2 runs_o…_drive", "c"]
    assert len(list(legend(names))) == 2


@given(NAMES, st.integers(15, 60))
def test_every_short_name_fits_and_is_unique(names, columns):
    short = short_names(names, columns)
    assert list(short) == names
    assert max(map(len, short.values())) <= columns
    assert len(set(short.values())) == len(names)
