"""Pictures on request: which are written, that they are pictures of the frame, and that nothing else changes."""

import dataclasses
from dataclasses import replace

import cv2
import numpy as np
import pytest

from roadperc_stream import log
from roadperc_stream.config import load_config
from roadperc_stream.geometry import Camera
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.model import Boundary, Correlation, Lanes, Matches, StereoDepth
from roadperc_stream.output import encoding
from roadperc_stream.output.drawing.on_request import (
    disparity_picture,
    lanes_picture,
    matches_picture,
    template_picture,
)
from roadperc_stream.schemas.record import PRODUCER
from roadperc_stream.schemas.topics import ON_REQUEST
from roadperc_stream.view.video import write_video
from tests import logs
from tests.replaying import replay

CFG = load_config()
DEBUG = {topic for topic, request in ON_REQUEST.items() if request == "debug"}


@pytest.fixture
def source(tmp_path):
    return logs.write(tmp_path / "in.mcap", logs.items(3))


def pictures(path):
    found = {}
    for message in log.read(log.summarise(path)):
        if message.channel.topic in ON_REQUEST:
            found.setdefault(message.channel.topic, []).append(message)
    return found


def plain(path):
    return [m for m in log.read(log.summarise(path)) if m.channel.topic not in ON_REQUEST]


def unnumbered(messages):
    return [(dataclasses.replace(m.channel, source_id=0), m.log_time_ns, m.sequence, m.data) for m in messages]


def test_only_what_is_asked_for_is_registered_and_written(source):
    for requests in ((), ("overlay",), ("debug",), ("overlay", "debug")):
        target = source.with_name("out.mcap")
        replay(source, target, CFG, on_request=requests, force=True)
        wanted = {topic for topic, request in ON_REQUEST.items() if request in requests}
        assert {c.topic for c in log.summarise(target).channels if c.topic in ON_REQUEST} == wanted
        assert set(pictures(target)) <= wanted


def test_an_overlay_is_a_jpeg_of_the_frame(source):
    target = source.with_name("out.mcap")
    replay(source, target, CFG, on_request=("overlay",))
    made = pictures(target)["/perception/overlay"]
    assert [m.sequence for m in made] == [0, 1, 2]
    for message in made:
        assert PRODUCER in message.channel.metadata
        content = decode("image", message.channel.schema_name, "protobuf", message.data, 0, Context())
        assert content.stamp_ns == message.log_time_ns
        assert content.payload.frame_id == "camera"
        picture = content.payload.bgr
        assert picture.shape == (240, 320, 3)
        assert b"\xff\xd8\xff" in message.data[:80]
        # The road is tinted blue, the grey image is not.
        assert picture[200, 160, 0] > picture[200, 160, 2] + 20


def test_everything_else_is_as_without(source):
    bare, full = source.with_name("bare.mcap"), source.with_name("full.mcap")
    replay(source, bare, CFG)
    replay(source, full, CFG, on_request=("overlay", "debug"))
    assert unnumbered(plain(bare)) == unnumbered(plain(full))


def test_the_same_pictures_twice_and_a_later_replay_replaces_them(source):
    first, second, bare = (source.with_name(f"{name}.mcap") for name in ("first", "second", "bare"))
    replay(source, first, CFG, on_request=("overlay", "debug"))
    replay(first, second, CFG, on_request=("overlay", "debug"))
    assert first.read_bytes() == second.read_bytes()
    replay(first, bare, CFG)
    assert not pictures(bare)


def test_what_is_absent_has_no_picture(source):
    target = source.with_name("out.mcap")
    cfg = load_config(None, ("odometry.enabled=false", "stereo.method=off"))
    replay(source, target, cfg, on_request=("debug",))
    assert set(pictures(target)) == {"/perception/debug/lanes"}


def test_matches_are_drawn_from_the_second_frame_on(source):
    target = source.with_name("out.mcap")
    replay(source, target, CFG, on_request=("debug",))
    made = pictures(target)
    assert [m.sequence for m in made.get("/perception/debug/matches", [])] == [1, 2]
    assert "/perception/debug/template" not in made


def test_frames_without_an_image_are_told_of_and_not_drawn(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(3, roles=("calibration", "tf", "depth", "segmentation")))
    target = tmp_path / "out.mcap"
    summary = replay(source, target, CFG, on_request=("overlay",))
    assert not pictures(target)
    assert "--overlay: frames without a camera image that can be read: 3" in summary.notes


def test_a_broken_image_leaves_its_frame_without_pictures(tmp_path):
    items = logs.items(3)
    second = [item for item in items if item.role == "image"][1]
    broken = dataclasses.replace(second, data=encoding.encode_image(second.stamp_ns, "camera", "png", b"no image"))
    source = logs.write(tmp_path / "in.mcap", [broken if item is second else item for item in items])
    summary = replay(source, tmp_path / "out.mcap", CFG, on_request=("overlay", "debug"))
    found = pictures(tmp_path / "out.mcap")
    assert [m.sequence for m in found["/perception/overlay"]] == [0, 2]
    assert [m.sequence for m in found["/perception/debug/lanes"]] == [0, 2]
    assert "--overlay and --debug: frames without a camera image that can be read: 1" in summary.notes


def test_an_image_of_another_size_is_shown_with_nothing_drawn_in(tmp_path):
    """The road is seen, for its tags are of the calibration's size: it would be drawn where it is not."""
    white = cv2.imencode(".png", np.full((200, 400, 3), 255, np.uint8))[1].tobytes()
    source = logs.write(
        tmp_path / "in.mcap",
        [
            replace(item, data=encoding.encode_image(item.stamp_ns, "camera", "png", white))
            if item.role == "image"
            else item
            for item in logs.items(3)
        ],
    )
    summary = replay(source, tmp_path / "out.mcap", CFG, on_request=("overlay", "debug"))
    found = pictures(tmp_path / "out.mcap")
    assert "/perception/drivable" in {
        message.channel.topic for message in log.read(log.summarise(tmp_path / "out.mcap"))
    }
    assert set(found) == {"/perception/overlay"}
    for message in found["/perception/overlay"]:
        picture = decode("image", message.channel.schema_name, "protobuf", message.data, 0, Context()).payload.bgr
        assert picture.shape == (200, 400, 3)
        assert picture[:10].min() < 100
        assert picture[100:].min() > 245
    told = "frames with nothing drawn into an image that is not of its calibration's size: 3"
    assert f"--overlay and --debug: {told}" in summary.notes
    assert "in all 3 frames: image: 400x200 pixels, its calibration says 320x240" in summary.throughout
    assert write_video(tmp_path / "out.mcap", tmp_path / "overlays.mp4").pictures == 3
    replay(source, tmp_path / "bare.mcap", CFG)
    assert write_video(tmp_path / "bare.mcap", tmp_path / "drawn.mp4").pictures == 3
    written, drawn = (first_picture(tmp_path / f"{name}.mp4") for name in ("overlays", "drawn"))
    assert np.abs(written.astype(int) - drawn).mean() < 3
    assert np.abs(written.astype(int) - drawn)[100:].max() < 12


def first_picture(path):
    return cv2.VideoCapture(str(path)).read()[1]


WHITE, GREEN, MAGENTA, BLUE, RED = (255, 255, 255), (77, 230, 26), (255, 60, 255), (255, 204, 26), (60, 60, 255)
CAMERA = Camera("left", 320, 240, 100.0, 100.0, 159.5, 119.5)


def black(rows=240, columns=320):
    return np.zeros((rows, columns, 3), np.uint8)


def near(picture, colour):
    return (np.abs(picture.astype(int) - colour) <= 40).all(axis=-1)


def test_lines_lie_on_their_pixels_by_their_part():
    edges = np.zeros((240, 320), bool)
    edges[130, 300] = True
    lanes = Lanes(
        (Boundary("left", "measured", raw_px=(60.0, 240.0, 60.0, 120.0)), Boundary("right", "lost")),
        np.array([(200.0, 239.0, 200.0, 120.0)]),
        np.array([(240.0, 239.0, 240.0, 120.0)]),
        edges,
    )
    picture = lanes_picture(black(), lanes)
    assert near(picture, WHITE)[130, 300]
    assert near(picture, GREEN)[180, 60]
    assert near(picture, BLUE)[180, 200]
    assert near(picture, MAGENTA)[180, 240]
    assert not picture[180, [100, 150, 280]].any()


def test_lanes_without_edges_or_lines_are_the_dimmed_image():
    picture = lanes_picture(np.full((240, 320, 3), 200, np.uint8), Lanes(()))
    assert (picture[200:] == 90).all()


def test_inliers_and_outliers_end_where_they_are_now():
    px = np.array([(100, 100), (200, 200)], np.float32)
    matches = Matches(px - np.float32(40), px, np.array([True, False]))
    picture = matches_picture(black(), matches)
    assert near(picture, GREEN)[100, 100]
    assert near(picture, GREEN)[80, 80]
    assert near(picture, RED)[200, 200]
    assert near(picture, RED)[180, 180]


def search(scores):
    return Correlation(100, 60, (21, 11), np.asarray(scores, np.float32))


def test_the_heat_lies_at_the_middles_and_the_box_at_the_peak():
    scores = np.full((30, 40), -0.9)
    scores[20, 30] = 0.95
    picture = template_picture(black(), (search(scores),))
    assert (picture[65:80, 110:150] == picture[65, 110]).all()
    assert picture[85, 140, 2] > picture[65, 110, 2]
    assert not picture[60:240, :109].any()
    # The patch, 21 x 11, with its first pixel on column 130 and row 80.
    assert near(picture, WHITE)[80, 130:151].all()
    assert near(picture, WHITE)[90, 130:151].all()
    assert near(picture, WHITE)[80:91, [130, 150]].all()


def test_where_the_image_shows_nothing_there_is_no_heat_and_no_peak():
    assert not template_picture(black(), (search(np.full((30, 40), -np.inf)),))[20:].any()


def test_correlation_says_where_its_peak_is():
    scores = np.full((30, 40), -0.9)
    scores[20, 30] = 0.95
    box, score = search(scores).peak
    assert (box.x_min, box.y_min, box.x_max, box.y_max) == (130, 80, 151, 91)
    assert score == pytest.approx(0.95)
    assert search(scores).match(0.96) is None
    assert search(np.full((3, 4), -np.inf)).match(-1.0) is None


def test_disparity_is_black_where_unknown_and_the_same_colour_at_the_same_disparity():
    """With 100 px and 0.4 m the disparity is 40 px over the depth, and 20 px, of 2 m, has the last colour."""
    depth_m = np.full((240, 320), np.nan, np.float32)
    depth_m[100:120] = 4.0
    depth_m[120:140] = 2.0
    depth_m[140:160] = 1.0
    depth_m[160:180] = 40.0
    picture = disparity_picture(CAMERA, 0.4, StereoDepth("left", depth_m))
    assert not picture[50:100].any()
    assert not picture[180:].any()
    middle, last, beyond, far = (picture[row, 200] for row in (110, 130, 150, 170))
    np.testing.assert_array_equal(middle, cv2.applyColorMap(np.uint8([[128]]), cv2.COLORMAP_TURBO)[0, 0])
    np.testing.assert_array_equal(last, beyond)
    assert last[2] > 100 > last[0]
    assert far[0] > far[2]


def test_matches_must_fit_together():
    px = np.zeros((3, 2), np.float32)
    with pytest.raises(ValueError, match=r"inliers: expected bool \(3,\)"):
        Matches(px, px.copy(), np.zeros(2, bool))
