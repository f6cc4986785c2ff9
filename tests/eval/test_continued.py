"""Continued replays (--continue) are one run, with the same figures as a single replay."""

import re
from dataclasses import replace

import polars as pl
import pytest

from roadperc_stream.cli.compare import main as compare_main
from roadperc_stream.cli.report import main as report_main
from roadperc_stream.cli.trajectory import main as trajectory_main
from roadperc_stream.eval.continued import find_joined
from roadperc_stream.eval.runs import collect
from roadperc_stream.eval.scan import rows_of
from tests.eval.tables import row, summary_of, write
from tests.eval.trajectory.paths import columns, helix, noisy

FRAMES = 20
LOGS = ("a" * 16, "b" * 16, "c" * 16, "d" * 16)
SPANS = ((0, 8), (5, 13), (10, 20))
"""First and end frame of each replay; the next replay repeats the last three frames."""


def frames(log="e" * 16):
    estimated, true = noisy(helix(FRAMES), 1), helix(FRAMES)
    poses = {**columns("odom", estimated), **columns("true", true)}
    at = [{name: float(values[k]) for name, values in poses.items()} for k in range(FRAMES)]
    return [row(k, log, lane_left_error_m=0.01 * k, odometry_status="tracked", **at[k]) for k in range(FRAMES)]


def continued(folder, spans=SPANS, version="1.2.3"):
    """Tables out_0, out_1, ... of continued replays; a repeated frame was incomplete before."""
    made = []
    for number, (first, end) in enumerate(spans):
        following = spans[number + 1][0] if number + 1 < len(spans) else end
        rows = [
            item if item.frame < following else replace(item, lane_left_error_m=None, missing=("depth",))
            for item in frames(LOGS[number])[first:end]
        ]
        facts = {"log_id": LOGS[number], "version": version}
        if number:
            facts |= {"continues": LOGS[number - 1], "first_frame": str(first)}
        made.append(str(write(folder / f"out_{number}.metrics.parquet", rows, **facts)))
    return made


@pytest.fixture
def whole(tmp_path):
    return str(write(tmp_path / "whole.metrics.parquet", frames()))


def numbers_of(run):
    return collect(rows_of(run).select("frame"), "")["frame"].to_list()


def test_continued_replays_are_one_run_with_the_figures_of_a_single_replay(tmp_path, whole):
    found = find_joined(continued(tmp_path))
    (run,), (expected,) = found.runs, find_joined([whole]).runs
    assert (run.name, run.frames, numbers_of(run)) == ("out_0+2", FRAMES, list(range(FRAMES)))
    assert found.notes == ("out_0+2: 3 continued replays as one run: out_0, out_1, out_2",)
    ours, theirs = summary_of(run, worst=3), summary_of(expected, worst=3)
    assert ours.log_ids == LOGS[:3]
    worst = {column: tuple(replace(f, run="whole") for f in ranking) for column, ranking in ours.worst.items()}
    assert replace(ours, name="whole", log_ids=theirs.log_ids, worst=worst) == theirs


@pytest.mark.parametrize("command", [report_main, trajectory_main], ids=["report", "trajectory"])
def test_the_commands_print_the_same_as_for_a_single_replay(tmp_path, whole, capsys, command):
    assert command([whole]) == 0
    expected = capsys.readouterr().out
    assert command(continued(tmp_path)) == 0
    printed = capsys.readouterr().out
    expected, printed = (re.sub(r"/\w+\.(mcap|metrics\.parquet)", "", text) for text in (expected, printed))
    note, text = printed.split("\n", 1)
    assert note == "out_0+2: 3 continued replays as one run: out_0, out_1, out_2"
    text = re.sub(r"log a{16}, b{16}, c{16},", f"log {'e' * 16},", " ".join(text.split())).replace("out_0+2", "whole")
    assert text == " ".join(expected.split())


def test_the_trajectory_of_continued_replays_is_one_file(tmp_path):
    assert trajectory_main([*continued(tmp_path), "--export-tum", str(tmp_path / "files")]) == 0
    files = {item.name: len(item.read_text().splitlines()) for item in (tmp_path / "files").iterdir()}
    assert files == {"out_0+2.est.tum": FRAMES, "out_0+2.true.tum": FRAMES}


def test_a_replay_whose_frames_are_all_repeated_has_a_note(tmp_path, capsys):
    tables = continued(tmp_path, ((0, 4), (0, 8), (6, 20)))
    for command in (report_main, trajectory_main):
        assert command(tables) == 0
        assert capsys.readouterr().out.startswith(
            "out_0+2: 3 continued replays as one run: out_0 (out_1 repeats all its 4 frames), out_1, out_2\n"
        )


def test_replays_of_any_order_and_folder_are_joined(tmp_path):
    first, *later = continued(tmp_path / "a")
    found = find_joined([later[1], first, later[0], *continued(tmp_path / "b")])
    assert [(run.name, run.frames) for run in found.runs] == [("a/out_0+2", FRAMES), ("b/out_0+2", FRAMES)]
    assert [[table.path.stem for table in run.tables] for run in found.runs] == [
        [f"out_{k}.metrics" for k in range(3)]
    ] * 2
    assert [{table.path.parent.name for table in run.tables} for run in found.runs] == [{"a"}, {"b"}]


def test_a_replay_without_its_predecessor_is_evaluated_separately(tmp_path):
    first, _, last = continued(tmp_path)
    found = find_joined([first, last])
    assert [(run.name, run.frames) for run in found.runs] == [("out_0", 8), ("out_2", 10)]
    missing = f"log {LOGS[1]}, same configuration, version and columns"
    apart = f"out_2: continues a replay that is not among these tables ({missing}) at frame 10"
    assert list(found.notes) == [f"{apart}; evaluated separately"]


def test_a_reference_of_continued_replays_is_created_and_updated(tmp_path, capsys):
    candidate, reference = tmp_path / "candidate", tmp_path / "reference"
    continued(candidate)
    assert compare_main([str(reference), str(candidate), "--update-reference"]) == 0
    assert sorted(p.name for p in reference.iterdir()) == [f"out_{k}.metrics.parquet" for k in range(3)]
    assert compare_main([str(reference), str(candidate), "--exact"]) == 0
    assert "20 frames compared" in capsys.readouterr().out
    continued(candidate, ((0, 8), (5, 13), (10, 19)))
    assert compare_main([str(reference), str(candidate), "--update-reference"]) == 0
    assert find_joined([str(reference)]).runs[0].frames == 19
    for name in ("out_2", "out_1"):
        (candidate / f"{name}.metrics.parquet").unlink()
    assert compare_main([str(reference), str(candidate), "--update-reference", "--other-log"]) == 3
    assert "1 table cannot replace 3" in capsys.readouterr().err


def test_ambiguous_replays_and_those_of_another_version_are_evaluated_separately(tmp_path):
    tables = continued(tmp_path, SPANS[:2])
    facts = {"log_id": LOGS[1], "continues": LOGS[0], "first_frame": "5"}
    again = write(tmp_path / "again.metrics.parquet", frames(LOGS[1])[5:13], **facts)
    newer = write(tmp_path / "newer.metrics.parquet", frames(LOGS[2])[5:13], **facts | {"version": "2.0.0"})
    found = find_joined([*tables, str(again), str(newer)])
    assert [(run.name, run.frames) for run in found.runs] == [("out_0", 5), ("out_1", 8), ("again", 8), ("newer", 8)]
    why = ("is not the only replay that continues out_0",) * 2 + ("continues a replay that is not among these tables",)
    assert all(text in note for text, note in zip(why, found.notes, strict=True))


def test_replays_with_other_columns_are_evaluated_separately(tmp_path):
    tables = continued(tmp_path, SPANS[:2])
    pl.read_parquet(tables[1]).with_columns(extra=1).write_parquet(
        tables[1], metadata=pl.read_parquet_metadata(tables[1])
    )
    found = find_joined(tables)
    assert [run.name for run in found.runs] == ["out_0", "out_1"]
    assert "same configuration, version and columns" in found.notes[0]
    assert report_main(tables) == 0


def test_a_replay_repeated_by_another_version_is_not_reported(tmp_path, capsys):
    first = continued(tmp_path / "old", ((0, 4),))
    later = continued(tmp_path / "new", ((0, 4), (0, 4)), version="2.0.0")[1]
    for command in (report_main, trajectory_main):
        assert command([*first, later]) == 0
        assert "out_0.metrics.parquet: out_1 repeats all its 4 frames\n" in capsys.readouterr().out
