"""Images of other formats, or with a hidden size, are refused before a decoder sees them."""

import ast
import io
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage

from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import images
from roadperc_stream.output import encoding
from tests import logs
from tests.commands import run_forked
from tests.hostile import inputs

ROOT = Path(__file__).parents[2]
DECODERS = (images.decode_bgr, images.decode_grey, images.image_size)
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


@pytest.mark.commands
@pytest.mark.parametrize("command", ["roadperc-replay in.mcap out.mcap --overlay", "roadperc-convert dump out.mcap"])
def test_no_command_starts_a_program_for_an_image(tmp_path, ghostscript, command):
    started, variables = ghostscript
    picture = encoding.encode_image(logs.START_NS, "camera", "png", inputs.POSTSCRIPT)
    logs.write(tmp_path / "in.mcap", inputs.replaced("image", picture, frames=1))
    (tmp_path / "dump" / "rgb").mkdir(parents=True)
    (tmp_path / "dump" / "rgb" / "1.png").write_bytes(inputs.POSTSCRIPT)
    (tmp_path / "dump" / "calibration.json").write_text('{"width": 9, "height": 9, "fov_deg": 90}')
    done = run_forked(*command.split(), cwd=tmp_path, variables=variables)
    assert not started.exists(), started.read_text()
    assert "not an image" in done.stdout + done.stderr, done.stdout + done.stderr


def test_the_ghostscript_trap_works(ghostscript, monkeypatch):
    """Pillow without a list of formats starts Ghostscript."""
    started, variables = ghostscript
    monkeypatch.setenv("PATH", variables["PATH"])
    monkeypatch.setattr("PIL.EpsImagePlugin.gs_binary", None)
    with pytest.raises(OSError), PillowImage.open(io.BytesIO(inputs.POSTSCRIPT)) as picture:  # noqa: PT011
        picture.load()
    assert started.exists()


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
