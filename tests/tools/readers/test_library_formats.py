"""Depth in EXR and HDF5 files, points in LAS files: written by the libraries, read by the converter."""

import io
import sys

import h5py
import laspy
import numpy as np
import OpenEXR
import pytest

from roadperc_stream.errors import DumpError
from roadperc_stream.tools.readers.depth_files import depth_encoding, depth_metres
from roadperc_stream.tools.readers.image_files import UnreadableFrameError
from roadperc_stream.tools.readers.pixel_files import file_size, load_pixels
from roadperc_stream.tools.readers.point_files import load_points, points_kind

DEPTH_M = np.array([[2.5, 40.0, 0.0], [900.0, 7.25, 1.5]], np.float32)


def exr(path, channels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: OpenEXR.Channel(values) for name, values in channels.items()}).write(str(path))
    return path


def hdf5(path, arrays):
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values
    return path


def las(points, intensity):
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales = [0.001] * 3
    data = laspy.LasData(header)
    data.x, data.y, data.z = points.T
    data.intensity = intensity
    return data


GREY = np.ones((2, 3), np.float32)
FILES = {
    "only channel": lambda p: exr(p, {"W": DEPTH_M}),
    "Blender's layers": lambda p: exr(p, {"View.Depth.Z": DEPTH_M, "View.R": GREY, "View.G": GREY, "View.B": GREY}),
    "half floats in colours": lambda p: exr(p, {"RGB": np.dstack([DEPTH_M] * 3).astype(np.float16)}),
    "only array": lambda p: hdf5(p, {"colors": np.zeros((2, 3, 3), np.uint8), "a/b": DEPTH_M}),
    "named array": lambda p: hdf5(p, {"depth": DEPTH_M, "classes": np.ones((2, 3), np.uint8)}),
}


@pytest.mark.parametrize("name", FILES)
def test_depth_comes_back(tmp_path, name):
    path = FILES[name](tmp_path / "0.exr")
    assert (file_size(path), depth_encoding([path])) == (None, "metres")
    found = depth_metres(load_pixels(path), "metres")
    np.testing.assert_array_equal(found, np.where(DEPTH_M > 0, DEPTH_M, np.nan))


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_points_come_back_right_handed(tmp_path, suffix):
    points = np.array([[10.0, -2.0, -2.4], [20.5, 1.5, 0.25]])
    path = tmp_path / f"0{suffix}"
    las(points, np.array([0, 7], np.uint16)).write(str(path))
    assert points_kind(path) == "las, left-handed"
    np.testing.assert_allclose(load_points(path), [[10.0, 2.0, -2.4, 0.0], [20.5, -1.5, 0.25, 7.0]], rtol=1e-6)


def content(make, path):
    make(path)
    return path.read_bytes()


def laz(path):
    las(np.zeros((4, 3)), np.zeros(4, np.uint16)).write(str(path))


@pytest.mark.parametrize("name", ["0.exr", "0.h5", "0.laz"])
@pytest.mark.parametrize("cut", [lambda b: b[:60], lambda b: b[:-30], lambda b: b[:90] + b"\xff" * 200 + b[290:]])
def test_a_damaged_file_is_named(tmp_path, name, cut, capfd):
    makers = {"0.exr": FILES["only channel"], "0.h5": FILES["only array"], "0.laz": laz}
    path = tmp_path / name
    path.write_bytes(cut(content(makers[name], tmp_path / f"whole_{name}")))
    with pytest.raises(UnreadableFrameError, match=name.replace(".", r"\.")):
        (load_points if name == "0.laz" else load_pixels)(path)
    capfd.readouterr()  # OpenEXR prints its own warnings


@pytest.mark.parametrize("name", ["OpenEXR", "h5py", "laspy"])
def test_without_the_library_the_error_names_the_command(tmp_path, monkeypatch, name):
    makers = {"OpenEXR": FILES["only channel"], "h5py": FILES["only array"], "laspy": laz}
    path = tmp_path / "0.laz"
    makers[name](path)
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DumpError, match=rf"0\.laz: {name} is not installed; pip install '\.\[recordings\]'"):
        (load_points if name == "laspy" else load_pixels)(path)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda p: exr(p, {"A": DEPTH_M, "B": DEPTH_M}), "expected one array of depth, found A, B"),
        (lambda p: hdf5(p, {"a": DEPTH_M, "b": DEPTH_M}), "expected one array of depth, found a, b"),
        (lambda p: hdf5(p, {"colours": np.zeros((2, 3, 3))}), "expected one array of depth, found none"),
    ],
)
def test_several_arrays_are_an_error(tmp_path, make, words):
    with pytest.raises(UnreadableFrameError, match=words):
        load_pixels(make(tmp_path / "0.x"))


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    with h5py.File(tmp_path / "0.h5", "w") as file:
        file.create_dataset("depth", (100_000, 100_000), np.float32, chunks=(10, 10))
    with pytest.raises(UnreadableFrameError, match="10000000000 pixels, expected at most 40000000"):
        load_pixels(tmp_path / "0.h5")
    stream = io.BytesIO()
    las(np.zeros((4, 3)), np.zeros(4, np.uint16)).write(stream)
    data = bytearray(stream.getvalue())
    data[107:111] = (2**31).to_bytes(4, "little")
    (tmp_path / "0.las").write_bytes(data)
    with pytest.raises(UnreadableFrameError, match="2147483648 points, expected at most 10000000"):
        load_points(tmp_path / "0.las")
