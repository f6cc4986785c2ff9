import pytest

from roadperc_stream.tools.readers.image_files import UnreadableFrameError, read_header
from roadperc_stream.tools.readers.pixel_files import load_pixels

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
