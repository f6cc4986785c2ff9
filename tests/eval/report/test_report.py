"""roadperc-report: its text, its width, and its exit code."""

import json
import re
from functools import partial
from pathlib import Path

import polars as pl
import pytest

from roadperc_stream.cli.report import main
from roadperc_stream.config import load_config
from roadperc_stream.eval.frame_commands import view_command, view_pair_command
from roadperc_stream.model import Reason
from roadperc_stream.output.tables import table_facts
from tests.eval.tables import object_rows, outcome, row, run_of, write

short = partial(outcome, main)
report = partial(outcome, lambda argv: main([*argv, "--full"]))

TRUTHFUL = {
    "surface_source": "depth",
    "camera_height_m": 1.5,
    "camera_pitch_deg": -0.0,
    "lane_left_status": "measured",
    "lane_left_offset_m": 1.75,
    "lane_left_boundary_class": "road",
    "lane_right_status": "held",
    "drivable_iou": 0.97,
    "object_distance_error_m": 12345.678,
}


def configured(path, error, *settings):
    """A table of a frame that carries the configuration which made it."""
    write(path, [row(0, lane_left_error_m=error)])
    facts = table_facts(Path("in.mcap"), Path("out.mcap"), load_config(settings=settings))
    pl.read_parquet(path).write_parquet(path, metadata=facts)


def line_of(text, start):
    return next(line for line in text.splitlines() if line.startswith(start)).split()


@pytest.fixture
def drive(tmp_path):
    """Four frames, three of them with a lane error of 1, -2 and 30 cm."""
    errors = [0.01, -0.02, 0.30, None]
    rows = [row(k, lane_left_error_m=error, **TRUTHFUL) for k, error in enumerate(errors)]
    times = [{"surface_ms": 2.0, "lanes_ms": 1.0, "total_ms": 4.0}] * 4
    return write(tmp_path / "drive.metrics.parquet", rows, times)


def test_a_log_without_truth_is_ranked_by_suspect_quantities(tmp_path, capsys):
    rows = [row(0, step_m=1.0), row(1, lane_left_status="lost")]
    _, text, _ = report(capsys, write(tmp_path / "drive.metrics.parquet", rows))
    assert "No frame has truth" in text
    assert "Consistency" not in text
    assert "error" not in text
    assert line_of(text, "lanes_lost")[1:] == ["1", "1", "0.050", "1577836800050000000"]


@pytest.mark.parametrize("columns", ["20", "80", "120"])
def test_piped_text_is_plain_and_numbers_stay_whole(drive, tmp_path, capsys, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)
    write(tmp_path / "a_much_longer_name_than_the_column_has_room_for_it.metrics.parquet", [row(0, **TRUTHFUL)])
    _, text, _ = report(capsys, tmp_path)
    assert "\x1b" not in text
    assert not re.search(r"None|nan|-0\.0+\b(?!\d)|\de[+-]?\d", text)
    assert "12345.678" in text
    assert "1577836800100000000" in text
    assert max(len(line) for line in text.splitlines()) <= max(80, int(columns))
    assert not any(line.endswith(" ") for line in text.splitlines())


def test_a_long_name_is_shortened_and_explained_in_the_legend(drive, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    name = "the_quick_brown_fox_jumps_over_the_lazy_dog"
    write(tmp_path / f"{name}.metrics.parquet", [row(0, lane_left_error_m=9.0)])
    _, text, _ = report(capsys, tmp_path, "--worst", "1")
    lines = text.splitlines()
    assert f"the_qui…azy_dog: {name}" in lines
    assert sum(name in line for line in lines) == 1
    at = next(k for k, line in enumerate(lines) if line == "lane_left_error_m" and "15778" in lines[k + 1])
    assert lines[at + 1].split() == ["the_qui…azy_dog", "9.000", "0", "0.000", "1577836800000000000"]
    rows = [line for line in lines if line.lstrip().startswith("the_qui…azy_dog ")]
    assert all(re.search(r"\d$", line) for line in rows)


def test_only_runs_of_one_configuration_are_pooled(tmp_path, capsys):
    for name, error, config in (("a", 0.1, "1"), ("b", 0.3, "1"), ("c", 9.0, "2")):
        write(tmp_path / f"{name}.metrics.parquet", [row(0, lane_left_error_m=error)], config=config * 64)
    _, text, _ = report(capsys, tmp_path)
    assert text.startswith("3 runs: 1 log, 2 configurations, 1 version")
    block = text[text.index("\nAccuracy") :].splitlines()[4:6]
    assert [line.split() for line in block] == [
        ["11111111", "100.0", "0.200", "0.200", "0.290", "0.300"],
        ["c", "100.0", "9.000", "9.000", "9.000", "9.000"],
    ]
    block = text[text.index("Accuracy by run") :].splitlines()[3:6]
    assert [line.split()[:2] for line in block] == [["a", "100.0"], ["b", "100.0"], ["c", "100.0"]]
    assert "2 frames" in text
    assert "3 frames" not in text


def test_runs_without_a_configuration_are_not_pooled(tmp_path, capsys):
    for name, error in (("a", 0.1), ("b", 0.3)):
        path = write(tmp_path / f"{name}.metrics.parquet", [row(0, lane_left_error_m=error)])
        pl.read_parquet(path).write_parquet(path)
    _, text, _ = report(capsys, tmp_path)
    assert [line.split()[1] for line in text[text.index("\nAccuracy") :].splitlines()[4:6]] == ["100.0", "100.0"]
    assert "Settings that differ: unknown: no configuration in the table" in text.replace("\n", " ")


def test_of_many_logs_the_worst_are_shown(tmp_path, capsys):
    for index in range(14):
        rows = [row(0, f"{index:016x}", lane_left_error_m=index / 100)]
        write(tmp_path / f"log{index:02}.metrics.parquet", rows)
    _, text, _ = report(capsys, tmp_path)
    block = text[text.index("Accuracy by run") : text.index("Latency by run")]
    assert re.findall(r"log(\d\d)", block) == [f"{index:02}" for index in range(13, 1, -1)]
    assert "at most 12 of 14 per row, those with the worst p95" in text


def test_rare_reasons_are_counted_together_and_markup_is_printed_as_text(tmp_path, capsys):
    markup = "objects: [bold]no[/bold] detections"
    odd = Reason("objects", "other", ("[bold]no[/bold] detections",))
    rows = [row(k, reasons=(Reason("surface", "other", (f"problem {chr(97 + k)}",)), odd)) for k in range(12)] + [
        row(k) for k in range(4)
    ]
    _, text, _ = report(capsys, write(tmp_path / "[red]drive.metrics.parquet", rows))
    assert "[red]drive: log" in text
    assert line_of(text, markup)[-2:] == ["12", "75.0"]
    assert line_of(text, "3 other reasons") == ["3", "other", "reasons"]


def test_the_confusion_of_the_classes_beyond_the_boundaries(tmp_path, capsys):
    names = ("lane_left_true_boundary_class", "lane_left_boundary_class", "lane_right_true_boundary_class")
    seen = [("sidewalk", "road", None), ("sidewalk", "sidewalk", "road"), ("road", "road", None)]
    write(tmp_path / "a.metrics.parquet", [row(k, **dict(zip(names, v, strict=True))) for k, v in enumerate(seen)])
    _, out, _ = report(capsys, tmp_path / "a.metrics.parquet")
    table = out[out.index("True class beyond") :].splitlines()
    assert table[0].split() == ["True", "class", "beyond", "boundaries", "road", "%", "sidewalk", "%", "none", "%"]
    rows = sorted(line.split() for line in table[2:4])
    assert rows == [["road", "2", "50.0", "0.0", "50.0"], ["sidewalk", "2", "50.0", "50.0", "0.0"]]


def test_reasons_with_different_numbers_are_merged_and_inputs_come_before_stages(tmp_path, capsys):
    size = ", its calibration says 640x480"
    sizes = [[Reason(role, "wrong_size", (k, 9, 640, 480)) for role in ("image", "depth")] for k in range(4)]
    rows = [row(k, reasons=(Reason("lanes", "no_segmentation"), *sizes[k])) for k in range(4)]
    _, text, _ = report(capsys, write(tmp_path / "drive.metrics.parquet", rows))
    said = text.partition("Missing outputs")[2].splitlines()[2:5]
    assert [line.split() for line in said] == [
        [*f"depth: 0x9 pixels{size} (numbers vary)".split(), "4", "100.0"],
        [*f"image: 0x9 pixels{size} (numbers vary)".split(), "4", "100.0"],
        ["lanes:", "no", "segmentation", "4", "100.0"],
    ]


def test_reasons_that_differ_between_runs_are_listed_by_run(tmp_path, capsys):
    """Reasons with the same share in all runs appear only in the first table."""
    both = "objects: no detections"
    none = Reason("objects", "no_detections")
    seen = [row(k, reasons=(none,)) for k in range(4)]
    blind = [row(k, reasons=(none, Reason("image", "wrong_size", (k, 9, 64, 48)))) for k in range(2)] + seen[2:]
    paths = [write(tmp_path / f"{n}.metrics.parquet", rows) for n, rows in (("seen", seen), ("blind", blind))]
    _, text, _ = report(capsys, *paths)
    assert line_of(text, both)[-2:] == ["8", "100.0"]
    assert line_of(text, "image: 0x9 pixels, its calibration says 64x48 (numbers vary)")[-2:] == ["2", "25.0"]
    by_log = text.partition("Missing outputs by run")[2].split("\n\n")[0].splitlines()[2:]
    assert [line.split() for line in by_log] == [
        ["image:", "0x9", "pixels,", "its", "calibration", "says", "64x48", "(numbers", "vary)"],
        ["blind", "2", "50.0"],
    ]


def test_the_short_report_has_a_row_per_stage_and_the_command_of_the_worst_frame(drive, capsys):
    _, text, _ = short(capsys, drive)
    assert line_of(text, "lane left error at 10 m, m")[-5:] == ["100.0", "0.020", "0.272", "0.300", "2"]
    worst = [line for line in text.splitlines() if line.startswith("worst frame: ")]
    assert worst == [f"worst frame: object distance error 12345.678 m: {view_command(run_of(drive), 0)}"]
    assert "latency: median 4.0 ms, p95 4.0 ms, 250.0 frames/s per core" in text
    assert len(text.splitlines()) <= 15


def test_two_runs_of_a_log_have_the_verdict_of_a_comparison(tmp_path, capsys):
    paths = [
        write(tmp_path / f"{name}.metrics.parquet", [row(k, lane_left_error_m=e + k % 3 / 1000) for k in range(60)])
        for name, e in (("a", 0.01), ("b", 0.01), ("c", 0.2))
    ]
    _, text, _ = short(capsys, *paths[:2])
    assert "\nno relevant difference: " in text
    _, text, _ = short(capsys, paths[0], paths[2])
    assert "\nworse: lane left error at 10 m, mean 0.011 → 0.201 m" in text
    assert view_pair_command(run_of(paths[0]), run_of(paths[2]), 0) in text


def test_the_short_report_of_many_runs_has_fifteen_lines(tmp_path, capsys):
    for k in range(8):
        configured(tmp_path / f"drive_{k}.metrics.parquet", 0.1 + k / 100, f"lanes.hold_s={k % 2 + 1}")
    write(tmp_path / "drive_8.metrics.parquet", [row(0, lane_left_offset_m=1.75)])
    _, text, _ = short(capsys, tmp_path)
    assert len(text.splitlines()) <= 15
    assert line_of(text, "drive_7")[:3] == ["drive_7", "1", "0.170"]
    assert "settings that differ: lanes.hold_s 1.0/2.0/unknown" in text
    assert line_of(text, "least coverage, %")[3] == "0.0"


def test_two_runs_that_differ_in_everything_have_fifteen_lines(tmp_path, capsys):
    errors = ("lane_left_error_m", "object_distance_error_m", "stereo_epe_px", "step_error_m", "camera_height_error_m")
    base, new = tmp_path / "base.metrics.parquet", tmp_path / "new.metrics.parquet"
    for path, worse, status in ((base, 0.3, "tracked"), (new, 1.3, "lost")):
        values = [dict.fromkeys(errors, worse + frame % 3 / 1000) for frame in range(60)]
        write(path, [row(frame, **of_frame, odometry_status=status) for frame, of_frame in enumerate(values)])
    _, text, _ = short(capsys, base, new)
    assert len(text.splitlines()) <= 15
    assert "pass --full for details" in text


@pytest.mark.parametrize(
    ("by", "expected"),
    [
        ("lane_left_error_m > 0.05", [["true", "1", "0.300"], ["false", "2", "0.019"], ["none", "1"]]),
        ("log", [["drive", "4", "0.272"]]),
    ],
)
def test_slices_are_sorted_by_the_worst(tmp_path, capsys, by, expected):
    rows = [row(k, lane_left_error_m=error) for k, error in enumerate([0.01, -0.02, 0.30, None])]
    _, text, _ = short(capsys, write(tmp_path / "drive.metrics.parquet", rows), "--by", by)
    lines = text[text.index("Slice") :].splitlines()[2:]
    assert [line.split() for line in lines[: len(expected)]] == expected


def test_objects_by_class_and_files_for_other_programs(tmp_path, capsys):
    path = write(tmp_path / "drive.metrics.parquet", [row(0), row(1)])
    seen = {"frame": [0, 0, 1], "label": ["Car", "Van", "Car"], "kept": [True] * 3, "distance_m": [10.0, 20.0, 12.0]}
    object_rows(seen | {"true_distance_m": [10.5, 22.0, 12.0]}).write_parquet(tmp_path / "drive.objects.parquet")
    files = {name: tmp_path / f"out.{name}" for name in ("json", "markdown", "junit")}
    options = [word for name, file in files.items() for word in (f"--{name}", file)]
    _, text, _ = short(capsys, path, "--by", "class", *options)
    assert line_of(text, "Van")[1:] == ["1", "1", "100.0", "2.000", "2.000", "2.000"]
    assert json.loads(files["json"].read_text())["slices"]["Car"]["median"] == 0.25
    assert "| Van | 1 | 1 |" in files["markdown"].read_text()
    _, _, error = short(capsys, path, "--by", "clas")
    assert "--by clas: no column of the tables; similar columns: class" in error
    assert short(capsys, path, *options)[0] == 0
    assert '<testsuite name="roadperc-report" tests="0"' in files["junit"].read_text()


def test_an_empty_table_is_noted_beside_others_and_an_error_alone(tmp_path, capsys, drive):
    empty = write(tmp_path / "empty.metrics.parquet", [])
    code, text, _ = report(capsys, drive, empty)
    assert code == 0
    assert "empty.metrics.parquet: no frames in this table" in text
    assert "drive: log" in text
    message = f"error: {empty}: no frames in this table; expected a table with frames\n"
    assert report(capsys, empty) == (1, "", message)


def without_truth(k, source="depth", **columns):
    """A frame of a log without truth, half a metre of road a frame at 20 Hz."""
    first = {"odometry_status": "first", "odometry_inliers": 0}
    later = {"odometry_status": "tracked", "odometry_inliers": 100 + k, "turn_deg": 0.1, "step_m": 0.5}
    given = {"surface_source": source, "camera_height_m": 1.5, **(later if k else first)}
    return row(k, **(given | columns))


def test_without_truth_measured_held_and_assumed_frames_are_told_apart(tmp_path, capsys):
    lane = {"lane_left_offset_m": 1.7, "lane_width_m": 3.5}
    rows = [
        without_truth(0, "depth", lane_left_status="measured", **lane),
        without_truth(1, "held", lane_left_status="held", **lane),
        without_truth(2, "estimated", lane_left_status="lost"),
        without_truth(3, "assumed", lane_left_status="measured", **lane),
    ]
    path = write(tmp_path / "drive.metrics.parquet", rows)
    code, text, _ = short(capsys, path, "--json", tmp_path / "report.json")
    assert code == 0
    assert [line_of(text, f"surface{state} ")[-1] for state in ("", ": estimated", ": assumed")] == ["25.0"] * 3
    stages = json.loads((tmp_path / "report.json").read_text())["runs"]["drive"]["stages"]
    assert stages["surface"]["states"] == {"held": 0.25, "estimated": 0.25, "assumed": 0.25}
    assert (stages["lane_left"]["coverage"], stages["lane_left"]["states"]) == (0.5, {"held": 0.25})


def test_without_truth_the_short_report_has_the_values_that_tell_the_scale(tmp_path, capsys):
    reasons = (Reason("surface", "no_depth_plane_assumed", ("the assumed height",)),)
    rows = [without_truth(k, lane_width_m=3.5, lane_right_offset_m=-1.7, reasons=reasons) for k in range(4)]
    _, text, _ = short(capsys, write(tmp_path / "drive.metrics.parquet", rows, mounting_height_m="1.4"))
    assert line_of(text, "speed")[-2:] == ["10.00", "10.00"]
    assert line_of(text, "camera height (mounting 1.400), m")[-2] == "1.500"
    assert line_of(text, "lane width")[-2] == "3.500"
    assert "assumed height 1.5 m" in text
    named = set(re.findall(r"\w+", text.partition("columns:")[2]))
    assert {"camera_height_m", "lane_width_m"} <= named
    assert "speed_mps" not in named  # it is not stored


def test_steps_without_scale_and_lost_frames_are_told_with_their_reason(tmp_path, capsys):
    few = Reason("odometry", "too_few_inliers")
    lost = {"odometry_status": "lost", "odometry_inliers": 3, "turn_deg": None, "step_m": None}
    rows = [without_truth(k, step_m=None) for k in range(3)]
    rows += [without_truth(3, **lost, reasons=(Reason("odometry", "lost", (), few),))]
    _, text, _ = short(capsys, write(tmp_path / "drive.metrics.parquet", rows))
    assert line_of(text, "odometry inliers")[2] == "50.0"
    assert line_of(text, "odometry: lost")[-1] == "25.0"
    assert line_of(text, "odometry: without metric scale")[-1] == "50.0"
    assert "odometry: lost, too few points agree on a motion" in text
    assert "speed" not in text


def test_the_first_frame_is_never_the_worst_by_inliers(tmp_path, capsys):
    path = write(tmp_path / "drive.metrics.parquet", [without_truth(k) for k in range(4)])
    _, text, _ = short(capsys, path)
    assert line_of(text, "odometry inliers")[-2:] == ["101.0", "1"]


def test_a_stage_without_truth_keeps_its_quality_beside_stages_with_truth(tmp_path, capsys):
    rows = [without_truth(k, step_error_m=0.1 if k else None, surface_inlier_ratio=0.9) for k in range(4)]
    _, text, _ = short(capsys, write(tmp_path / "drive.metrics.parquet", rows))
    assert line_of(text, "odometry: step error")[-2:] == ["0.1000", "1"]
    assert line_of(text, "surface inlier ratio")[3] == "100.0"
    assert "No frame has truth" not in text


@pytest.mark.parametrize("options", [(), ("--full",)])
def test_every_figure_names_its_column(drive, capsys, options):
    _, text, _ = short(capsys, drive, *options)
    assert {"lane_left_error_m", "object_distance_error_m"} <= set(re.findall(r"\w+", text))
