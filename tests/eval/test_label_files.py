"""The official label files of TuSimple and CULane score the runs of their converted datasets."""

import json
from functools import partial

import cv2
import numpy as np
import pytest

from roadperc_stream import log
from roadperc_stream.cli.convert import main as convert
from roadperc_stream.cli.lanes import main
from roadperc_stream.cli.replay import main as replay
from roadperc_stream.log import LogWriter
from roadperc_stream.schemas.record import IMAGES_RECORD
from tests.eval.tables import outcome
from tests.eval.test_lanes import cells, seen
from tests.logs import message

lanes = partial(outcome, main)
ROWS = list(range(60, 180, 10))
COLUMNS = {"clips/0313-1/60/20.jpg": (60, 200), "clips/0313-1/120/20.jpg": (110, 250)}
"""The labels' order is not that of the converted clips."""


def upright(x_px):
    return np.array([(x_px, y_px) for y_px in np.arange(179.0, 55.0, -1.0)])


def tusimple_set(folder, names=COLUMNS):
    lines = []
    for name in names:
        clip = (folder / name).parent
        clip.mkdir(parents=True)
        for number in (1, 2, 20):
            cv2.imwrite(str(clip / f"{number}.jpg"), np.full((180, 320, 3), 90, np.uint8))
        label = {"lanes": [[x] * len(ROWS) for x in COLUMNS[name]], "h_samples": ROWS, "raw_file": name}
        lines.append(json.dumps(label))
    path = folder / "label_data_0313.json"
    path.write_text("\n".join(lines))
    return path


def converted_run(folder, *options, found=None, records=True):
    """A run of the converted dataset that finds lines in the images of these names; by default no lane message."""
    recorded = folder.parent / "in.mcap"
    assert convert([str(folder), str(recorded), "--fov", "60", "--height", "1.5", "--quiet", *options]) == 0
    summary = log.summarise(recorded)
    stamps = next(dict(record.values) for record in summary.metadata if record.name == IMAGES_RECORD)
    with LogWriter(folder.parent / "out.mcap") as writer:
        writer.register(message(seen(0), 0).channel)
        for each in log.read(summary):
            writer.write(each)
        for name, columns in (found or {}).items():
            writer.write(message(seen(int(stamps[name]), *map(upright, columns), camera="camera_front"), 0))
        for record in summary.metadata if records else ():
            writer.describe(record)
    return folder.parent / "out.mcap"


@pytest.mark.parametrize("options", [(), ("--pair", "order")])
def test_the_label_file_of_tusimple_pairs_by_the_name_of_the_image(tmp_path, capsys, options):
    labels = tusimple_set(tmp_path / "tus")
    run = converted_run(tmp_path / "tus", found=COLUMNS)
    _, text, _ = lanes(capsys, run, "--truth", labels, *options)
    assert "2 true frames" in text
    assert cells(text, "lane points") == ["100.0", "1.0000", "0.0000", "0.0000"]


def test_labels_of_images_that_the_log_lacks_are_left_out_and_said(tmp_path, capsys):
    labels = tusimple_set(tmp_path / "tus")
    name = next(iter(COLUMNS))
    run = converted_run(tmp_path / "tus", "--sequence", "0313-1/60", found={name: COLUMNS[name]})
    _, text, _ = lanes(capsys, run, "--truth", labels)
    assert "1 true frame, " in text
    assert "left out: 1 line" in text


def test_the_number_of_an_image_is_no_stamp(tmp_path, capsys):
    name = next(iter(COLUMNS))
    labels = tusimple_set(tmp_path / "tus", [name])
    run = converted_run(tmp_path / "tus", found={name: COLUMNS[name]}, records=False)
    code, text, error = lanes(capsys, run, "--truth", labels)
    assert (code, text) == (1, "")
    assert "no line belongs to a frame of" in error


def test_a_run_without_lanes_scores_as_empty_and_says_so(tmp_path, capsys):
    labels = tusimple_set(tmp_path / "tus")
    converted_run(tmp_path / "tus")
    run = tmp_path / "run.mcap"
    assert replay([str(tmp_path / "in.mcap"), str(run), "--quiet"]) == 0
    _, text, _ = lanes(capsys, run, "--truth", labels)
    assert "2 true frames, lanes in 0" in text
    assert "no frame has a message on /perception/lanes" in text
    code, _, error = lanes(capsys, run, "--tusimple", tmp_path / "out.json")
    assert (code, "no frame has a message on /perception/lanes" in error) == (1, True)


VIDEO = "driver_23_30frame/05151640_0419.MP4"


def culane_set(folder, videos=(VIDEO, "driver_23_30frame/05151640_0420.MP4")):
    """Two videos of two images; lines begin at the bottom edge, as in CULane, and one image has none."""
    lists = []
    for video in videos:
        (folder / video).mkdir(parents=True)
        for number, columns in ((0, (60, 200)), (30, ())):
            cv2.imwrite(str(folder / video / f"{number:05d}.jpg"), np.full((180, 320, 3), 90, np.uint8))
            lines = (" ".join(f"{x} {y}" for y in range(180, 50, -10)) for x in columns)
            (folder / video / f"{number:05d}.lines.txt").write_text("\n".join(lines))
            lists.append(f"/{video}/{number:05d}.jpg /laneseg_label_w16/{video}/{number:05d}.png 1 1 0 0")
    path = folder / "list" / "train_gt.txt"
    path.parent.mkdir()
    path.write_text("\n".join(lists))
    return path


def test_a_list_of_culane_scores_the_run_of_one_video(tmp_path, capsys):
    truth = culane_set(tmp_path / "culane")
    found = {f"{VIDEO}/00000.jpg": (60, 200), f"{VIDEO}/00030.jpg": (100,)}
    run = converted_run(tmp_path / "culane", "--sequence", VIDEO, found=found)
    _, text, _ = lanes(capsys, run, "--truth", truth)
    assert "2 true frames" in text
    assert cells(text, "lanes at IoU 0.5")[4:] == ["2", "1", "0"]
    truth.write_text("/other/video.MP4/00000.jpg\n")
    code, _, error = lanes(capsys, run, "--truth", truth)
    assert (code, "names no image of the log" in error) == (1, True)
    truth.write_text(f"{VIDEO}/00000.jpg\n")
    (tmp_path / "culane" / VIDEO / "00000.lines.txt").write_text("1 2 x")
    code, _, error = lanes(capsys, run, "--truth", truth)
    assert (code, "00000.lines.txt:1: expected pairs of x and y" in error) == (1, True)
