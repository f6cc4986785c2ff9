import contextlib
import io

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roadperc_stream.formats.images import encode_indices
from roadperc_stream.tools.readers.image_files import UnreadableFrameError, read_header
from roadperc_stream.tools.readers.pixel_files import load_pixels
from tests.tools.dump_writer import camera_pixels


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
