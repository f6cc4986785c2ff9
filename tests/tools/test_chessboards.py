"""A camera calibrated from chessboards: after conversion their straight rows are straight.

``ROADPERC_ALL_PICTURES=1`` calibrates from all 18 pictures with corners, which takes half a minute.
"""

import os

import cv2
import numpy as np
import pytest
import yaml

from roadperc_stream import log
from roadperc_stream.cli.convert import main
from roadperc_stream.geometry import Camera
from tests.tools.dump_writer import camera_pixels, document, jpeg
from tests.tools.test_conversion import failure, payloads, printed_by

COLUMNS, ROWS = 9, 6
SIZE = (1280, 720)
ODD = (7, 15)
"""These pictures have 1281x721 pixels."""
PICTURES = (2, 3, 4, 6)
if "ROADPERC_ALL_PICTURES" in os.environ:
    PICTURES = tuple(number for number in range(2, 21) if number != 5)


def corners_in(grey):
    is_found, corners = cv2.findChessboardCornersSB(grey, (COLUMNS, ROWS), flags=cv2.CALIB_CB_EXHAUSTIVE)
    assert is_found
    return corners.reshape(ROWS, COLUMNS, 2)


def deviations_px(corners):
    """The largest distance from its line, for each row and column of corners."""
    lines = [line - line.mean(axis=0) for line in (*corners, *corners.transpose(1, 0, 2))]
    return np.array([np.abs(line @ np.linalg.svd(line)[2][1]).max() for line in lines])


def matrix(rows, columns, values):
    return {"rows": rows, "cols": columns, "data": [float(value) for value in np.ravel(values)]}


def camera_info(path, K, D, model="plumb_bob", **matrices):
    """Write the YAML that ROS' camera_calibration writes."""
    content = {
        "image_width": SIZE[0],
        "image_height": SIZE[1],
        "camera_name": "dashcam",
        "camera_matrix": matrix(3, 3, K),
        "distortion_model": model,
        "distortion_coefficients": matrix(1, np.size(D), D),
        "rectification_matrix": matrix(3, 3, np.eye(3)),
        "projection_matrix": matrix(3, 4, np.hstack((K, np.zeros((3, 1))))),
    }
    path.write_text(yaml.safe_dump({**content, **matrices}))
    return path


def test_rows_of_corners_are_straight_after_conversion(data_dir, tmp_path, capsys):
    boards = data_dir / "chessboards"
    pictures = {number: (boards / f"calibration{number}.jpg").read_bytes() for number in PICTURES}
    grey = {number: cv2.imdecode(np.frombuffer(data, np.uint8), 0) for number, data in pictures.items()}
    found = {number: corners_in(image) for number, image in grey.items()}
    used = [number for number in found if number not in ODD]
    board = np.array([(x, y, 0) for y in range(ROWS) for x in range(COLUMNS)], np.float32)
    flat = [found[number].reshape(-1, 1, 2) for number in used]
    error_px, K, D, _, _ = cv2.calibrateCamera([board] * len(used), flat, SIZE, None, None)
    assert error_px < 1
    folder, out = tmp_path / "boards", tmp_path / "in.mcap"
    folder.mkdir()
    for number, data in pictures.items():
        (folder / f"calibration{number}.jpg").write_bytes(data)
    whole, _ = cv2.getOptimalNewCameraMatrix(K, D, SIZE, 1)  # P shows the whole picture, so that no corner is cut off
    P = matrix(3, 4, np.hstack((whole, np.zeros((3, 1)))))
    yaml_file = camera_info(tmp_path / "ost.yaml", K, D, projection_matrix=P)
    assert "rectified from plumb_bob" in printed_by(
        capsys, folder, out, "--calibration", str(yaml_file), "--rate", "0.5"
    )
    written = payloads(out)
    ((_, _, camera),) = written["calibration"]
    assert camera == Camera(
        "camera_front", *SIZE, *(pytest.approx(whole[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    )
    assert len(written["image"]) == len(used)
    straight = [corners_in(image.grey) for _, _, image in written["image"]]
    after = dict(zip(used, map(deviations_px, straight), strict=True))
    assert np.median(np.concatenate(list(after.values()))) < 0.5
    for number in (2, 3, 4):
        assert deviations_px(found[number]).max() > 5
        assert after[number].max() < 3


K = np.array([[8.0, 0, 7.5], [0, 8.0, 5.5], [0, 0, 1]])
SMALL = {"image_width": 16, "image_height": 12}


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial", "equidistant"])
def test_every_model_is_rectified_to_the_projection_matrix(tmp_path, model):
    jpeg(tmp_path / "shots" / "1.jpg", camera_pixels())
    P = np.array([[6.0, 0, 7.0, 0], [0, 6.0, 5.0, 0], [0, 0, 1, 0]])
    D = {"plumb_bob": [0.1] * 5, "rational_polynomial": [0.1] * 8, "equidistant": [0.1] * 4}[model]
    info = camera_info(tmp_path / "a.yaml", K, D, model, projection_matrix=matrix(3, 4, P), **SMALL)
    out = tmp_path / "out.mcap"
    assert main([str(tmp_path / "shots"), str(out), "--quiet", "--calibration", str(info)]) == 0
    found = payloads(out)
    assert found["calibration"][0][2] == Camera("camera_front", 16, 12, 6.0, 6.0, 7.0, 5.0)
    maps = (K, np.array(D), np.eye(3), P[:, :3], (16, 12), cv2.CV_32FC1)
    make = cv2.fisheye.initUndistortRectifyMap if model == "equidistant" else cv2.initUndistortRectifyMap
    source = cv2.imread(str(tmp_path / "shots" / "1.jpg"))
    expected = cv2.remap(source, *make(*maps), cv2.INTER_LINEAR, borderValue=(0, 0, 0))
    assert np.abs(found["image"][0][2].bgr.astype(int) - expected).mean() < 12  # noise in a small JPEG


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"distortion_model": "division"}, "model 'division'; known: plumb_bob"),
        ({"camera_matrix": matrix(3, 4, np.zeros(12))}, "camera_matrix: expected 3x3, found 3x4"),
        ({"camera_matrix": matrix(3, 3, np.zeros(9))}, "camera_matrix: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"),
        ({"image_width": None}, "image_width"),
        ({"distortion_coefficients": matrix(1, 3, [0.1] * 3)}, "3 distortion coefficients, expected one of 4, 5"),
        ({"rectification_matrix": matrix(3, 3, np.ones(9))}, "an R that is not a rotation"),
    ],
)
def test_a_wrong_calibration_is_an_error_that_names_the_file(tmp_path, capsys, changes, words):
    jpeg(tmp_path / "shots" / "1.jpg", camera_pixels())
    info = camera_info(tmp_path / "ost.yaml", K, [0.1] * 5, **{**SMALL, **changes})
    message = failure(capsys, tmp_path / "shots", tmp_path / "out.mcap", "--calibration", info)
    assert f"{info}: " in message
    assert words in message


def test_without_distortion_images_keep_their_bytes(tmp_path):
    first = jpeg(tmp_path / "shots" / "1.jpg", camera_pixels())
    info = camera_info(tmp_path / "a.yaml", K, [0.0] * 5, **SMALL)
    out = tmp_path / "out.mcap"
    assert main([str(tmp_path / "shots"), str(out), "--quiet", "--calibration", str(info)]) == 0
    (message,) = log.read(log.summarise(out), topics=["/camera/front/image"])
    assert first.read_bytes() in message.data


@pytest.mark.parametrize("text", ["a: [", "- 1\n- 2\n", "", "\t"])
def test_what_is_not_a_camera_info_is_named(tmp_path, capsys, text):
    jpeg(tmp_path / "shots" / "1.jpg", camera_pixels())
    (tmp_path / "ost.yaml").write_text(text)
    message = failure(capsys, tmp_path / "shots", tmp_path / "o.mcap", "--calibration", tmp_path / "ost.yaml")
    assert "ost.yaml" in message


def test_the_calibration_of_another_resolution_is_an_error(tmp_path, capsys):
    jpeg(tmp_path / "shots" / "1.jpg", camera_pixels())
    info = camera_info(tmp_path / "ost.yaml", K, [0.1] * 5, image_width=32, image_height=24)
    message = failure(capsys, tmp_path / "shots", tmp_path / "out.mcap", "--calibration", info)
    assert "image is 16x12, expected 32x24" in message


def test_a_json_calibration_may_have_a_lens(tmp_path, capsys):
    jpeg(tmp_path / "shots" / "1.jpg", camera_pixels())
    lens = {"K": K.tolist(), "pixel_origin": "centre", "D": [-0.2, 0.1, 0, 0], "distortion_model": "plumb_bob"}
    document(tmp_path / "shots" / "calibration.json", lens)
    assert "rectified from plumb_bob" in printed_by(capsys, tmp_path / "shots", tmp_path / "out.mcap")
