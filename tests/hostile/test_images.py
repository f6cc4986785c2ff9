"""Images of other formats, or with a hidden size, are refused before a decoder sees them."""

import ast
import io
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage

from roadperc_stream.config import LimitsConfig, load_config
from roadperc_stream.errors import ConfigError, DecodeError
from roadperc_stream.formats import images
from roadperc_stream.output import encoding
from tests import logs
from tests.commands import run_forked
from tests.fuzz.pictures import AVIF, POSTSCRIPT, png
from tests.hostile import inputs

ROOT = Path(__file__).parents[2]
DECODERS = (images.decode_bgr, images.decode_grey, images.decode_unchanged, images.image_size)
LISTED = LimitsConfig(image_formats=("png", "jpeg", "webp", "avif", "bmp", "gif"))
PICTURE = PillowImage.fromarray(np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8))


def packed(name, picture=PICTURE, **options):
    stream = io.BytesIO()
    picture.save(stream, name, **options)
    return stream.getvalue()


@pytest.fixture
def ghostscript(tmp_path):
    """A ``gs`` that records its start in a file, and an environment whose PATH begins with it."""
    folder, started = tmp_path / "bin", tmp_path / "started"
    folder.mkdir()
    (folder / "gs").write_text(f'#!/bin/sh\necho "$@" >> "{started}"\n')
    (folder / "gs").chmod(0o755)
    return started, {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}


@pytest.mark.promise("Messages", "No image starts a program")
@pytest.mark.commands
@pytest.mark.parametrize("data", [POSTSCRIPT, b"\xc5\xd0\xd3\xc6" + bytes(28) + POSTSCRIPT], ids=["PS", "DOS EPS"])
@pytest.mark.parametrize(
    "command",
    [
        "roadperc-replay in.mcap out.mcap", "roadperc-replay in.mcap out.mcap --overlay --debug",
        "roadperc-replay in.mcap out.mcap --template dump/rgb/1.png", "roadperc-info in.mcap",
        "roadperc-convert dump out.mcap",
    ],
)  # fmt: skip
def test_no_command_starts_a_program_for_an_image(tmp_path, ghostscript, command, data):
    started, variables = ghostscript
    picture = encoding.encode_image(logs.START_NS, "camera", "png", data)
    logs.write(tmp_path / "in.mcap", inputs.replaced("image", picture, frames=1))
    (tmp_path / "dump" / "rgb").mkdir(parents=True)
    (tmp_path / "dump" / "rgb" / "1.png").write_bytes(data)
    (tmp_path / "dump" / "calibration.json").write_text('{"width": 9, "height": 9, "fov_deg": 90}')
    done = run_forked(*command.split(), cwd=tmp_path, variables=variables)
    assert not started.exists(), started.read_text()
    assert "PostScript" in done.stdout + done.stderr or "info" in command, done.stdout + done.stderr


def test_the_ghostscript_trap_works(ghostscript, monkeypatch):
    """Pillow without a list of formats starts Ghostscript."""
    started, variables = ghostscript
    monkeypatch.setenv("PATH", variables["PATH"])
    monkeypatch.setattr("PIL.EpsImagePlugin.gs_binary", None)
    with pytest.raises(OSError), PillowImage.open(io.BytesIO(POSTSCRIPT)) as picture:  # noqa: PT011
        picture.load()
    assert started.exists()


@pytest.mark.promise("Messages", "Pillow gets an explicit format wherever it opens a file")
@pytest.mark.parametrize("folder", ["roadperc_stream", "tools", "eval"])
def test_every_call_of_pillow_names_the_formats(folder):
    calls = [
        (str(path), node.lineno, {keyword.arg for keyword in node.keywords})
        for path in (ROOT / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("Pillow.open", "PillowImage.open", "Image.open")
    ]
    assert [call for call in calls if "formats" not in call[2]] == []


@pytest.mark.promise("Messages", "Images other than PNG, JPEG and WebP are refused by name before a decoder sees them")
@pytest.mark.parametrize(
    ("name", "data"),
    {
        "AVIF": AVIF, "BMP": packed("BMP"), "GIF": packed("GIF"), "TIFF": packed("TIFF"),
        "JPEG 2000": packed("JPEG2000"), "PNM": packed("PPM"), "PostScript": POSTSCRIPT,
    }.items(),
)  # fmt: skip
def test_other_formats_are_refused_by_name(monkeypatch, name, data):
    can_be_added = name in {"AVIF", "BMP", "GIF"}
    todo = "convert it" + rf", or set limits\.image_formats=png,jpeg,webp,{name.lower()}$" * can_be_added
    monkeypatch.setattr(cv2, "imdecode", None)
    monkeypatch.setattr(PillowImage, "open", None)
    for decoder in DECODERS:
        with pytest.raises(DecodeError, match=rf"^image of format {name}: expected png, jpeg, webp; {todo}"):
            decoder(data)


@pytest.mark.promise("Messages", "`limits.image_formats` can add AVIF, BMP and GIF")
@pytest.mark.parametrize("name", ["PNG", "JPEG", "WEBP", "AVIF", "BMP", "GIF"])
def test_listed_formats_are_read(name):
    data = packed(name)
    assert images.decode_bgr(data, LISTED).shape == (24, 32, 3)
    assert images.image_size(data, LISTED) == (32, 24)
    small = LimitsConfig(image_formats=(name.lower(),), image_megapixels=0.01)
    assert images.decode_grey(data, small).shape == (24, 32)
    with pytest.raises(DecodeError, match=r"expected limits\.image_megapixels 0\.01"):
        images.decode_bgr(packed(name, PICTURE.resize((320, 240))), small)


@pytest.mark.promise("Messages", "Formats that can declare two sizes, such as TIFF and JPEG 2000, cannot be added")
def test_a_format_with_two_declared_sizes_cannot_be_listed():
    assert load_config(None, ("limits.image_formats=png,avif",)).limits.image_formats == ("png", "avif")
    with pytest.raises(ConfigError, match="image_formats"):
        load_config(None, ("limits.image_formats=png,tiff",))


@pytest.mark.promise("Messages", "The size of an AVIF image is read from its coded frames")
def test_the_size_of_an_avif_is_that_of_its_coded_frame():
    for decoder in DECODERS:
        with pytest.raises(DecodeError, match="AVIF of 96x72 with frames of 16000x16000"):
            decoder(AVIF, LISTED)


@pytest.mark.parametrize(("mode", "size"), [("L", (1, 1)), ("RGB", (5, 7)), ("RGBA", (32, 24)), ("RGB", (257, 128))])
def test_avifs_of_any_size_are_read(mode, size):
    data = packed("AVIF", PICTURE.resize(size).convert(mode))
    assert images.decode_bgr(data, LISTED).shape == (size[1], size[0], 3)


def without_reduced_header(data):
    at = data.index(b"mdat") + 4
    at = data.index(b"\x0a", at) + 2
    return data[:at] + bytes([data[at] & ~0x08]) + data[at + 1 :]


def in_pieces(data):
    """The AVIF with an empty first extent in its second item, the alpha channel."""
    at = data.index(b"iloc") + 12 + 14 + 4
    return data[:at] + b"\0\2" + data[at + 2 : at + 6] + bytes(4) + data[at + 10 :]


LAYOUTS = {
    "full header": without_reduced_header(AVIF),
    "pieces": in_pieces(packed("AVIF", PICTURE.convert("RGBA"))),
    "no data": AVIF.replace(b"mdat", b"free"),
    "more": AVIF + b"\0\0\0\x08free",
    "64 bits": AVIF + b"\0\0\0\x01mdat",
    "no places": AVIF.replace(b"iloc", b"iLoc"),
    "other places": AVIF.replace(b"iloc\0", b"iloc\1"),
    "two places": AVIF.replace(b"pict", b"iloc"),
    "cut": AVIF[:-1500],
    "exif": packed("AVIF", exif=b"Exif\0\0MM\0*\0\0\0\x08\0\0\0\0\0\0"),
    "film": packed("AVIF", save_all=True, append_images=[PICTURE.rotate(90)]),
}


@pytest.mark.promise("Messages", "An AVIF that is not a still picture is refused")
@pytest.mark.parametrize("changed", LAYOUTS.values(), ids=LAYOUTS)
def test_an_avif_that_is_not_a_still_picture_is_refused(changed):
    with pytest.raises(DecodeError, match=r"AVIF"):
        images.decode_bgr(changed, LISTED)


@pytest.mark.promise("Messages", "`limits.image_megapixels` also applies when a decoder explains a damaged image")
def test_the_limit_holds_when_a_damaged_image_is_explained():
    """OpenCV refuses a second header; Pillow uses its size."""
    twice = [[b"IHDR", png(12_000, 12_000, rows=0)[16:29]]]
    with pytest.raises(DecodeError, match=r"125 bytes are not an image: expected limits\.image_megapixels 40"):
        images.decode_bgr(png(96, 72, extra=twice))
