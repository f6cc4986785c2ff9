"""Read a lidar's points from all formats, each with its own axes."""

import io

import numpy as np
import pytest

from roadperc_stream.tools.readers.image_files import UnreadableFrameError
from roadperc_stream.tools.readers.point_files import load_points, points_kind

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


def npy_of(header):
    """A .npy file with any text for its header, and 4000 bytes."""
    text = f"{header}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(4000)


def header_of(shape):
    return npy_of(f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("000000.ply", CARLA),
        ("000000.PLY", CARLA),
        ("1.ply", CARLA.replace("\n", "\r\n")),
        ("1.ply", CARLA.replace("format", "comment no end_header\nformat")),
        ("1.ply", binary("float", "<f4")),
        ("1.ply", binary("double", "<f8")),
        ("1.ply", binary("float32", "<f4", extra="element face 1\nproperty list uchar int n\n", body=b"\x00" * 9)),
        ("1.npy", npy(LEFT_HANDED)),
        ("1.npy", npy(np.asfortranarray(LEFT_HANDED))),
        ("1.npy", npy(LEFT_HANDED.astype(">f8"))),
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


def on_windows(ply):
    """The lines of a PLY header end in two bytes; a binary body stays as it is."""
    header, end, body = ply.partition(b"end_header\n")
    return (header + end).replace(b"\n", b"\r\n") + body


def test_a_points_first_byte_is_no_line_end(tmp_path):
    """The points follow the header at once, whatever their bytes."""
    points = np.frombuffer(b"\r\n\r\n" * 4, "<f4").reshape(1, 4)
    content = binary("float", "<f4", points)
    for path in (written(tmp_path, "1.ply", content), written(tmp_path, "2.ply", on_windows(content))):
        np.testing.assert_array_equal(load_points(path), points * np.float32([1, -1, 1, 1]))


@pytest.mark.parametrize("name", ["1.ply", "2.ply", "1.npy"])
def test_coordinates_beyond_float32_are_infinite_without_a_warning(tmp_path, name):
    far = LEFT_HANDED.astype(float)
    far[0, 1] = 1e39
    text, content = CARLA.replace(" 2.0000", " 1e39"), {"2.ply": binary("double", "<f8", far), "1.npy": npy(far)}
    points = load_points(written(tmp_path, name, content.get(name, text)))
    expected = RIGHT_HANDED.copy()
    expected[0, 1] = -np.inf
    np.testing.assert_array_equal(points, expected)


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("1.ply", b"\x89PNG....", "starts with 8950.*, expected a PLY file"),
        ("1.ply", "ply\nformat ascii 1.0\n", "no end_header"),
        (
            "1.ply",
            CARLA.replace("ascii", "binary_big_endian"),
            "PLY format binary_big_endian, expected ascii or binary_l",
        ),
        ("1.ply", CARLA.replace("element vertex 2\n", ""), "expected the points .element vertex. first"),
        ("1.ply", CARLA.replace("vertex 2", "vertex two"), "element vertex two: expected a number of points"),
        ("1.ply", CARLA.replace("float32 z", "float32 depth"), "properties x, y, depth, I, expected x, y and z"),
        ("1.ply", CARLA.replace("vertex 2", "vertex 3"), "2 points, its header says 3"),
        ("1.ply", CARLA.replace("2.4000", "high"), "a coordinate is not a number"),
        ("1.ply", binary("float", "<f4")[:-1], "1 points, its header says 2"),
        ("1.npy", b"\x93NUMPY", "damaged .npy: EOF"),
        ("1.npy", npy(np.zeros((4, 2))), r"\(4, 2\), expected numbers of shape \(N, 3\)"),
        ("1.npy", npy(np.zeros((4, 4), bool)), "bool .4, 4., expected an array of plain numbers"),
        ("1.npy", npy(LEFT_HANDED)[:-1], "damaged .npy: EOF"),
        ("1.npy", header_of("(10000000000000, 4)"), "damaged .npy: "),
        ("1.npy", header_of("(-1, 4)"), "damaged .npy: "),
        ("1.npy", npy_of("{'descr': (), 'fortran_order': False, 'shape': (4, 4)}"), "damaged .npy"),
        ("1.bin", b"\x00" * 20, "20 bytes, expected points of 16 bytes"),
        ("1.csv", "1,2,3", "expected points as .ply, .npy, .bin, .las or .laz"),
    ],
)
def test_errors_name_the_file(tmp_path, name, content, fault):
    path = written(tmp_path, name, content)
    with pytest.raises(UnreadableFrameError, match=fault) as caught:
        load_points(path)
    assert str(path) in str(caught.value)


def test_points_without_intensities_have_three_columns(tmp_path):
    assert load_points(written(tmp_path, "1.npy", npy(LEFT_HANDED[:, :3]))).shape == (2, 3)
    without = CARLA.replace("property float32 I\n", "").replace(" 0.5000\n", "\n").replace(" 0.7500\n", "\n")
    np.testing.assert_allclose(load_points(written(tmp_path, "1.ply", without)), RIGHT_HANDED[:, :3])


def test_an_empty_scan_has_no_points(tmp_path):
    assert load_points(written(tmp_path, "1.ply", binary("float", "<f4", LEFT_HANDED[:0]))).shape == (0, 4)
    empty = CARLA.partition("end_header\n")[0].replace("vertex 2", "vertex 0") + "end_header\n"
    assert load_points(written(tmp_path, "2.ply", empty)).shape == (0, 4)
