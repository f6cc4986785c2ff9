"""``roadperc-view`` at a frame: its timeline, runs without a log, datasets, and two runs in one recording."""

import shlex
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from roadperc_stream.cli.batch import main as batch_main
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.cli.view import main
from roadperc_stream.eval.frame_commands import view_command, view_pair_command
from roadperc_stream.eval.runs import open_run
from roadperc_stream.view.differences import find_differences
from tests.view.rerun.chunks import recorded

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A base and a new run of 4 frames, and a batch of the base's part without result logs."""
    folder = tmp_path_factory.mktemp("my runs")
    for name, settings in (("base", []), ("new", ["--set", "surface.inlier_m=0.3"])):
        asked = [str(SAMPLE), str(folder / f"{name}.mcap"), "--frames", "4", "--quiet", *settings]
        assert replay_main(asked) == 0
    assert batch_main([str(folder / "batch"), str(SAMPLE), "--frames", "4", "--quiet", "--jobs", "1"]) == 0
    return folder


def last_on(path, timeline):
    """The frame numbers of the metrics on a timeline."""
    rows = recorded(path)["/perception/metrics/camera_height_m"].rows
    return sorted(row["frame"] for row in rows if row.get(timeline) is not None)


def test_the_timeline_of_a_recording_ends_at_the_frame(folder, tmp_path, capsys):
    target = tmp_path / "a.rrd"
    assert main([str(folder / "base.mcap"), "--frame", "2", "--save", str(target)]) == 0
    assert "opens at frame 2" in capsys.readouterr().out
    assert (last_on(target, "up to frame 2"), last_on(target, "message_log_time")) == ([0, 1, 2], [0, 1, 2, 3])


def test_the_worst_frame_of_a_column(folder, tmp_path, capsys):
    rows = pl.read_parquet(folder / "base.metrics.parquet")
    worst = rows["frame"][rows["lane_left_offset_m"].abs().arg_max()]
    asked = [str(folder / "base.mcap"), "--worst", "lane_left_offset_m", "--save", str(tmp_path / "a.rrd")]
    assert main(asked) == 0
    assert f"opens at frame {worst};" in capsys.readouterr().out
    assert main([str(folder / "base.mcap"), "--worst", "lane_left_ofset_m"]) == 1
    assert "nearest: lane_left_offset_m" in capsys.readouterr().err


def test_a_frame_that_does_not_exist_is_an_error(folder, capsys):
    assert main([str(folder / "base.mcap"), "--frame", "9"]) == 1
    assert "base.mcap: no frame 9; expected 0 to 3" in capsys.readouterr().err


def test_a_frame_without_its_log_is_replayed_and_values_that_differ_are_reported(folder, tmp_path, capsys):
    table, target = tmp_path / "lost.metrics.parquet", tmp_path / "a.rrd"
    facts = pl.read_parquet_metadata(folder / "base.metrics.parquet")
    later = pl.lit(0.1)  # a replay up to the frame has no later frames
    rows = pl.read_parquet(folder / "base.metrics.parquet").with_columns(lane_left_hindsight_m=later)
    rows.write_parquet(table, metadata=facts)
    assert main([str(table), "--frame", "2", "--save", str(target)]) == 0
    assert "differ" not in capsys.readouterr().out
    assert last_on(target, "up to frame 2") == [0, 1, 2]
    changed = pl.read_parquet(table).with_columns(camera_height_m=pl.lit(9.0))
    changed.write_parquet(table, metadata=facts)
    assert main([str(table), "--frame", "2", "--save", str(target), "--force"]) == 0
    assert "note: 1 value of the frame differ: camera_height_m" in capsys.readouterr().out


def test_every_command_opens_its_frame(folder, tmp_path, capsys):
    base, new = (open_run(folder / f"{name}.metrics.parquet", name) for name in ("base", "new"))
    batch = str(folder / "batch")
    in_batch = replace(base, name="sample", dataset=(batch, ""))
    commands = [view_command(base, 1), view_pair_command(base, new, 1), view_command(in_batch, 1)]
    for command in commands:
        words = [*shlex.split(command)[1:], "--save", str(tmp_path / "a.rrd"), "--force"]
        assert main(words) == 0, command
        assert "opens at frame 1;" in capsys.readouterr().out


def test_a_log_that_a_dataset_does_not_have_is_an_error(folder, capsys):
    assert main([str(folder / "batch"), "--log", "sampel", "--frame", "1"]) == 1
    assert "did you mean sample?" in capsys.readouterr().err
    assert main([str(folder / "batch"), "--frame", "1"]) == 1
    assert "pass --log NAME; its logs: sample" in capsys.readouterr().err


def test_two_runs_are_in_one_recording(folder, tmp_path):
    target = tmp_path / "pair.rrd"
    assert main([str(folder / "base.mcap"), str(folder / "new.mcap"), "--frame", "1", "--save", str(target)]) == 0
    entities = set(recorded(target))
    assert {"/base/perception/lanes/scene", "/new/perception/lanes/scene", "/base/camera/front/image"} <= entities
    assert not {name for name in entities if name.startswith(("/new/camera", "/new/tf"))}


def test_differences_are_those_of_the_tables(folder):
    differences = find_differences(folder / "base.mcap", folder / "new.mcap")
    assert "surface_inlier_ratio" in {found.name for found in differences}
    for found in differences:
        base, new = (pl.read_parquet(folder / f"{name}.metrics.parquet")[found.name] for name in ("base", "new"))
        assert max(abs((new.abs() - base.abs()).drop_nulls())) == pytest.approx(max(abs(found.values)))
