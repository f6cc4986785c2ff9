"""TuSimple and CULane: labelled pixels become true lanes, and come back as the labels."""

import json

import cv2
import numpy as np
import pytest

from roadperc_stream.cli.convert import main
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera, inverse, mounting, project, transform
from roadperc_stream.tools.layouts import culane, tusimple
from roadperc_stream.tools.layouts.dataset import ConvertOptions
from roadperc_stream.tools.layouts.known import KNOWN
from roadperc_stream.tools.layouts.lane_labels import true_lanes, vanishing_point
from tests.tools.test_conversion import payloads

CAMERA = Camera("camera_front", 320, 180, 160.0, 160.0, 159.5, 89.5)
"""A field of view of 90 degrees."""
MOUNTED = mounting(z=1.4, pitch=5.0, yaw=-1.0)
OPTIONS = ConvertOptions(fov_deg=90.0, height_m=1.4)
ROWS = np.arange(80.0, 180.0, 5.0)
OFFSETS_M = (5.3, 1.8, -1.9, -5.5)


def line_px(offset_m, heading, curvature, camera=CAMERA, ego_T_camera=MOUNTED):
    """(N, 2) pixels of a line y = offset + heading x + curvature x^2 / 2 on the road, far end first, as in CULane."""
    x = np.arange(50.0, 3.0, -0.5)
    points = np.column_stack((x, offset_m + heading * x + curvature * x**2 / 2, np.zeros_like(x)))
    found = project(camera, transform(inverse(ego_T_camera), points))
    return found[((found >= 0) & (found < camera.size[::-1])).all(axis=1)]


def read(layout, folder, options=OPTIONS):
    """Return the dataset of a folder, and the notes."""
    request = layout.LAYOUT.request(folder, options)
    return layout.LAYOUT.read(request), request.notes


def labels():
    return [line_px(offset_m, 0.0, 0.0) for offset_m in OFFSETS_M]


def culane_folder(folder, frames=3, lines=None):
    folder.mkdir(parents=True)
    for number in range(0, frames * 30, 30):
        cv2.imwrite(str(folder / f"{number:05d}.jpg"), np.full((180, 320, 3), 90, np.uint8))
        text = "\n".join(" ".join(f"{v:.3f}" for v in line.ravel()) for line in lines or labels())
        (folder / f"{number:05d}.lines.txt").write_text(text)
    return folder


def tusimple_folder(folder, clips=("0313-1/60", "0531/7")):
    labelled = []
    for clip in clips:
        (folder / "clips" / clip).mkdir(parents=True)
        for number in (1, 2, 20):
            cv2.imwrite(str(folder / "clips" / clip / f"{number}.jpg"), np.full((180, 320, 3), 90, np.uint8))
        columns = [np.interp(ROWS, *line[:, ::-1].T, left=-2, right=-2) for line in labels()]
        lanes = [[round(float(u), 3) for u in lane] for lane in columns]
        raw_file = f"clips/{clip}/20.jpg"
        labelled.append(json.dumps({"lanes": lanes, "h_samples": ROWS.tolist(), "raw_file": raw_file}))
    (folder / "label_data_0313.json").write_text("\n".join(labelled))
    return folder


@pytest.mark.parametrize("state", [(1.8, 0.0, 0.0), (1.7, 0.02, 0.0), (2.0, -0.01, 0.004)])
def test_labels_become_the_road_they_were_projected_from(state):
    lanes = true_lanes([line_px(*state), line_px(-1.9, 0.0, 0.0), line_px(5.3, 0.0, 0.0)], CAMERA, MOUNTED)
    left, right = lanes.side("left"), lanes.side("right")
    np.testing.assert_allclose((left.offset_m, left.heading, left.curvature_per_m), state, atol=1e-6)
    np.testing.assert_allclose((right.offset_m, right.heading, right.curvature_per_m), (-1.9, 0, 0), atol=1e-6)
    back = project(CAMERA, transform(inverse(MOUNTED), left.line_ego_m))
    np.testing.assert_allclose(back, line_px(*state)[::-1], atol=1e-6)


def test_straight_lines_meet_in_the_vanishing_point():
    u, v = vanishing_point(labels())
    pitch, yaw = np.radians(5.0), np.radians(-1.0)
    np.testing.assert_allclose(
        (u, v), (159.5 + 160 * np.tan(yaw) / np.cos(pitch), 89.5 - 160 * np.tan(pitch)), atol=1e-6
    )
    assert vanishing_point(labels()[:1]) is None
    assert vanishing_point([]) is None


@pytest.mark.parametrize(
    ("make", "layout", "count"),
    [(culane_folder, culane, 3), (tusimple_folder, tusimple, 2)],
    ids=["culane", "tusimple"],
)
def test_a_folder_is_detected_and_gives_true_lanes(tmp_path, make, layout, count):
    folder = make(tmp_path / "data")
    assert next(known for known in KNOWN.values() if known.fits(folder)) is layout.LAYOUT
    dataset, notes = read(layout, folder)
    assert len(dataset.truth.lanes) == count
    for lanes in dataset.truth.lanes.values():
        found = [(side.offset_m, side.heading) for side in lanes.boundaries]
        np.testing.assert_allclose(found, [(1.8, 0.0), (-1.9, 0.0)], atol=0.02)
    np.testing.assert_allclose(dataset.rig.transforms[0].parent_T_child, MOUNTED, atol=1e-3)
    assert any("pitch 5.0" in note and "vanishing point" in note for note in notes)


def test_stamps_and_sequences(tmp_path):
    dataset, _ = read(tusimple, tusimple_folder(tmp_path / "t"))
    first = next(iter(dataset.stamps_ns.values()))
    assert [(ns - first) / 1e9 for ns in dataset.stamps_ns.values()] == [0.0, 0.05, 0.95, 3.0, 3.05, 3.95]
    one, _ = read(tusimple, tmp_path / "t", ConvertOptions(fov_deg=90.0, sequence="0531"))
    assert [path.parent.name for path in one.sensors["image"].files.values()] == ["7"] * 3
    for name in ("a/0.MP4", "b/1.MP4"):
        culane_folder(tmp_path / "c" / name)
    with pytest.raises(DumpError, match=r"expected one sequence, found a/0\.MP4, b/1\.MP4"):
        read(culane, tmp_path / "c")
    dataset, notes = read(culane, tmp_path / "c", ConvertOptions(fov_deg=90.0, sequence="b/1.MP4"))
    assert np.diff([*dataset.stamps_ns.values()]).tolist() == [1_000_000_000] * 2
    assert any("assumed: camera 1.5 m above the road" in note for note in notes)


def test_a_stated_mounting_is_used(tmp_path):
    folder = culane_folder(tmp_path / "c")
    pose = {"x": 0, "y": 0, "z": 1.4, "roll": 0, "pitch": -5, "yaw": 1}  # left-handed, as in CARLA
    (folder / "calibration.json").write_text(json.dumps({"fov_deg": 90, "mounting": {"rgb": pose}}))
    dataset, notes = read(culane, folder, ConvertOptions())
    np.testing.assert_allclose(dataset.rig.transforms[0].parent_T_child, MOUNTED, atol=1e-9)
    assert not any("vanishing" in note for note in notes)


@pytest.mark.parametrize(
    ("lanes", "rows", "raw_file", "words"),
    [
        ("[[1]]", "[1, 2]", "clips/a/1.jpg", "line 1: expected a column of each lane"),
        ("[]", "[]", "clips/a/1.jpg", "the labels name no image in clips/"),
    ],
)
def test_a_wrong_label_of_tusimple_is_named(tmp_path, lanes, rows, raw_file, words):
    (tmp_path / "clips").mkdir()
    label = f'{{"raw_file": "{raw_file}", "lanes": {lanes}, "h_samples": {rows}}}'
    (tmp_path / "label_data_0313.json").write_text(label)
    with pytest.raises(DumpError, match=words):
        read(tusimple, tmp_path)


def test_lines_above_the_horizon_or_far_aside_are_no_boundary():
    lanes = true_lanes([np.array([[10.0, 5.0], [20.0, 9.0], [30.0, 12.0]]), line_px(6.0, 0, 0)], CAMERA, MOUNTED)
    assert lanes.boundaries == ()
    assert true_lanes([np.empty((0, 2))], CAMERA, MOUNTED).boundaries == ()


@pytest.mark.parametrize("text", ["1 2 3", "1 x", "1 nan"])
def test_a_wrong_line_of_culane_is_named(tmp_path, text):
    folder = culane_folder(tmp_path / "c")
    (folder / "00030.lines.txt").write_text(f"1 2\n{text}\n")
    with pytest.raises(DumpError, match=r"00030\.lines\.txt: line 2: expected"):
        read(culane, folder)


def test_the_log_has_the_true_lanes(tmp_path):
    out = tmp_path / "in.mcap"
    assert main([str(culane_folder(tmp_path / "c")), str(out), "--fov", "90", "--height", "1.4", "--quiet"]) == 0
    found = payloads(out)
    assert set(found) == {"image", "calibration", "tf", "truth_lanes"}
    assert [round(lanes.side("right").offset_m, 2) for _, _, lanes in found["truth_lanes"]] == [-1.9] * 3
