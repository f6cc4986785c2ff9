"""A lidar's points in every file people keep them in, each with the axes of those who write it."""

import io

import numpy as np
import pytest

from roadperc_stream.tools.carla_dump.image_files import UnreadableFrameError
from roadperc_stream.tools.carla_dump.point_files import load_points, points_kind

LEFT_HANDED = np.array([[10.0, 2.0, -2.4, 0.5], [20.0, -1.5, 0.25, 0.75]], np.float32)
"""x forward, y right, z up, intensity."""
RIGHT_HANDED = LEFT_HANDED * np.array([1, -1, 1, 1], np.float32)
CARLA = """ply
format ascii 1.0
element vertex 2
property float32 x
property float32 y
property float32 z
property float32 I
end_header
10.0000 2.0000 -2.4000 0.5000
20.0000 -1.5000 0.2500 0.7500
"""


def written(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def npy(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def binary(kind, dtype, points=LEFT_HANDED, extra="", body=b""):
    header = "".join(f"property {kind} {name}\n" for name in ("x", "y", "z", "intensity"))
    text = f"ply\nformat binary_little_endian 1.0\ncomment made by hand\nelement vertex {len(points)}\n{header}{extra}"
    return f"{text}end_header\n".encode() + points.astype(dtype).tobytes() + body


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("000000.ply", CARLA),
        ("000000.PLY", CARLA),
        ("1.ply", binary("float", "<f4")),
        ("1.ply", binary("double", "<f8")),
        ("1.ply", binary("float32", "<f4", extra="element face 1\nproperty list uchar int n\n", body=b"\x00" * 9)),
        ("1.npy", npy(LEFT_HANDED)),
        ("1.npy", npy(np.hstack((LEFT_HANDED.astype(float), np.ones((2, 2)))))),
        ("1.bin", RIGHT_HANDED.astype("<f4").tobytes()),
    ],
)
def test_points_become_right_handed(tmp_path, name, content):
    path = written(tmp_path, name, content)
    points = load_points(path)
    assert points.dtype == np.float32
    np.testing.assert_allclose(points, RIGHT_HANDED, atol=1e-6)
    assert ("right-handed" in points_kind(path)) == (path.suffix == ".bin")


def test_points_without_intensities_have_three_columns(tmp_path):
    assert load_points(written(tmp_path, "1.npy", npy(LEFT_HANDED[:, :3]))).shape == (2, 3)
    without = CARLA.replace("property float32 I\n", "").replace(" 0.5000\n", "\n").replace(" 0.7500\n", "\n")
    np.testing.assert_allclose(load_points(written(tmp_path, "1.ply", without)), RIGHT_HANDED[:, :3])


def test_a_scan_of_nothing_is_one(tmp_path):
    assert load_points(written(tmp_path, "1.ply", binary("float", "<f4", LEFT_HANDED[:0]))).shape == (0, 4)
    empty = CARLA.partition("end_header\n")[0].replace("vertex 2", "vertex 0") + "end_header\n"
    assert load_points(written(tmp_path, "2.ply", empty)).shape == (0, 4)


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("1.ply", b"", "empty file"),
        ("1.ply", b"\x89PNG....", "starts with 8950.*, expected a PLY file"),
        ("1.ply", "ply\nformat ascii 1.0\n", "no end_header"),
        (
            "1.ply",
            CARLA.replace("ascii", "binary_big_endian"),
            "PLY format binary_big_endian, expected ascii or binary_l",
        ),
        ("1.ply", CARLA.replace("format ascii 1.0\n", ""), "PLY format none"),
        ("1.ply", CARLA.replace("element vertex 2\n", ""), "expected the points .element vertex. first"),
        ("1.ply", CARLA.replace("element vertex 2\n", "element face 1\nelement vertex 2\n"), "first in the PLY"),
        ("1.ply", CARLA.replace("vertex 2", "vertex two"), "element vertex two: expected a number of points"),
        ("1.ply", CARLA.replace("float32 I", "list uchar int I"), "property list uchar int I: expected"),
        ("1.ply", CARLA.replace("float32 z", "float32 depth"), "properties x, y, depth, I, expected x, y and z"),
        ("1.ply", CARLA.replace("vertex 2", "vertex 3"), "2 points, its header says 3"),
        ("1.ply", CARLA.replace("2.4000", "high"), "a point is no number"),
        ("1.ply", binary("float", "<f4")[:-1], "1 points, its header says 2"),
        ("1.npy", b"\x93NUMPY", "damaged .npy"),
        ("1.npy", npy(np.zeros((4, 2))), r"\(4, 2\), expected numbers of shape \(N, 3\)"),
        ("1.npy", npy(np.array(["a"])), "expected numbers of shape"),
        ("1.bin", b"\x00" * 20, "20 bytes, expected points of 16 bytes"),
        ("1.csv", "1,2,3", "expected points as .ply, .npy or .bin"),
    ],
)
def test_what_is_wrong_names_the_file(tmp_path, name, content, fault):
    path = written(tmp_path, name, content)
    with pytest.raises(UnreadableFrameError, match=fault) as caught:
        load_points(path)
    assert str(path) in str(caught.value)
