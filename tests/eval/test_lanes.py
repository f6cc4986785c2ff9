"""A run's lanes as TuSimple's JSON lines, and their scores: known answers, round trips and invalid input."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.cli.lanes import main
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.eval.lanes.lane_files import LaneFrame, default_rows, read_frames, to_line
from roadperc_stream.eval.lanes.lanes import score_frame
from roadperc_stream.eval.lanes.run_lanes import open_lanes
from roadperc_stream.model import Boundary, Lanes
from roadperc_stream.output import encoding
from roadperc_stream.output.tables import sidecar_path
from tests.analytic import Road
from tests.eval import tables
from tests.eval.tables import START_NS, STEP_NS, outcome
from tests.logs import Item
from tests.logs import write as write_log

lanes = partial(outcome, main)

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
SIZE = (1280, 720)
ROWS = np.arange(160.0, 720.0, 10.0)
LEFT_PX, RIGHT_PX = 300.0, 900.0
STAMPS_NS = [START_NS + k * STEP_NS for k in range(3)]


def upright(x_px):
    return np.array([(x_px, y_px) for y_px in np.arange(719.0, 150.0, -10.0)])


def seen(stamp_ns, *lines_px, camera="camera"):
    sides = zip(("left", "right"), lines_px, strict=False)
    lanes = Lanes(tuple(Boundary(side, "measured", line_px=line) for side, line in sides))
    return Item("truth_lanes", stamp_ns, encoding.encode_lanes(stamp_ns, camera, lanes), "/perception/lanes")


def run_log(path, items):
    camera = Road(width=SIZE[0], height=SIZE[1]).camera
    return write_log(path, [Item("calibration", START_NS, encoding.encode_calibration(START_NS, camera)), *items])


@pytest.fixture
def drive(tmp_path):
    """Two upright lanes in three frames."""
    items = [seen(stamp, upright(LEFT_PX), upright(RIGHT_PX)) for stamp in STAMPS_NS]
    return run_log(tmp_path / "drive.mcap", items)


def truth_line(stamp_ns, *columns_px, **changes):
    lanes = [[x] * len(ROWS) for x in columns_px]
    line = {"raw_file": f"any/{stamp_ns}.jpg", "lanes": lanes, "h_samples": [int(row) for row in ROWS]}
    return json.dumps(line | changes)


def truth_file(tmp_path, *lines):
    path = tmp_path / "truth.json"
    path.write_text("\n".join(lines) + "\n")
    return path


def cells(text, start):
    (line,) = [line for line in text.splitlines() if line.startswith(start)]
    return line.removeprefix(start).split()


def test_every_frame_is_a_line_of_the_format(drive, tmp_path, capsys):
    tables.write(
        sidecar_path(drive, "metrics"), [tables.row(k) for k in range(4)], [{"total_ms": 10.0 + k} for k in range(4)]
    )
    code, text, _ = lanes(capsys, drive, "--tusimple", tmp_path / "out" / "drive.json")
    assert (code, text) == (0, "drive: 4 frames, lanes in 3\n")
    lines = [json.loads(line) for line in (tmp_path / "out" / "drive.json").read_text().splitlines()]
    assert list(lines[0]) == ["raw_file", "lanes", "h_samples", "run_time"]
    assert [line["raw_file"] for line in lines[:3]] == [f"drive/{stamp}" for stamp in STAMPS_NS]
    assert [line["run_time"] for line in lines] == [10.0, 11.0, 12.0, 13.0]
    assert lines[0]["lanes"] == [[300] * 56, [900] * 56]
    assert lines[3]["lanes"] == []
    assert lines[0]["h_samples"] == list(range(160, 720, 10))


def test_frames_of_a_looped_log_have_the_times_of_their_segment(tmp_path):
    """Both segments have the same stamps; the log lacks the first frame of the second."""
    times = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    stamps = [*STAMPS_NS, *STAMPS_NS[1:]]
    items = [seen(stamp, upright(LEFT_PX)) for stamp in stamps]
    log = run_log(tmp_path / "a.mcap", [replace(item, stamp_ns=START_NS + k) for k, item in enumerate(items)])
    rows = [replace(tables.row(k), frame=k + 3 * segment, segment=segment) for segment in (0, 1) for k in range(3)]
    tables.write(sidecar_path(log, "metrics"), rows, [{"total_ms": ms} for ms in times])
    found = [(f.stamp_ns, len(f.lines_px), f.run_time_ms) for f in open_lanes(log).frames()]
    assert found == list(zip(STAMPS_NS * 2, (1, 1, 1, 0, 1, 1), times, strict=True))


def test_frames_that_only_the_table_has_are_in_order_and_without_a_table_run_time_is_zero(tmp_path):
    log = run_log(tmp_path / "a.mcap", [seen(STAMPS_NS[1], upright(LEFT_PX))])
    assert [(f.stamp_ns, f.run_time_ms) for f in open_lanes(log).frames()] == [(STAMPS_NS[1], 0.0)]
    tables.write(sidecar_path(log, "metrics"), [tables.row(k) for k in range(3)])
    assert [(f.stamp_ns, len(f.lines_px)) for f in open_lanes(log).frames()] == list(
        zip(STAMPS_NS, (0, 1, 0), strict=True)
    )


def test_rows_are_the_same_ratio_of_every_height():
    ends = {height: (default_rows(height)[0], default_rows(height)[-1]) for height in (720, 270, 960)}
    assert ends == {720: (160, 710), 270: (60, 260), 960: (220, 950)}


def test_with_truth_only_its_frames_and_rows_are_written(drive, tmp_path, capsys):
    line = {"raw_file": f"any/{STAMPS_NS[1]}.jpg", "lanes": [[300, -2]], "h_samples": [500, 719.5]}
    path = truth_file(tmp_path, json.dumps(line))
    lanes(capsys, drive, "--truth", path, "--tusimple", tmp_path / "out.json")
    (written,) = map(json.loads, (tmp_path / "out.json").read_text().splitlines())
    assert written["raw_file"] == line["raw_file"]
    assert written["h_samples"] == [500, 719.5]
    assert written["lanes"] == [[300, -2], [900, -2]]


def test_the_lanes_of_a_replay_can_be_exported_and_scored(tmp_path, capsys):
    log, own = tmp_path / "sample.mcap", tmp_path / "own.json"
    assert replay_main([str(SAMPLE), str(log), "--quiet", "--frames", "2"]) == 0
    assert lanes(capsys, log, "--tusimple", own)[0] == 0
    frames = read_frames(own)
    assert len(frames) == 2
    assert all(frame.run_time_ms > 0 and len(frame.lanes) == 2 for frame in frames)
    _, text, _ = lanes(capsys, log, "--truth", own)
    assert cells(text, "lane points") == ["100.0", "1.0000", "0.0000", "0.0000"]


def test_written_lanes_score_perfectly_against_themselves(drive, tmp_path, capsys):
    own, again = tmp_path / "own.json", tmp_path / "again.json"
    lanes(capsys, drive, "--tusimple", own)
    code, text, _ = lanes(capsys, drive, "--truth", own, "--tusimple", again)
    assert code == 0
    assert cells(text, "lane points") == ["100.0", "1.0000", "0.0000", "0.0000"]
    assert cells(text, "lanes at IoU 0.5") == ["100.0", "1.0000", "1.0000", "1.0000", "6", "0", "0"]
    assert again.read_bytes() == own.read_bytes()


@pytest.mark.parametrize(
    ("lane", "moved_px", "width", "accuracy"),
    [  # 20 px over the cosine; tangent 3/4 means cosine 4/5
        (0.75 * ROWS, 24.9, 1280, 1.0),
        (0.75 * ROWS, 25.1, 1280, 0.0),
        (np.full(len(ROWS), 300.0), 12.0, 1280, 1.0),
        (np.full(len(ROWS), 300.0), 12.0, 640, 0.0),
    ],
)
def test_the_threshold_depends_on_the_slope_and_the_width_of_the_image(lane, moved_px, width, accuracy):
    found, true = (LaneFrame("a", ROWS, (line,)) for line in (lane + moved_px, lane))
    assert score_frame(found, true, (width, 720)).tusimple.accuracy == accuracy


def test_hand_computed_scores(drive, tmp_path, capsys):
    """Frame 0: both right; 1: one right, one wrong; 2: five true lanes, one is forgiven, two of four are found."""
    lines = [
        truth_line(STAMPS_NS[0], LEFT_PX, RIGHT_PX),
        truth_line(STAMPS_NS[1], LEFT_PX, 1100),
        truth_line(STAMPS_NS[2], 50, LEFT_PX, 600, RIGHT_PX, 1200),
    ]
    _, text, _ = lanes(capsys, drive, "--truth", truth_file(tmp_path, *lines))
    accuracy, fp, fn = (1 + 1 / 2 + 2 / 4) / 3, (0 + 1 / 2 + 0) / 3, (0 + 1 / 2 + 2 / 4) / 3
    assert cells(text, "lane points") == ["100.0", f"{accuracy:.4f}", f"{fp:.4f}", f"{fn:.4f}"]
    assert cells(text, "lanes at IoU 0.3") == ["100.0", "0.8333", "0.5556", "0.6667", "5", "1", "4"]


def test_true_frames_that_the_run_lacks_are_listed_and_score_as_empty(drive, tmp_path, capsys):
    far = [START_NS + k * STEP_NS for k in range(50, 62)]
    lines = [truth_line(stamp, LEFT_PX, RIGHT_PX) for stamp in [*STAMPS_NS, far[0]]]
    _, text, _ = lanes(capsys, drive, "--truth", truth_file(tmp_path, *lines))
    assert f"missing in the run, scored as empty: 1: any/{far[0]}.jpg\n" in text
    assert cells(text, "lane points") == ["75.0", "0.7500", "0.0000", "0.2500"]
    assert cells(text, "lanes at IoU 0.5")[4:] == ["6", "0", "2"]
    _, text, _ = lanes(capsys, drive, "--truth", truth_file(tmp_path, *lines[:3], *(truth_line(s, 5) for s in far)))
    assert text.count(".jpg") == 10
    assert "and 2 more" in text


def test_names_without_stamps_pair_in_order(drive, tmp_path, capsys):
    lines = [truth_line(k, LEFT_PX, RIGHT_PX, raw_file=f"clips/{k}/20.jpg") for k in range(3)]
    _, text, _ = lanes(capsys, drive, "--truth", truth_file(tmp_path, *lines), "--pair", "order")
    assert cells(text, "lane points") == ["100.0", "1.0000", "0.0000", "0.0000"]
    code, _, error = lanes(capsys, drive, "--truth", truth_file(tmp_path, *lines[:2]), "--pair", "order")
    assert code == 1
    assert error == f"error: {tmp_path}/truth.json: 2 lines; expected 3, one for each frame of the run\n"


def test_lanes_are_scaled_to_size(drive, tmp_path, capsys):
    lanes(capsys, drive, "--tusimple", tmp_path / "half.json", "--size", "640x360")
    half = read_frames(tmp_path / "half.json")[0]
    assert half.rows[-1] == 350
    np.testing.assert_allclose(half.lanes[0], 149.75, atol=0.01)  # pixel centres: (300 + 1/2) / 2 - 1/2


def test_an_image_too_small_for_any_row_gives_lines_without_points(drive, tmp_path, capsys):
    code, _, error = lanes(capsys, drive, "--tusimple", tmp_path / "small.json", "--size", "16x9")
    assert (code, error) == (0, "")
    lines = [json.loads(line) for line in (tmp_path / "small.json").read_text().splitlines()]
    assert [(line["lanes"], line["h_samples"]) for line in lines] == [([], [])] * 3


BAD = {
    "nonsense": "Invalid JSON",
    '{"raw_file": "a/1", "h_samples": [1]}': "lanes: missing",
    truth_line(1, lanes=[[1.0, 2.0]]): "lanes[0] has 2 columns; expected 56, one per h_sample",
    truth_line(1, lanes=[], h_samples=[]): "h_samples: List should have at least 1",
    truth_line(1, lanes=[[10**400] * len(ROWS)]): "lanes[0][0]: expected less than or equal to 1000000000",
    truth_line(1, raw_file="clips/20_a.jpg"): "raw_file 'clips/20_a.jpg' has no stamp; expected a stamp in ns",
    truth_line(STAMPS_NS[0]): "has the same stamp as",
}


@pytest.mark.parametrize("bad", BAD)
def test_a_bad_line_is_named_with_its_number(drive, tmp_path, capsys, bad):
    path = truth_file(tmp_path, truth_line(STAMPS_NS[0], LEFT_PX), bad)
    code, _, error = lanes(capsys, drive, "--truth", path)
    assert code == 1
    assert error.startswith(f"error: {path}:2: ")
    assert BAD[bad] in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("make", "items", "target", "said"),
    [
        (run_log, [], "out.json", "no /perception/lanes"),
        (write_log, [seen(START_NS, upright(LEFT_PX))], "out.json", "no calibration of camera 'camera'"),
        (run_log, [seen(START_NS, upright(LEFT_PX))], "a.mcap", "a.mcap: expected a name that ends in .json or .jsonl"),
    ],
)
def test_logs_without_lanes_or_camera_and_logs_as_target_are_errors(tmp_path, capsys, make, items, target, said):
    log = make(tmp_path / "a.mcap", items)
    before = log.read_bytes()
    code, _, error = lanes(capsys, log, "--tusimple", tmp_path / target)
    assert (code, said in error) == (1, True)
    assert log.read_bytes() == before


def test_an_empty_truth_and_a_truth_as_target_are_errors(drive, tmp_path, capsys):
    code, _, error = lanes(capsys, drive, "--truth", truth_file(tmp_path, ""))
    assert (code, "no lines" in error) == (1, True)
    path = truth_file(tmp_path, truth_line(STAMPS_NS[0], LEFT_PX))
    before = path.read_bytes()
    code, _, error = lanes(capsys, drive, "--truth", path, "--tusimple", path)
    assert (code, "is the file with the true lanes" in error) == (1, True)
    assert path.read_bytes() == before
    assert lanes(capsys, drive, "--truth", tmp_path / "none.json")[0] == 1


def test_a_failed_export_leaves_no_file(tmp_path, capsys):
    broken = replace(seen(STAMPS_NS[1]), data=b"\xff\xff")
    log = run_log(tmp_path / "a.mcap", [seen(STAMPS_NS[0], upright(LEFT_PX)), broken])
    code, _, error = lanes(capsys, log, "--tusimple", tmp_path / "out.json")
    assert (code, error.startswith("error: "), "roadperc.Lanes" in error) == (1, True, True)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


columns = st.lists(st.one_of(st.just(np.nan), st.integers(0, 128000).map(lambda x: x / 100)), min_size=3, max_size=3)


@settings(max_examples=30)
@given(st.lists(columns, max_size=5), st.text(), st.floats(0, 1e6))
def test_a_frame_comes_back_as_it_was_written(tmp_path_factory, written, raw_file, run_time_ms):
    path = tmp_path_factory.getbasetemp() / "round-trip.json"
    frame = LaneFrame(raw_file, ROWS[:3], tuple(np.array(lane) for lane in written), run_time_ms)
    path.write_text(to_line(frame), encoding="utf-8")
    (found,) = read_frames(path)
    assert found.raw_file == raw_file
    assert found.run_time_ms == pytest.approx(run_time_ms, abs=0.006)
    np.testing.assert_array_equal(found.rows, frame.rows)
    np.testing.assert_array_equal(found.lanes, frame.lanes)
