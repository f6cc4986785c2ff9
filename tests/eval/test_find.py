"""roadperc-find: events with known answers, conditions on objects, one-line errors, and clips that replay alone."""

import json
import re
import shutil
from dataclasses import fields

import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli import find, replay
from roadperc_stream.eval import replaying
from roadperc_stream.eval.find import clips
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.output.tables import TableWriter
from roadperc_stream.schemas.columns import ObjectMetrics
from roadperc_stream.schemas.topics import METRICS_TOPIC
from tests.eval.dataset.datasets import A, B, add_table, done, log_id, write_runs
from tests.eval.tables import outcome, row
from tests.test_sample import SAMPLE

TIMES_S = {1: {3: 1.5, 4: 1.2, 6: 1.9, 16: 1.8, 40: 0.5}, 2: {0: 1.9, 9: 2.5}}
"""Time to impact by log and frame; frames are 50 ms apart."""
LAST = ("drive2", 49, 49, None)
CONDITION = "time_to_impact_s < 2 and lane_change <> 'none'"


@pytest.fixture
def dataset(tmp_path):
    """Two logs of 50 frames; in frame 40 of the first one the car keeps its lane."""
    folder = tmp_path / "data set"
    for number, times_s in TIMES_S.items():
        rows = [
            row(
                *(k, log_id(number)),
                time_to_impact_s=times_s.get(k),
                lane_change="none" if k == 40 else "left",
                reason_codes=("stereo.no_right_image", *["surface.plane_held"] * (k == 7)),
            )
            for k in range(50)
        ]
        add_table(folder, rows)
        write_objects(folder, number, {3: (4.0, 30.0), 4: (3.0,)} if number == 1 else {})
    write_runs(folder / "runs.parquet", [done(number, frames=50) for number in TIMES_S])
    return folder


EMPTY = {"stamp_ns": 0, "score": 1.0, "kept": True, "status": "measured", "beyond_range": False} | {
    f"{x}_{end}_px": 0.0 for x in "xy" for end in ("min", "max")
}


def write_objects(folder, number, distances_m):
    """A table of cars at distances by frame."""
    path = folder / "objects" / "date=2026-01-01" / f"{log_id(number)}-{A}.parquet"
    with TableWriter(path, ObjectMetrics, {}, (), {"config": A}) as table:
        for frame, all_m in distances_m.items():
            for distance_m in all_m:
                known = EMPTY | {"log_id": log_id(number), "frame": frame, "distance_m": distance_m, "label": "car"}
                table.append(ObjectMetrics(**{field.name: known.get(field.name) for field in fields(ObjectMetrics)}))


def found(capsys, tmp_path, *arguments):
    """First frame, last frame and peak of each event, and the lines that it prints."""
    code, out, err = outcome(find.main, capsys, *arguments, "--json", tmp_path / "events.json")
    assert (code, err) == (0, "")
    events = json.loads((tmp_path / "events.json").read_text())["events"]
    return [(e["log"], e["first_frame"], e["last_frame"], e["peak"]) for e in events], out.splitlines()


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], [("drive1", 3, 16, 1.2), ("drive2", 0, 0, 1.9)]),
        (["--gap", "0.5"], [("drive1", 3, 6, 1.2), ("drive1", 16, 16, 1.8), ("drive2", 0, 0, 1.9)]),
        (["--gap", "0.501"], [("drive1", 3, 16, 1.2), ("drive2", 0, 0, 1.9)]),
        (["--gap", "0.5", "--min-seconds", "0.15"], [("drive1", 3, 6, 1.2)]),
        (["--peak", "total_ms"], [("drive1", 3, 16, 10.0), ("drive2", 0, 0, 10.0)]),
    ],
)
def test_frames_that_are_close_form_an_event(options, expected, dataset, capsys, tmp_path):
    events, lines = found(capsys, tmp_path, dataset, CONDITION, *options)
    assert events == expected
    if not options:
        assert lines[0] == f"2 events in 2 logs: {CONDITION}"
        command = f"roadperc-view '{dataset}' --log drive1 --frame 4"
        assert lines[2] == f"drive1      3    16     0.65               1.2  {command}"


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("objects.distance_m < 5 and objects.label = 'car' and lane_change = 'left'", [("drive1", 3, 4, 3.0)]),
        ("objects.distance_m > 20", [("drive1", 3, 3, 30.0)]),
        ("objects.distance_m < 3.5 or frame = 49", [("drive1", 4, 4, 3.0), ("drive1", 49, 49, None), LAST]),
        ("objects.distance_m is null and frame < 5 and log_id = '0000000000000001'", [("drive1", 0, 2, None)]),
        ("lane_change = 'objects.label'", []),
        ("array_contains(reason_codes, 'surface.plane_held')", [("drive1", 7, 7, None), ("drive2", 7, 7, None)]),
    ],
)
def test_conditions_on_objects_join_by_log_and_frame(condition, expected, dataset, capsys, tmp_path):
    events, lines = found(capsys, tmp_path, dataset, condition)
    assert events == expected
    assert expected or lines == [f"no event: {condition}"]


def test_of_two_configurations_each_is_named_and_replaced_logs_are_left_out(dataset, capsys, tmp_path):
    add_table(dataset, [row(0, log_id(1), time_to_impact_s=1.0, lane_change="left")], B)
    runs = [done(1, frames=50), done(1, B, 1), done(2, frames=50, names=())]
    write_runs(dataset / "runs.parquet", runs)
    events, lines = found(capsys, tmp_path, dataset, CONDITION)
    assert events == [(f"drive1 {B}", 0, 0, 1.0), (f"drive1 {A}", 3, 16, 1.2)]
    assert lines[0] == f"2 events in 1 log: {CONDITION}"
    assert lines[2].endswith(f"--log drive1 --config {B} --frame 0")


@pytest.mark.parametrize(
    ("condition", "options", "message"),
    [
        ("time_to_impct_s < 2", [], "no column time_to_impct_s of the tables; similar columns: time_to_impact_s, "),
        ("objects.distanc_m < 2", [], "no column objects.distanc_m of the tables; similar columns: objects.distance_"),
        ("lane_left_status = lost", [], "if it is a text, write 'lost' in single quotes; docs/metrics.md lists"),
        ("time_to_impact_s", [], "is of type Float64, expected a condition on columns"),
        ("max(time_to_impact_s) > 3", [], "is one value for all rows, expected a condition on columns"),
        ("time_to_impact_s <", [], "is not a polars SQL condition (unable to parse "),
        ("frame > 3", ["--peak", "lane_change"], "--peak lane_change: is of type String, expected numbers"),
        ("frame > 3", ["--json", "a.parquet"], "a.parquet: expected the name of a result"),
    ],
)
def test_errors_are_one_line(condition, options, message, dataset, capsys):
    code, out, err = outcome(find.main, capsys, dataset, condition, *options)
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert message in err


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A result of the sample, 40 frames in 2 s."""
    path = tmp_path_factory.mktemp("find") / "run" / "out.mcap"
    assert replay.main([str(SAMPLE), str(path), "--quiet"]) == 0
    return path


def written(path, topic=None):
    """The results in a log: topic, log time and bytes."""
    messages = log.read(log.summarise(path), topics=topic and (topic,))
    return [(m.channel.topic, m.log_time_ns, m.data) for m in messages if is_result(m.channel)]


@pytest.mark.parametrize("kept", [True, False])
def test_a_clip_has_the_results_and_replays_alone(kept, result, capsys, tmp_path, monkeypatch):
    for module in (clips, replaying):
        monkeypatch.setattr(module, "BEFORE_S", 0.25)
        monkeypatch.setattr(module, "AFTER_S", 0.1)
    run = shutil.copytree(result.parent, tmp_path / "run")
    if not kept:
        (run / "out.mcap").unlink()
    asked = (run / "out.metrics.parquet", "frame >= 25 and frame < 30", "--clips", tmp_path / "clips[1]")
    code, out, _ = outcome(find.main, capsys, *asked)
    clip, again = tmp_path / "clips[1]" / "out-25.mcap", tmp_path / "again.mcap"
    assert code == 0
    assert out.endswith(f"wrote 1 clip to {clip.parent}\n")
    assert {"/camera/front/calibration", "/tf"} <= {m.channel.topic for m in log.read(log.summarise(clip))}
    frames = [time_ns for _, time_ns, _ in written(clip, METRICS_TOPIC)]
    assert len(frames) == 11
    assert replay.main([str(clip), str(again), "--quiet"]) == 0
    if kept:
        columns = ["camera_height_m", "lane_left_offset_m", "nearest_object_m", "step_m"]
        last = pl.read_parquet(again.with_suffix(".metrics.parquet")).tail(4).select("stamp_ns", *columns)
        recorded = pl.read_parquet(run / "out.metrics.parquet").join(last, on="stamp_ns", how="semi").select(columns)
        assert last.select(columns).rows() == [pytest.approx(values, rel=0.01) for values in recorded.rows()]
        assert set(written(clip)) <= set(written(result))
    else:
        places = [[place for *place, _ in written(path)] for path in (again, clip)]
        assert places[0] == places[1], "the same frames; the clip began with a warm-up"
    code, _, err = outcome(find.main, capsys, *asked)
    assert (code, err.splitlines()[0]) == (1, f"warning: no {clip}: {clip}: exists; pass --force to overwrite it")
    assert not kept or outcome(find.main, capsys, *asked, "--force")[0] == 0


def test_the_gallery_shows_the_peak_of_each_event_and_its_command(result, capsys, tmp_path):
    """Also of a log that was not kept, which is replayed; a picture that cannot be drawn has a reason."""
    page, run = tmp_path / "events.html", shutil.copytree(result.parent, tmp_path / "run")
    table, condition = run / "out.metrics.parquet", "frame % 10 = 3 and frame < 20"
    pages = {}
    for name in ("kept", "replayed"):
        code, out, _ = outcome(find.main, capsys, table, condition, "--gap", "0.1", "--gallery", page)
        assert (code, out.splitlines()[-1]) == (0, f"wrote {page}")
        pages[name] = re.findall(
            r'<img src="(data:image/jpeg;base64,[^"]+)" alt="frame (\d+) ', page.read_text("utf-8")
        )
        (run / "out.mcap").unlink(missing_ok=True)
    assert sorted(int(frame) for _, frame in pages["kept"]) == [3, 13]
    assert pages["kept"] == pages["replayed"]
    assert len({image for image, _ in pages["kept"]}) == 2
    assert f"roadperc-view {table} --frame 13</code>" in page.read_text("utf-8")
    text = table.with_name("other.metrics.parquet")
    rows = pl.read_parquet(table)
    rows.write_parquet(text)
    assert outcome(find.main, capsys, text, condition, "--gallery", page)[0] == 0
    assert "does not record the input and the configuration" in page.read_text("utf-8")
    assert outcome(find.main, capsys, table, condition, "--gallery", tmp_path / "x.mcap")[0] == 1
