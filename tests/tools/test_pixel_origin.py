"""Where a principal point counts from is a matter of the format, and is said."""

import json

import pytest

from roadperc_stream import log
from roadperc_stream.cli import info
from roadperc_stream.cli.convert import main
from roadperc_stream.input.decoding import context_of_channel, decode
from roadperc_stream.schemas.roles import ROLES
from tests.tools.dump_writer import HEIGHT, WIDTH, camera_pixels, png

K = [[8.0, 0.0, 8.0], [0.0, 8.0, 6.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("folder", "said", "cx", "words"),
    [
        ("rgb", {}, 7.5, "the first pixel's corner, as CARLA has it"),
        ("image_2", {}, 8.0, "the first pixel's centre, as KITTI has it"),
        ("image_02/data", {}, 8.0, "the first pixel's centre, as KITTI has it"),
        ("image_2", {"pixel_origin": "corner"}, 7.5, "the first pixel's corner, as calibration.json says"),
        ("rgb", {"pixel_origin": "centre"}, 8.0, "the first pixel's centre, as calibration.json says"),
    ],
)
def test_the_origin_of_pixels_is_that_of_the_format_and_said(tmp_path, capsys, folder, said, cx, words):
    dump, out = tmp_path / "dump", tmp_path / "in.mcap"
    png(dump / folder / "0000000001.png", camera_pixels())
    dump.joinpath("calibration.json").write_text(json.dumps({"width": WIDTH, "height": HEIGHT, "K": K, **said}))
    role = () if folder == "rgb" else ("--role", f"image={folder}")
    assert main([str(dump), str(out), *role]) == 0
    assert words in capsys.readouterr().out
    (message,) = log.read(log.summarise(out), topics=[ROLES["calibration"].topic])
    channel = message.channel
    context = context_of_channel(channel, "auto")
    camera = decode("calibration", channel.schema_name, channel.message_encoding, message.data, 0, context).payload
    assert (camera.cx, camera.cy) == (cx, cx - 2.0)
    assert info.main([str(out)]) == 0
    assert f"converted with a K that counts pixels from {words}" in capsys.readouterr().out


def test_a_field_of_view_needs_none(tmp_path, capsys):
    png(tmp_path / "dump" / "rgb" / "1.png", camera_pixels())
    assert main([str(tmp_path / "dump"), str(tmp_path / "in.mcap"), "--fov", "90"]) == 0
    assert "pixel origin" not in capsys.readouterr().out
