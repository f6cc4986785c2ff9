"""Objects in scenarios with traffic options: path, whole boxes, instance ids."""

import shutil

import cv2
import numpy as np
import polars as pl

from roadperc_stream.cli.convert import main as convert
from roadperc_stream.cli.replay import main as replay
from roadperc_stream.config import ReplayConfig
from roadperc_stream.input import ReplaySource, open_input
from tests.tools.rendered import TAG


def test_the_car_ahead_is_in_the_path_until_the_lane_change(rendered):
    dump = rendered("--scene", "straight", "--change-lane", "left", "--seconds", "6", "--size", "320x240")
    places = [
        next((o["in_path"], round(o["lateral_m"], 1)) for o in dump.truth["objects"][name] if o["id"] == "leader:0")
        for name in dump.names
    ]
    assert places == [(True, 0.0)] * 4 + [(False, -3.6)] * 2


def test_crossing_cars_are_in_the_path(rendered):
    dump = rendered("--scene", "straight", "--crossing-cars", "--seconds", "4", "--rate", "5", "--weave", "0")
    across = [o for frame in dump.truth["objects"].values() for o in frame if o["id"].startswith("across")]
    sides = {np.sign(o["lateral_m"]) for o in across if abs(o["lateral_m"]) > 3}
    in_path = [o for o in across if o["in_path"]]
    assert sides == {1, -1}
    assert in_path
    assert all(abs(o["lateral_m"]) < 2.15 + 0.89 + 0.3 + 1e-6 for o in in_path)
    assert all(o["time_to_impact_s"] is None for o in across if not o["in_path"])


def test_parked_rows_leave_no_gaps(rendered):
    dump = rendered("--scene", "hill", "--parked-rows", "--seconds", "1", "--size", "320x240")
    numbers = [int(o["id"].split(":")[1]) for o in dump.truth["objects"]["000000"] if o["id"].startswith("parked1")]
    assert sorted(numbers) == list(range(min(numbers), min(numbers) + len(numbers)))
    assert len(numbers) >= 4
    assert all("in_path" in o for frame in dump.truth["objects"].values() for o in frame)


def test_whole_boxes_hold_what_is_seen_and_more(rendered):
    options = ("--scene", "town", "--parked-rows", "--seconds", "1", "--size", "640x480")
    seen, whole = rendered(*options), rendered(*options, "--whole-boxes")
    larger = 0
    for a, b in zip(seen.truth["objects"]["000000"], whole.truth["objects"]["000000"], strict=True):
        (x0, y0, x1, y1), (u0, v0, u1, v1) = a["box_px"], b["box_px"]
        assert u0 <= x0 + 1
        assert v0 <= y0 + 1
        assert u1 >= x1 - 1
        assert v1 >= y1 - 1
        assert 0 <= u0 < u1 <= 640
        assert 0 <= v0 < v1 <= 480
        assert a["distance_m"] == b["distance_m"]
        larger += (u1 - u0) * (v1 - v0) > 1.3 * (x1 - x0) * (y1 - y0)
    assert larger >= 4


def test_instance_masks_are_in_carlas_coding_and_keep_their_numbers(rendered):
    dump = rendered("--instances", "--seconds", "2")
    numbers = {}
    for name in dump.names:
        picture = cv2.imread(str(dump.folder / "instance_segmentation" / f"{name}.png"), cv2.IMREAD_UNCHANGED)
        assert (picture[..., 2] == dump.tags(name)).all()
        ids = picture[..., 1].astype(int) + 256 * picture[..., 0].astype(int)
        assert (ids[~np.isin(dump.tags(name), (TAG["car"], TAG["pedestrian"]))] == 0).all()
        for entry in dump.truth["objects"][name]:
            rows, columns = np.nonzero(ids == entry["instance_id"])
            assert entry["box_px"] == [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            assert numbers.setdefault(entry["id"], entry["instance_id"]) == entry["instance_id"]
    assert len(set(numbers.values())) == len(numbers) > 3


def test_the_truth_goes_through_the_log_into_the_columns(rendered, tmp_path):
    dump = rendered("--scene", "straight", "--lead-brakes", "--seconds", "4", "--size", "240x180")
    assert convert([str(dump.folder), str(tmp_path / "in.mcap")]) == 0
    assert replay([str(tmp_path / "in.mcap"), str(tmp_path / "out.mcap"), "--quiet"]) == 0
    frames = pl.read_parquet(tmp_path / "out.metrics.parquet")
    assert frames["true_lane_change"].to_list() == ["none"] * 4
    assert frames["true_lane_changes"].to_list() == [0] * 4
    expected = [
        min((o["time_to_impact_s"] for o in frame if o["time_to_impact_s"] is not None), default=None)
        for frame in dump.truth["objects"].values()
    ]
    assert frames["true_time_to_impact_s"].to_list() == expected
    assert expected[3] is not None
    objects = pl.read_parquet(tmp_path / "out.objects.parquet").filter(pl.col("true_in_path"))
    assert objects["true_lateral_m"].abs().max() < 2


def test_instance_masks_go_through_the_log_to_the_frame(rendered, tmp_path):
    dump = rendered("--instances", "--seconds", "2")
    assert convert([str(dump.folder), str(tmp_path / "in.mcap")]) == 0
    samples = list(open_input(ReplaySource(tmp_path / "in.mcap"), ReplayConfig()).samples())
    assert len(samples) == len(dump.names) == 2
    for name, sample in zip(dump.names, samples, strict=True):
        picture = cv2.imread(str(dump.folder / "instance_segmentation" / f"{name}.png"), cv2.IMREAD_UNCHANGED)
        ids = sample.frame.instance_image.ids
        assert {o["instance_id"] for o in dump.truth["objects"][name]} <= set(ids.ravel().tolist())
        np.testing.assert_array_equal(ids, picture[..., 1] + 256 * picture[..., 0].astype(int))


def test_grey_instance_masks_are_refused(rendered, tmp_path, capsys):
    dump = rendered("--instances", "--seconds", "2")
    shutil.copytree(dump.folder, tmp_path / "dump")
    grey = np.zeros((120, 160), np.uint8)
    cv2.imwrite(str(tmp_path / "dump" / "instance_segmentation" / "000001.png"), grey)
    assert convert([str(tmp_path / "dump"), str(tmp_path / "in.mcap")]) == 1
    assert "000001.png: expected masks as a PNG of red, green and blue" in capsys.readouterr().err
