import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry.cameras import pinhole_of_fov, pinhole_of_K
from roadperc_stream.input.projections import decompose_pair
from roadperc_stream.tools.readers.calibration_file import load_calibration
from tests.tools.dump_writer import document

K = [[640, 0, 640], [0, 640, 480], [0, 0, 1]]


def test_carlas_principal_point_counts_from_the_corner():
    assert pinhole_of_K(np.array(K, float), "corner") == (640, 640, 639.5, 479.5)
    assert pinhole_of_K(np.array(K, float), "centre") == (640, 640, 640, 480)


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3), st.floats(0.05, 2.0), st.floats(-50, 50))
def test_decomposing_a_pair_of_projections(yaw, pitch, roll, baseline_m, x):
    camera = np.array([[500.0, 0.0, 320.0], [0.0, 480.0, 240.0], [0.0, 0.0, 1.0]])
    R = Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_matrix()
    left = np.array([x, 2.0, -1.0])
    right = left + R.T @ [baseline_m, 0.0, 0.0]
    P = [camera @ np.column_stack((R, -R @ centre)) for centre in (left, right)]
    pair = decompose_pair("calibration.json", *P)
    np.testing.assert_allclose(pair.K_left, camera, atol=1e-6)
    np.testing.assert_allclose(pair.baseline_m, baseline_m, atol=1e-6)
    assert pair.along_rows


def test_the_courses_matrices_differ_along_another_axis():
    left = np.array([[640.0, 0, 640, 2176], [0, 480, 480, 552], [0, 0, 1, 1.4]])
    right = np.array([[640.0, 0, 640, 2176], [0, 480, 480, 792], [0, 0, 1, 1.4]])
    pair = decompose_pair("calibration.json", np.array(left, float), np.array(right, float))
    np.testing.assert_allclose(pair.baseline_m, 0.5)
    np.testing.assert_allclose(pair.K_left, [[640, 0, 640], [0, 480, 480], [0, 0, 1]])
    assert not pair.along_rows


P = [[640, 0, 640, 0], [0, 640, 480, 0], [0, 0, 1, 0]]


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ({"K": [640, 0, 640, 0, 640, 480, 0, 0, 1]}, "K: expected 3 rows of numbers"),
        ({"K": [[640, 0, float("nan")], [0, 640, 480], [0, 0, 1]]}, r"K\[0\]\[2\]: .*finite"),
        ({"K": [[-640, 0, 640], [0, 640, 480], [0, 0, 1]]}, "K: expected"),
        ({"K": [[640, 5, 640], [0, 640, 480], [0, 0, 1]]}, "K: expected"),
        ({"fov_deg": 180}, "fov_deg.*less than 180"),
        ({"width": "wide"}, "width: .*'wide'"),
        ({"mounting": {"rgb": {"z": 1.5, "hight": 2}}}, r"mounting\.rgb\.hight"),
        ({"mounting": {"rgb": {"x": 1.5}}}, r"mounting\.rgb\.z: missing"),
        ({"cameras": {"depth": {"K": [[0, 0, 0], [0, 1, 0], [0, 0, 1]]}}}, r"cameras\.depth\.K: expected"),
        ({"P_left": P}, "P_left and P_right: expected both"),
        ([], "expected keys with values"),
    ],
)
def test_malformed_values_name_file_and_key(tmp_path, content, fault):
    with pytest.raises(DumpError, match=fault) as caught:
        load_calibration(document(tmp_path / "calibration.json", content))
    assert "calibration.json" in str(caught.value)


@pytest.mark.parametrize(
    ("left", "right", "fault"), [(P, P, "one and the same centre"), (np.zeros((3, 4)), P, "P_left: expected a camera")]
)
def test_matrices_without_a_baseline_are_refused(left, right, fault):
    with pytest.raises(DumpError, match=fault):
        decompose_pair("calibration.json", np.array(left, float), np.array(right, float))


def test_field_of_view_agrees_with_K():
    assert pinhole_of_fov(90.0, 1280, 960) == pinhole_of_K(np.array(K, float), "corner")


def test_notes_are_ignored_and_known_keys_read(tmp_path):
    content = {"K": K, "note": "hello", "depth_encoding": "x", "rate_hz": 10, "mounting": {"rgb": {"z": 1.5}}}
    found = load_calibration(document(tmp_path / "calibration.json", content))
    assert found.rate_hz == 10
    assert found.mounting["rgb"].z == 1.5
    assert found.pixel_origin == "corner"
