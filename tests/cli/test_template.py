"""``--template``: a box in a frame of the sample, or a picture of it, is found in the log's frames."""

from base64 import b64encode

import cv2
import numpy as np
import polars as pl
import pytest

from roadperc_stream.cli import replay
from roadperc_stream.config import ReplayConfig
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.output.tables import sidecar_path
from tests.test_sample import SAMPLE

BOX = (150, 120, 200, 150)


def found(tmp_path, template, *options):
    """Rows of the template in three frames of the sample."""
    out = tmp_path / "out.mcap"
    arguments = ["--quiet", "--only", "objects", "--frames", "3", "--template", template, *options]
    assert replay.main([str(SAMPLE), str(out), *arguments]) == 0
    return pl.read_parquet(sidecar_path(out, "objects")).filter(pl.col("label") == "template")


def first_grey():
    return next(iter(open_input(ReplaySource(SAMPLE), ReplayConfig()).samples())).frame.image.grey


@pytest.mark.parametrize("as_file", [True, False])
def test_the_box_and_the_picture_of_it_are_found_where_they_are(tmp_path, as_file):
    x0, y0, x1, y1 = BOX
    template = "0:150,120,200,150"
    if as_file:
        template = str(tmp_path / "obstacle.png")
        cv2.imwrite(template, first_grey()[y0:y1, x0:x1])
    rows = found(tmp_path, template, "--set", "objects.template_min_score=0")
    assert rows["frame"].to_list() == [0, 1, 2]
    first = rows.row(0, named=True)
    assert tuple(first[f"{name}_px"] for name in ("x_min", "y_min", "x_max", "y_max")) == BOX
    assert first["score"] == pytest.approx(1.0, abs=1e-5)
    assert first["distance_m"] > 1.4
    assert all(-1 < score < 1 for score in rows["score"][1:])


@pytest.mark.parametrize(
    ("template", "complaint"),
    [
        ("0:150,120,400,150", "X0 < X1 and Y0 < Y1 within 360x270 pixels, found 150,120,400,150"),
        ("0:50,60,50,80", "X0 < X1 and Y0 < Y1 within 360x270 pixels, found 50,60,50,80"),
        ("0:50,60,52,80", "a picture of 8x8 pixels or more, found 2x20 pixels"),
        ("99:10,10,40,40", "the log has no image in frame 99"),
        ("99999999999999999999999:0,0,9,9", "No such file or directory; expected an image file, or FRAME:X0,"),
        ("nowhere.png", "nowhere.png: No such file or directory; expected an image file, or FRAME:X0,Y0,X1,Y1"),
        (str(SAMPLE), "bytes are not an image"),
    ],
)
def test_an_invalid_template_is_one_line(tmp_path, capsys, template, complaint):
    arguments = [str(SAMPLE), str(tmp_path / "out.mcap"), "--quiet", "--only", "objects", "--template", template]
    assert replay.main(arguments) == 1
    said = capsys.readouterr().err
    assert "--template: " in said
    assert complaint in said
    assert not (tmp_path / "out.mcap").exists()


def test_a_flat_or_too_large_picture(tmp_path, capsys):
    for name, grey in (("flat", np.full((20, 30), 90, np.uint8)), ("large", noise((1200, 1200)))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), grey)
    for name, complaint in (("flat", "found all of one brightness"), ("large", "1200x1200 pixels is too large")):
        picture = str(tmp_path / f"{name}.png")
        assert replay.main([str(SAMPLE), str(tmp_path / "out.mcap"), "--quiet", "--template", picture]) == 1
        assert complaint in capsys.readouterr().err


def test_a_picture_with_a_huge_size_in_its_header(tmp_path, capsys):
    """A PNG of 74 bytes may say in its header that it has billions of pixels."""
    data = bytearray(cv2.imencode(".png", noise((9, 9)))[1].tobytes())
    data[16:24] = (60_000).to_bytes(4, "big") * 2
    png = b64encode(bytes(data)).decode()
    option = f"objects.template_png={png}"
    assert replay.main([str(SAMPLE), str(tmp_path / "out.mcap"), "--quiet", "--set", option]) in (1, 2)
    assert "a picture of 60000x60000 pixels, expected at most 4,000,000" in capsys.readouterr().err


def noise(shape):
    return np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)


def test_a_box_in_standard_input_is_refused(tmp_path, capsys):
    assert replay.main(["-", str(tmp_path / "out.mcap"), "--quiet", "--template", "0:1,2,30,40"]) == 1
    assert "it is read twice" in capsys.readouterr().err
