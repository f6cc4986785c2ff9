import contextlib
import io

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roadperc_stream.formats.images import encode_indices
from roadperc_stream.tools.readers.image_files import UnreadableFrameError, read_header, require_whole
from roadperc_stream.tools.readers.pixel_files import load_pixels
from tests.tools.dump_writer import camera_pixels, jpeg, npy, png


def npy_bytes() -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.arange(12.0).reshape(3, 4))
    return stream.getvalue()


SAMPLES = {
    "png": cv2.imencode(".png", camera_pixels())[1].tobytes(),
    "jpeg": cv2.imencode(".jpg", camera_pixels())[1].tobytes(),
    "npy": npy_bytes(),
    "csv": b" 1, 2.5e-3, 3\n 4, 5, nan\n",
    "palette": encode_indices(np.eye(4, dtype=np.uint8), ((0, 0, 0), (128, 64, 128))),
}


OTHERS = {
    "empty file": b"",
    "BMP image": b"BM" + bytes(60),
    "WEBP image": b"RIFF\x00\x00\x00\x00WEBPVP8 ",
    "TIFF image": b"II*\x00" + bytes(60),
    "not an image": b"hello, I am a text\xff",
}


@pytest.mark.parametrize("what", OTHERS)
def test_anything_else_is_named(tmp_path, what):
    path = tmp_path / "000003.png"
    path.write_bytes(OTHERS[what])
    for read in (read_header, load_pixels):
        with pytest.raises(UnreadableFrameError, match=rf"000003\.png: {what}"):
            read(path)


@pytest.mark.parametrize(
    ("make", "form", "words"), [(png, "png", "png RGB 8 bit"), (jpeg, "jpeg", "jpeg colour")], ids=["png", "jpeg"]
)
def test_the_content_gives_the_format(tmp_path, make, form, words):
    path = make(tmp_path / "0.bmp", camera_pixels())
    assert read_header(path) == ((16, 12), words)
    assert require_whole(path, path.read_bytes()) == form


@pytest.mark.parametrize("make", [png, jpeg], ids=["png", "jpeg"])
@pytest.mark.parametrize("kept", [0.3, 0.7, 0.95])
def test_a_cut_file_is_unreadable(tmp_path, make, kept):
    path = make(tmp_path / "0", camera_pixels())
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    for read in (read_header, load_pixels):
        with pytest.raises(UnreadableFrameError, match="cut off"):
            read(path)


@pytest.mark.parametrize(
    ("text", "fault"), [("1, 2\n3\n", "not a table of numbers"), ("1,,2\n", "not a table"), ("\n \n", "empty")]
)
def test_broken_tables_are_unreadable(tmp_path, text, fault):
    path = tmp_path / "0.dat"
    path.write_text(text)
    with pytest.raises(UnreadableFrameError, match=fault):
        load_pixels(path)


def test_an_npy_without_an_image_is_unreadable(tmp_path):
    with pytest.raises(UnreadableFrameError, match="expected an image of numbers"):
        load_pixels(npy(tmp_path / "0.npy", np.zeros(4)))


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), kind=st.sampled_from(["png", "jpeg", "npy", "csv", "palette"]))
def test_damaged_files_are_read_or_stated(tmp_path, data, kind):
    content = bytearray(SAMPLES[kind])
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / "0"
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    with contextlib.suppress(UnreadableFrameError):
        load_pixels(path)
    with contextlib.suppress(UnreadableFrameError):
        read_header(path)
