import numpy as np
import polars as pl
import pytest

from roadperc_stream.cli import report
from roadperc_stream.cli.convert import main
from roadperc_stream.cli.replay import main as replay_main
from tests.tools.dump_writer import camera_pixels, png
from tests.tools.layouts.test_kitti_odometry import TR, numbers, projection, replaced
from tests.tools.layouts.test_kitti_raw import MOVES, TURN, oxts
from tests.tools.test_conversion import convert, failure, payloads, printed_by

IMU = np.array([[1, 0, 0, -0.8], [0, 1, 0, 0.3], [0, 0, 1, -0.9]])
CAR = "{truncated} 0 -1.6 2 3 9 8 1.5 1.8 4 0 1.65 10 -1.5707963268"
"""1.5 m high, 1.8 m wide, 4 m long, along the z axis; its lower side is on the road, 10 m ahead of camera 0."""
CAR_M = np.hypot(8, 0.15)
DONT_CARE = "DontCare -1 -1 -10 1 1 2 2 -1 -1 -1 -1000 -1000 -1000 -10"


def calibration(focal_px=8.0, names=("R0_rect:", "Tr_velo_to_cam:", "Tr_imu_to_velo:")):
    lines = [f"P{n}: {numbers(np.diag((focal_px / 8, 1, 1)) @ projection(x))}" for n, x in ((2, -0.06), (3, 0.47))]
    matrices = (TURN, TURN.T @ TR, IMU)
    return "\n".join(lines + [f"{name} {numbers(matrix)}" for name, matrix in zip(names, matrices, strict=True)]) + "\n"


def written(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def points(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(np.array([[10, 2, -1.7, 0.5]], "<f4").tobytes())


@pytest.fixture
def objects(tmp_path):
    """Frames 3 and 7 of the object benchmark, with other sizes and focal lengths; frame 7 has no points."""
    split = tmp_path / "object" / "training"
    for frame, width, focal_px in ((3, 16, 8.0), (7, 14, 9.0)):
        png(split / "image_2" / f"{frame:06d}.png", camera_pixels(frame)[:, :width])
        written(split / "calib" / f"{frame:06d}.txt", calibration(focal_px))
        written(split / "label_2" / f"{frame:06d}.txt", f"Car {CAR.format(truncated='0.00')}\n{DONT_CARE}\n")
    points(split / "velodyne" / "000003.bin")
    return tmp_path / "object"


@pytest.fixture
def tracking(tmp_path):
    """Sequences 0000 and 0001 of the tracking benchmark, frames 1 and 3; calibrations as KITTI wrote them first."""
    split = tmp_path / "tracking" / "training"
    for name in ("0000", "0001"):
        for frame in (1, 3):
            png(split / "image_02" / name / f"{frame:06d}.png", camera_pixels(frame))
            points(split / "velodyne" / name / f"{frame:06d}.bin")
        written(split / "calib" / f"{name}.txt", calibration(names=("R_rect", "Tr_velo_cam", "Tr_imu_velo")))
        labels = [f"{frame} 5 Van {CAR.format(truncated=1)}\n{frame} -1 {DONT_CARE}\n" for frame in range(3)]
        written(split / "label_02" / f"{name}.txt", "".join(labels))
        written(split / "oxts" / f"{name}.txt", "".join(f"{oxts(*move)}\n" for move in MOVES))
    return tmp_path / "tracking"


def test_each_object_frame_has_its_own_calibration_and_size(objects, tmp_path, capsys):
    printed = printed_by(capsys, objects, tmp_path / "out.mcap")
    assert "KITTI object, training, 2 frames" in printed
    assert "the frames are unrelated, 2 s apart" in printed
    found = payloads(tmp_path / "out.mcap")
    assert set(found) == {"image", "calibration", "detections", "lidar", "tf", "truth_objects"}
    assert [t for t, _, _ in found["image"]] == [6_000_000_000, 14_000_000_000]
    assert [(t, c.width, c.fx) for t, _, c in found["calibration"]] == [(6_000_000_000, 16, 8), (14_000_000_000, 14, 9)]
    edges = {edge.child: edge.parent_T_child for edge in found["tf"][0][2]}
    np.testing.assert_allclose(edges["camera_front"][:3, 3], (0, 0, 1.65), atol=1e-6)
    np.testing.assert_allclose(edges["lidar"][:3], [(1, 0, 0, -0.27), (0, 1, 0, -0.16), (0, 0, 1, 1.73)], atol=1e-6)


def test_labels_are_detections_and_true_objects(objects):
    found = payloads(convert(objects / "training"))
    for (_, _, (detection,)), (_, _, truth) in zip(found["detections"], found["truth_objects"], strict=True):
        assert (detection.label, detection.score) == ("Car", 1.0)
        box = detection.box_px
        assert (box.x_min, box.y_min, box.x_max, box.y_max) == (2, 3, 10, 9)
        (true,) = truth.objects
        assert true.distance_m == pytest.approx(CAR_M, abs=1e-6)
        assert true.detection.box_px == box


def test_a_tracking_sequence_has_ids_poses_and_stamps_of_its_numbers(tracking, tmp_path, capsys):
    out = tmp_path / "out.mcap"
    assert "found 0000, 0001; choose one with --sequence NN" in failure(capsys, tracking, out)
    printed = printed_by(capsys, tracking, out, "--sequence", "0001")
    assert "KITTI tracking, sequence 0001, 2 frames" in printed
    found = payloads(out)
    assert [t for t, _, _ in found["image"]] == [100_000_000, 300_000_000]
    assert [len(detections) for _, _, detections in found["detections"]] == [1, 0]
    ((true,), ()) = (truth.objects for _, _, truth in found["truth_objects"])
    assert (true.track_id, true.detection.label) == ("5", "Van")
    assert true.distance_m == pytest.approx(CAR_M, abs=1e-6)
    edges = {edge.child: edge.parent_T_child for edge in found["tf"][0][2]}
    np.testing.assert_allclose(edges["lidar"][:3], [(1, 0, 0, -0.27), (0, 1, 0, -0.16), (0, 0, 1, 1.73)], atol=1e-6)
    first, second = (pose.parent_T_child for _, _, pose in found["truth_pose"])
    np.testing.assert_allclose(first, np.eye(4), atol=1e-9)
    turned = MOVES[3][3] - MOVES[1][3]
    assert np.arctan2(second[1, 0], second[0, 0]) == pytest.approx(turned, abs=1e-6)


LABELS = "label_02/0001.txt"
VAN = f"1 5 Van {CAR.format(truncated=0)}"


@pytest.mark.parametrize(
    ("name", "line", "text", "said"),
    [
        (LABELS, 2, "1 5 Van 0", "label_02/0001.txt: line 3: expected 17 columns of a label, found 4"),
        (LABELS, 2, VAN.replace("1.65", "x"), "line 3: expected finite numbers"),
        (LABELS, 2, VAN.replace("1.8", "-1"), "line 3: expected a 3D box"),
        ("calib/0001.txt", 2, "R_rect 1 0 0", "calib/0001.txt: R_rect or R0_rect: expected 12 or 9 numbers, found 3"),
        ("oxts/0001.txt", 3, "49 8", "oxts/0001.txt: line 4: expected 30 numbers"),
    ],
)
def test_a_mistake_names_file_and_line(tracking, tmp_path, capsys, name, line, text, said):
    replaced(tracking / "training" / name, line, text)
    assert said in failure(capsys, tracking, tmp_path / "out.mcap", "--sequence", "0001")


@pytest.mark.parametrize(
    ("name", "distances_m"), [("kitti_object", [63.3, 58.7, 45.0]), ("kitti_tracking", [3.3, 7.0, 12.1])]
)
def test_the_real_sample_reports_distances_against_labels(data_dir, tmp_path, capsys, name, distances_m):
    log, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    assert main([str(data_dir / name), str(log), "--quiet"]) == 0
    assert replay_main([str(log), str(out), "--quiet", "--only", "surface,objects"]) == 0
    assert report.main([str(tmp_path / "out.metrics.parquet")]) == 0
    assert "object distance error" in capsys.readouterr().out
    found = pl.read_parquet(tmp_path / "out.objects.parquet")
    assert found["is_true"].all()
    assert found["true_distance_m"].null_count() == 0
    assert found["true_distance_m"].head(3).to_list() == pytest.approx(distances_m, abs=0.06)


def test_a_testing_split_has_no_labels(objects, tmp_path, capsys):
    (objects / "training").rename(objects / "testing")
    for path in (objects / "testing" / "label_2").iterdir():
        path.unlink()
    assert "label_2: 2 of 2 images have no labels" in printed_by(capsys, objects, tmp_path / "out.mcap")
    assert not {"detections", "truth_objects"} & set(payloads(tmp_path / "out.mcap"))


def test_a_frame_needs_its_calibration(objects, tmp_path, capsys):
    (objects / "training" / "calib" / "000007.txt").unlink()
    assert "calib/000007.txt" in failure(capsys, objects, tmp_path / "out.mcap")
