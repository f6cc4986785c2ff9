import numpy as np
import pytest

from roadperc_stream.cli.convert import main
from roadperc_stream.tools.layouts import LAYOUTS
from roadperc_stream.tools.readers.frame_stamps import EPOCH_NS
from tests.tools.dump_writer import HEIGHT, WIDTH, camera_pixels, png
from tests.tools.test_conversion import convert, failure, payloads, printed_by

BASELINES_M = (0.0, 0.54, -0.06, 0.47)
"""Places of the four cameras along the rows of camera 0."""
TR = np.array([[0, -1, 0, 0.1], [0, 0, -1, -0.08], [1, 0, 0, -0.27]], float)


def numbers(matrix):
    return " ".join(f"{value:.12e}" for value in np.ravel(matrix))


def projection(x_m):
    return np.array([[8.0, 0, 7.5, -8.0 * x_m], [0, 8.0, 5.5, 0], [0, 0, 1, 0]])


def turned_left(angle, x_m, z_m):
    """First_T_camera: x right, z forward; a turn to the left is negative about y (down)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, -s, x_m], [0, 1, 0, 0], [s, 0, c, z_m]])


def write_sequence(folder, cameras=(0, 1, 2, 3), calibration="Tr"):
    for number in cameras:
        for frame in range(3):
            png(folder / f"image_{number}" / f"{frame:06d}.png", camera_pixels(10 * number + frame))
    lines = [f"P{number}: {numbers(projection(x_m))}" for number, x_m in enumerate(BASELINES_M)]
    lines += [f"Tr: {numbers(TR)}"] if calibration == "Tr" else []
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")
    (folder / "velodyne").mkdir()
    for frame in range(3):
        (folder / "velodyne" / f"{frame:06d}.bin").write_bytes(np.array([[10, 2, -1.7, 0.5]], "<f4").tobytes())
    return folder


@pytest.fixture
def dataset(tmp_path):
    """Two sequences with all sensors; only the first one has poses."""
    for name in ("00", "11"):
        sequence = write_sequence(tmp_path / "dataset" / "sequences" / name)
        (sequence / "times.txt").write_text("0.000000e+00\n1.036000e-01\n2.072000e-01\n")
    poses = [turned_left(0.0, 0.0, 0.0), turned_left(0.1, -0.05, 1.0), turned_left(0.2, -0.2, 2.0)]
    (tmp_path / "dataset" / "poses").mkdir()
    (tmp_path / "dataset" / "poses" / "00.txt").write_text("".join(f"{numbers(pose)}\n" for pose in poses))
    return tmp_path / "dataset"


def test_a_sequence_becomes_a_log_with_the_colour_pair(dataset):
    found = payloads(convert(dataset, "--sequence", "00"))
    assert set(found) == {"image", "calibration", "right", "right_calibration", "lidar", "tf", "truth_pose"}
    assert [t for t, _, _ in found["image"]] == [0, 103_600_000, 207_200_000]
    np.testing.assert_array_equal(found["image"][1][2].decode_bgr(), camera_pixels(21))
    np.testing.assert_array_equal(found["right"][1][2].decode_bgr(), camera_pixels(31))
    left, right = (found[role][0][2] for role in ("calibration", "right_calibration"))
    assert (left.width, left.height, left.fx, left.cx) == (WIDTH, HEIGHT, 8.0, 7.5)
    assert right.baseline_m == pytest.approx(0.53)


def test_mountings_and_poses_are_those_of_the_ego_frame(dataset):
    """The ego origin is on the road below image_2, which is 0.06 m to the left of the camera of the poses."""
    found = payloads(convert(dataset, "--sequence", "00"))
    edges = {edge.child: edge.parent_T_child for edge in found["tf"][0][2]}
    np.testing.assert_allclose(edges["camera_front"][:3, 3], (0, 0, 1.65), atol=1e-6)
    np.testing.assert_allclose(edges["camera_right"][:3, 3], (0, -0.53, 1.65), atol=1e-6)
    np.testing.assert_allclose(edges["lidar"][:3], [(1, 0, 0, -0.27), (0, 1, 0, -0.16), (0, 0, 1, 1.73)], atol=1e-6)
    first, second, _ = (pose.parent_T_child for _, _, pose in found["truth_pose"])
    np.testing.assert_allclose(first, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(second[:2, :2], [[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]], atol=1e-9)
    camera0_m = np.array((0, -0.06, 1.65))
    moved_m = np.array((1.0, 0.05, 0.0))
    expected = camera0_m + moved_m - second[:3, :3] @ camera0_m
    np.testing.assert_allclose(second[:3, 3], expected, atol=1e-9)


@pytest.mark.parametrize("inside", ["", "sequences", "sequences/00"])
def test_the_sequence_may_be_named_by_its_folder_or_by_a_folder_above(dataset, tmp_path, capsys, inside):
    option = () if inside.endswith("00") else ("--sequence", "00")
    printed = printed_by(capsys, dataset / inside, tmp_path / "out.mcap", *option)
    assert "KITTI odometry, sequence 00, 3 frames" in printed
    assert "note: image_0/ is left out: image_2 is the front camera" in printed
    assert "poses 3" in printed


def test_a_sequence_without_poses_times_and_transform_of_the_lidar(tmp_path, capsys):
    folder = write_sequence(tmp_path / "alone", cameras=(0,), calibration="")
    printed = printed_by(capsys, folder, tmp_path / "out.mcap")
    assert "10 Hz by frame number (KITTI)" in printed
    assert "note: velodyne/ is left out: calib.txt has no Tr" in printed
    assert "note: no true poses: neither " in printed
    found = payloads(tmp_path / "out.mcap")
    assert set(found) == {"image", "calibration", "tf"}
    assert [t for t, _, _ in found["image"]] == [0, 100_000_000, 200_000_000]


def replaced(path, line, text):
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:line], text, *lines[line + 1 :]]))


@pytest.mark.parametrize(
    ("name", "line", "text", "said"),
    [
        ("sequences/00/calib.txt", 2, "P2: 1 2 x", "calib.txt: line 3: P2: expected finite numbers"),
        ("sequences/00/calib.txt", 2, "P2: 1 2 3", "calib.txt: P2: expected 12 or 9 numbers, found 3 numbers"),
        ("sequences/00/calib.txt", 2, "", "calib.txt: P2: expected 12 or 9 numbers, found no such line"),
        ("sequences/00/calib.txt", 3, f"P3: {numbers(projection(-0.5))}", "the right camera is 0.44 m to the left"),
        ("sequences/00/times.txt", 2, "", "times.txt: line 3: no time for image 2"),
        ("sequences/00/times.txt", 2, "0.05", "times.txt: line 3: frame 2 is not later than frame 1"),
        ("poses/00.txt", 1, "1 0 0", "poses/00.txt: line 2: expected 12 finite numbers, found 3"),
        ("poses/00.txt", 1, "nan " + "1 " * 11, "poses/00.txt: line 2: expected finite numbers"),
    ],
)
def test_a_mistake_names_file_and_line(dataset, tmp_path, capsys, name, line, text, said):
    replaced(dataset / name, line, text)
    assert said in failure(capsys, dataset, tmp_path / "out.mcap", "--sequence", "00")


def test_options_that_do_not_fit_are_refused(dataset, tmp_path, capsys):
    out = tmp_path / "out.mcap"
    assert "found 00, 11; choose one with --sequence NN" in failure(capsys, dataset, out)
    assert "no sequence 05; found 00, 11" in failure(capsys, dataset, out, "--sequence", "05")
    assert "--fov is not an option for it" in failure(capsys, dataset, out, "--sequence", "00", "--fov", "90")
    assert "times.txt has the stamps" in failure(capsys, dataset, out, "--sequence", "00", "--rate", "5")
    stated = "--sequence chooses a sequence of a dataset, and this is a dump"
    assert stated in failure(capsys, dataset, out, "--layout", "dump", "--sequence", "00")
    assert "or remove --layout to detect it" in failure(capsys, dataset / "poses", out, "--layout", "kitti-odometry")
    assert len(set(LAYOUTS)) == len(LAYOUTS)


def test_the_real_sequence_has_its_true_poses(data_dir, tmp_path):
    log = tmp_path / "in.mcap"
    assert main([str(data_dir / "kitti_odometry"), str(log), "--quiet"]) == 0
    found = payloads(log)
    assert [t + EPOCH_NS for t, _, _ in found["truth_pose"]] == [EPOCH_NS + 100_000_000 * k for k in range(51)]
    places_m = np.loadtxt(data_dir / "kitti_odometry" / "poses.txt")[:, 3::4]
    origins = [pose.parent_T_child @ (0, 0, 1.65, 1) for _, _, pose in found["truth_pose"]]
    np.testing.assert_allclose(np.array(origins)[:, :3] - (0, 0, 1.65), places_m[:, [2, 0, 1]] * (1, -1, -1), atol=1e-6)


def test_missing_images_are_counted(dataset, tmp_path, capsys):
    (dataset / "sequences/00/image_2/000001.png").unlink()
    (dataset / "sequences/00/image_3/000001.png").unlink()
    assert "note: 1 image missing between 0 and 2" in printed_by(
        capsys, dataset, tmp_path / "out.mcap", "--sequence", "00"
    )


def test_poses_that_are_no_text_are_named(dataset, tmp_path, capsys):
    (dataset / "poses/00.txt").write_bytes(b"1\xff")
    said = failure(capsys, dataset, tmp_path / "out.mcap", "--sequence", "00")
    assert "00.txt: not a text file in UTF-8: invalid start byte at byte 1" in said
