"""Times of stages by frame: from a table, a row group at a time and in any order, and from a replay that runs."""

import pytest

from roadperc_stream.errors import TableError
from roadperc_stream.output import tables
from roadperc_stream.output.tables import ROW_GROUP_ROWS, TableWriter
from roadperc_stream.schemas import roadperc_pb2
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics
from roadperc_stream.view.stage_times import ReplayTimes, TableTimes

FRAMES = 2 * ROW_GROUP_ROWS + 10


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Three row groups; lanes did not run, surface only in even frames."""
    path = tmp_path_factory.mktemp("times") / "out.metrics.parquet"
    with TableWriter(path, FrameMetrics, {}, TIME_COLUMNS) as writer:
        for frame in range(FRAMES):
            surface = {} if frame % 2 else {"surface_ms": 1.5}
            writer.append(FrameMetrics("log", frame, 10 * frame), total_ms=float(frame), **surface)
    return path


def test_the_message_has_a_field_for_each_column():
    names = [field.name for field in roadperc_pb2.StageTimes.DESCRIPTOR.fields]
    assert names == ["timestamp", "frame_id", *TIME_COLUMNS]
    assert all(roadperc_pb2.StageTimes.DESCRIPTOR.fields_by_name[name].has_presence for name in TIME_COLUMNS)


def test_times_in_any_order(path):
    times = TableTimes(path)
    for frame in (0, 1, FRAMES - 1, 3, ROW_GROUP_ROWS, ROW_GROUP_ROWS - 1):
        surface = {} if frame % 2 else {"surface_ms": 1.5}
        assert times.of("log", frame) == {"total_ms": frame} | surface


def test_a_row_group_is_read_once_and_no_other(path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "roadperc_stream.view.stage_times.read_rows_around",
        lambda path, frame, *columns: asked.append(frame) or tables.read_rows_around(path, frame, *columns),
    )
    times = TableTimes(path)
    for frame in range(FRAMES + 3):
        times.of("log", frame)
    assert asked[:3] == [0, ROW_GROUP_ROWS, 2 * ROW_GROUP_ROWS]
    assert len(times._rows) <= ROW_GROUP_ROWS


@pytest.mark.parametrize(("log_id", "frame"), [("another", 5), ("log", FRAMES), ("log", -1)])
def test_no_times_of_what_the_table_has_not(path, log_id, frame):
    assert TableTimes(path).of(log_id, frame) == {}


def test_no_table_no_times(tmp_path):
    assert TableTimes(tmp_path / "out.metrics.parquet").of("log", 0) == {}


def test_an_empty_table(tmp_path):
    with TableWriter(tmp_path / "out.metrics.parquet", FrameMetrics, {}, TIME_COLUMNS):
        pass
    assert TableTimes(tmp_path / "out.metrics.parquet").of("log", 0) == {}


@pytest.mark.parametrize("damage", ["cut", "text", "folder"])
def test_a_table_that_cannot_be_read_is_named(path, tmp_path, damage):
    broken = tmp_path / "out.metrics.parquet"
    if damage == "folder":
        broken.mkdir()
    else:
        broken.write_bytes(path.read_bytes()[:-20] if damage == "cut" else b"frame,total_ms\n")
    with pytest.raises(TableError, match=r"out\.metrics\.parquet"):
        TableTimes(broken).of("log", 0)


def test_a_table_without_times_is_named(tmp_path):
    with TableWriter(tmp_path / "out.metrics.parquet", FrameMetrics, {}) as writer:
        writer.append(FrameMetrics("log", 0, 0))
    with pytest.raises(TableError, match="no column total_ms"):
        TableTimes(tmp_path / "out.metrics.parquet").of("log", 0)


def test_a_table_of_an_earlier_version_has_the_times_it_has(tmp_path):
    with TableWriter(tmp_path / "out.metrics.parquet", FrameMetrics, {}, ("lanes_ms", "total_ms")) as writer:
        writer.append(FrameMetrics("log", 0, 0), lanes_ms=2.0, total_ms=3.0)
    assert TableTimes(tmp_path / "out.metrics.parquet").of("log", 0) == {"lanes_ms": 2.0, "total_ms": 3.0}


def test_a_running_replay_knows_what_it_was_told():
    times = ReplayTimes()
    times.note(FrameMetrics("log", 3, 0), {"total_ms": 7.0, "lanes_ms": 2.0})
    assert times.of("log", 3) == {"lanes_ms": 2.0, "total_ms": 7.0}
    assert times.of("log", 4) == times.of("another", 3) == {}
