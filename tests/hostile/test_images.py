"""Images of other formats, or with a hidden size, are refused before a decoder sees them."""

import ast
import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage

from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import images
from tests.hostile import inputs

ROOT = Path(__file__).parents[2]
DECODERS = (images.decode_bgr, images.decode_grey, images.image_size)
PICTURE = PillowImage.fromarray(np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8))


def packed(name, picture=PICTURE, **options):
    stream = io.BytesIO()
    picture.save(stream, name, **options)
    return stream.getvalue()


@pytest.mark.parametrize("folder", ["roadperc_stream", "tools", "eval"])
def test_every_call_of_pillow_names_the_formats(folder):
    calls = [
        (str(path), node.lineno, {keyword.arg for keyword in node.keywords})
        for path in (ROOT / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("Pillow.open", "PillowImage.open", "Image.open")
    ]
    assert [call for call in calls if "formats" not in call[2]] == []


@pytest.mark.parametrize(
    ("fault", "data"),
    {
        "image of format BMP: expected png, jpeg, webp; convert it": packed("BMP"),
        "image of format TIFF: expected png, jpeg, webp; convert it": packed("TIFF"),
        "bytes are not an image, they start with 25215053": inputs.POSTSCRIPT,
    }.items(),
)  # fmt: skip
def test_other_formats_are_refused(monkeypatch, fault, data):
    monkeypatch.setattr(cv2, "imdecode", None)
    monkeypatch.setattr(PillowImage, "open", None)
    for decoder in DECODERS:
        with pytest.raises(DecodeError, match=fault):
            decoder(data)
