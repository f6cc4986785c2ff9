import numpy as np
import pytest

from tests.tools.dump_writer import camera_pixels, png
from tests.tools.layouts.test_kitti_odometry import BASELINES_M, TR, numbers, projection, replaced
from tests.tools.test_conversion import convert, failure, payloads, printed_by

NAME = "2011_09_26_drive_0009_sync"
EARTH_M = 6_378_137.0
LATITUDE = 49.0
TURN = np.array([[np.cos(0.1), -np.sin(0.1), 0], [np.sin(0.1), np.cos(0.1), 0], [0, 0, 1]])
MOVES = [(0.0, 0.0, 0.0, 0.0), (1.0, 0.2, 0.1, 0.1), (2.0, 0.4, 0.1, 0.2), (3.0, 0.8, 0.0, 0.2)]
"""Metres to the north, west and up, and radians of yaw from the north to the left."""


def date(frame):
    return f"2011-09-26 13:02:25.{100_000_007 + frame * 103_000_000:09d}"


def oxts(north_m, west_m, up_m, yaw):
    latitude = LATITUDE + np.degrees(north_m / EARTH_M)
    longitude = 8.4 - np.degrees(west_m / EARTH_M / np.cos(np.radians(LATITUDE)))
    return f"{latitude:.12f} {longitude:.12f} {112 + up_m} 0 0 {np.pi / 2 + yaw:.12f} {' '.join('0' * 24)}"


@pytest.fixture
def day(tmp_path):
    """A date with its calibration and one drive of four frames: no time for image 2, and no points in frame 1."""
    folder = tmp_path / "2011_09_26"
    drive = folder / NAME
    for number in range(4):
        for frame in range(4):
            png(drive / f"image_0{number}" / "data" / f"{frame:010d}.png", camera_pixels(10 * number + frame))
        lines = [date(frame) if frame != 2 else "" for frame in range(4)]
        shifted = [line.replace(":25.", ":26.") for line in lines]
        (drive / f"image_0{number}" / "timestamps.txt").write_text("\n".join(shifted if number else lines) + "\n")
    for name in ("velodyne_points", "oxts"):
        (drive / name / "data").mkdir(parents=True)
    for frame, move in enumerate(MOVES):
        (drive / "oxts" / "data" / f"{frame:010d}.txt").write_text(oxts(*move) + "\n")
        if frame != 1:
            points = np.array([[10, 2, -1.7, 0.5]], "<f4").tobytes()
            (drive / "velodyne_points" / "data" / f"{frame:010d}.bin").write_bytes(points)
    (drive / "tracklet_labels.xml").touch()
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.95e-02"]
    for number, x_m in enumerate(BASELINES_M):
        lines += [f"D_0{number}: -0.3 0.2 0 0 0", f"P_rect_0{number}: {numbers(projection(x_m))}"]
    (folder / "calib_cam_to_cam.txt").write_text("\n".join([*lines, f"R_rect_00: {numbers(TURN)}"]))
    velodyne = TURN.T @ TR  # what R_rect_00 turns into TR
    for name, R, t in (("velo_to_cam", velodyne[:, :3], velodyne[:, 3]), ("imu_to_velo", np.eye(3), (-0.8, 0.3, -0.9))):
        text = f"calib_time: 15-Mar-2012 11:37:16\nR: {numbers(R)}\nT: {numbers(t)}\n"
        (folder / f"calib_{name}.txt").write_text(text)
    return folder


def test_a_drive_becomes_a_log_with_the_stamps_of_image_00(day, tmp_path, capsys):
    out = tmp_path / "out.mcap"
    printed = printed_by(capsys, day, out)
    assert f"KITTI raw, {NAME}, 3 frames" in printed
    for note in (
        "image_00/timestamps.txt: line 3: no time: 1 of 4 images are left out",
        "image_01/ is left out: image_02 is the front camera",
        "not motion-compensated",
        "tracklet_labels.xml is left out",
        "assumed: level cameras 1.65 m",
    ):
        assert note in printed
    found = payloads(out)
    assert set(found) == {"image", "calibration", "right", "right_calibration", "lidar", "tf", "truth_pose"}
    stamps_ns = [t for t, _, _ in found["image"]]
    assert np.diff(stamps_ns).tolist() == [103_000_000, 206_000_000]
    assert [t for t, _, _ in found["lidar"]] == [stamps_ns[0], stamps_ns[2]]
    np.testing.assert_array_equal(found["image"][2][2].decode_bgr(), camera_pixels(23))
    np.testing.assert_array_equal(found["right"][2][2].decode_bgr(), camera_pixels(33))
    edges = {edge.child: edge.parent_T_child for edge in found["tf"][0][2]}
    np.testing.assert_allclose(edges["camera_front"][:3, 3], (0, 0, 1.65), atol=1e-6)
    np.testing.assert_allclose(edges["lidar"][:3], [(1, 0, 0, -0.27), (0, 1, 0, -0.16), (0, 0, 1, 1.73)], atol=1e-6)


def test_poses_are_those_of_the_inertial_unit_moved_to_the_ego_frame(day):
    """The unit is 1.07 m behind the front camera, 0.14 m to the left of it and 0.83 m above the road."""
    poses = [pose.parent_T_child for _, _, pose in payloads(convert(day / NAME))["truth_pose"]]
    unit = np.array((-1.07, 0.14, 0.83, 1.0))
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-9)
    for pose, (north_m, west_m, up_m, yaw) in zip(poses, (MOVES[0], MOVES[1], MOVES[3]), strict=True):
        np.testing.assert_allclose((pose @ unit - unit)[:3], (north_m, west_m, up_m), atol=1e-5)
        assert np.arctan2(pose[1, 0], pose[0, 0]) == pytest.approx(yaw, abs=1e-9)


def test_without_their_calibration_lidar_and_poses_are_left_out(day, tmp_path, capsys):
    (day / "calib_velo_to_cam.txt").unlink()
    printed = printed_by(capsys, day, tmp_path / "out.mcap")
    assert "note: velodyne_points/ is left out: no calib_velo_to_cam.txt beside the drive" in printed
    assert "note: no true poses: no calib_velo_to_cam.txt or calib_imu_to_velo.txt" in printed
    (day / "calib_cam_to_cam.txt").unlink()
    assert "calib_cam_to_cam.txt: no such file" in failure(capsys, day, tmp_path / "other.mcap")


@pytest.mark.parametrize(
    ("name", "line", "text", "said"),
    [
        ("calib_velo_to_cam.txt", 2, "T: 1 2", "expected R with 9 and T with 3 numbers, found 9 and 2"),
        ("calib_cam_to_cam.txt", 7, "P_rect_02: 1 x", "line 8: P_rect_02: expected finite numbers"),
        (f"{NAME}/image_00/timestamps.txt", 1, "noon", "image_00/timestamps.txt: line 2: expected"),
        (f"{NAME}/oxts/data/0000000003.txt", 0, "49 8 112", "0000000003.txt: line 1: expected 30 numbers"),
    ],
)
def test_a_mistake_names_file_and_line(day, tmp_path, capsys, name, line, text, said):
    replaced(day / name, line, text)
    assert said in failure(capsys, day, tmp_path / "out.mcap")


def test_a_drive_is_chosen_by_number_or_by_its_folder(day, tmp_path, capsys):
    (day / "2011_09_26_drive_0001_sync" / "image_02").mkdir(parents=True)
    (tmp_path / "2011_09_28" / "2011_09_28_drive_0001_sync" / "image_02").mkdir(parents=True)
    out = tmp_path / "out.mcap"
    assert "found 0001, 0009; choose one with --sequence" in failure(capsys, day, out)
    assert NAME in printed_by(capsys, day, out, "--sequence", "0009", "--height", "1.5")
    again = tmp_path / "again.mcap"
    assert failure(capsys, tmp_path, again).count("_sync") == 3
    assert NAME in printed_by(capsys, tmp_path, again, "--sequence", NAME)
