"""A picture shows one frame: its overlay, a debug picture, or an image of the input."""

import cv2
import numpy as np
import pytest

import roadperc_stream as rp
from roadperc_stream.cli.view import main
from roadperc_stream.config import load_config
from roadperc_stream.errors import LogError
from roadperc_stream.output.drawing.on_request import depth_picture
from roadperc_stream.view.frame_times import find_stop
from roadperc_stream.view.pictures import picture_of
from tests import logs
from tests.replaying import replay

FRAMES = 4
LANES = "/perception/debug/lanes"


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return logs.write(tmp_path_factory.mktemp("logs") / "in.mcap", logs.items(FRAMES))


@pytest.fixture(scope="module")
def bare(source):
    replay(source, source.with_name("bare.mcap"), load_config())
    return source.with_name("bare.mcap")


@pytest.fixture(scope="module")
def full(source):
    replay(source, source.with_name("full.mcap"), load_config(), on_request=("overlay", "debug"))
    return source.with_name("full.mcap")


@pytest.mark.parametrize("frame", [0, FRAMES - 1])
def test_the_overlay_is_drawn_as_a_replay_writes_it(bare, full, frame):
    drawn, written = (picture_of(path, find_stop(path, frame)).astype(int) for path in (bare, full))
    assert np.abs(drawn - written).mean() < 4  # it is written as a JPEG
    others = [picture_of(full, find_stop(full, k)).astype(int) for k in range(FRAMES) if k != frame]
    assert min(np.abs(drawn - other).mean() for other in others) > np.abs(drawn - written).mean()


def test_debug_pictures_that_a_log_lacks_are_those_of_a_replay(bare, full, tmp_path, capsys):
    """Also if the input is gone: the result has copies of its messages."""
    target = tmp_path / "lanes.png"
    assert main([str(bare), "--frame", "2", "--png", str(target), "--topic", LANES]) == 0
    assert f"wrote {target} (320x240, {LANES} of frame 2)" in capsys.readouterr().out
    written = picture_of(full, find_stop(full, 2), LANES)
    assert np.array_equal(cv2.imread(str(target)), written)
    source = bare.with_name("in.mcap")
    away = source.rename(source.with_name("away.mcap"))
    try:
        assert main([str(bare), "--frame", "2", "--png", str(target), "--topic", LANES, "--force"]) == 0
    finally:
        away.rename(source)
    assert np.array_equal(cv2.imread(str(target)), written)


def test_images_of_the_input_are_those_of_the_frame(bare):
    stop, frame = find_stop(bare, 1), list(rp.frames(bare))[1]
    assert np.array_equal(picture_of(bare, stop, "/camera/front/image"), frame.input.image.bgr)
    expected = depth_picture(frame.input.raw_depth_m)
    assert np.array_equal(picture_of(bare, stop, "/camera/front/depth"), expected)


def test_depth_is_blue_far_red_near_and_black_if_unknown():
    depth_m = np.full((100, 200), 50.0, np.float32)
    depth_m[:, 100:], depth_m[:, 150:] = 2.5, np.nan
    picture = depth_picture(depth_m)
    far, near, unknown = (picture[80, column].astype(int) for column in (50, 120, 180))
    assert far[0] > far[2]
    assert near[2] > near[0]
    assert unknown.tolist() == [0, 0, 0]


def test_what_cannot_be_shown_is_one_line(source, bare, full, tmp_path, capsys):
    target = tmp_path / "x.png"
    assert main([str(bare), "--frame", "9", "--png", str(target)]) == 1
    assert capsys.readouterr().err == f"error: {bare}: no frame 9; expected 0 to {FRAMES - 1}\n"
    with pytest.raises(LogError, match=f"the log has no results; run roadperc-replay {source} OUT.mcap first"):
        find_stop(source, 1)
    assert main([str(bare), "--frame", "1", "--png", str(target), "--topic", "/nope"]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"error: {bare}: no pictures on /nope; expected /perception/overlay or one of /camera/front")
    with pytest.raises(LogError, match=r"^/perception/debug/matches: no picture of frame 0; the nearest .* one is 1$"):
        picture_of(full, find_stop(full, 0), "/perception/debug/matches")
    assert not target.exists()
