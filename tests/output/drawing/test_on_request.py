"""Pictures on request show the frame and change nothing else."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from roadperc_stream import log
from roadperc_stream.config import load_config
from roadperc_stream.geometry import Camera, mounting
from roadperc_stream.geometry.planes import Plane
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.model import Boundary, Correlation, Lanes, Matches, PlaneSearch, StereoDepth
from roadperc_stream.output import encoding
from roadperc_stream.output.drawing.on_request import (
    disparity_picture,
    lanes_picture,
    matches_picture,
    surface_picture,
    template_picture,
)
from roadperc_stream.schemas.record import PRODUCER
from roadperc_stream.schemas.topics import ON_REQUEST
from roadperc_stream.view.video import write_video
from tests import logs
from tests.analytic import STEP_NS
from tests.replaying import replay

CFG = load_config()


REQUESTS = {"bare": (), "overlay": ("overlay",), "debug": ("debug",), "full": ("overlay", "debug")}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A log of three frames, and its replays without and with pictures."""
    folder = tmp_path_factory.mktemp("pictures")
    source = logs.write(folder / "in.mcap", logs.items(3))
    for name, requests in REQUESTS.items():
        replay(source, folder / f"{name}.mcap", CFG, on_request=requests)
    return folder


def pictures(path):
    found = {}
    for message in log.read(log.summarise(path)):
        if message.channel.topic in ON_REQUEST:
            found.setdefault(message.channel.topic, []).append(message)
    return found


def others(path):
    messages = (m for m in log.read(log.summarise(path)) if m.channel.topic not in ON_REQUEST)
    return [(replace(m.channel, source_id=0), m.log_time_ns, m.sequence, m.data) for m in messages]


def test_only_requested_pictures_are_registered_and_written(folder):
    for name, requests in REQUESTS.items():
        target = folder / f"{name}.mcap"
        wanted = {topic for topic, request in ON_REQUEST.items() if request in requests}
        assert {c.topic for c in log.summarise(target).channels if c.topic in ON_REQUEST} == wanted
        assert set(pictures(target)) <= wanted
        assert others(target) == others(folder / "bare.mcap")


def test_an_overlay_is_a_jpeg_of_the_frame(folder):
    made = pictures(folder / "overlay.mcap")["/perception/overlay"]
    assert [m.sequence for m in made] == [0, 1, 2]
    for message in made:
        assert PRODUCER in message.channel.metadata
        content = decode("image", message.channel.schema_name, "protobuf", message.data, 0, Context())
        assert content.stamp_ns == message.log_time_ns
        assert content.payload.frame_id == "camera"
        picture = content.payload.bgr
        assert picture.shape == (240, 320, 3)
        assert b"\xff\xd8\xff" in message.data[:80]
        assert picture[200, 160, 0] > picture[200, 160, 2] + 20  # the road is tinted blue


def test_pictures_are_deterministic_and_replaced_by_a_later_replay(folder, tmp_path):
    replay(folder / "full.mcap", tmp_path / "again.mcap", CFG, on_request=("overlay", "debug"))
    assert (tmp_path / "again.mcap").read_bytes() == (folder / "full.mcap").read_bytes()
    replay(folder / "full.mcap", tmp_path / "bare.mcap", CFG)
    assert not pictures(tmp_path / "bare.mcap")


def test_absent_results_have_no_picture(folder, tmp_path):
    cfg = load_config(None, ("odometry.enabled=false", "stereo.method=off"))
    replay(folder / "in.mcap", tmp_path / "out.mcap", cfg, on_request=("debug",))
    assert set(pictures(tmp_path / "out.mcap")) == {"/perception/debug/lanes", "/perception/debug/surface"}


def test_matches_are_drawn_from_the_second_frame_on(folder):
    made = pictures(folder / "debug.mcap")
    assert [m.sequence for m in made.get("/perception/debug/matches", [])] == [1, 2]
    assert "/perception/debug/template" not in made


def test_a_log_without_images_gets_a_note(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(3, roles=("calibration", "tf", "depth", "segmentation")))
    summary = replay(source, tmp_path / "out.mcap", CFG, on_request=("overlay",))
    assert not pictures(tmp_path / "out.mcap")
    assert "--overlay: no pictures, the log has no camera image" in summary.notes


def with_images(path, data_of):
    """Three frames with other images: ``data_of`` returns the message of a frame's image."""
    stamps = sorted({item.stamp_ns for item in logs.items(3)})
    items = [
        replace(item, data=data_of(stamps.index(item.stamp_ns), item)) if item.role == "image" else item
        for item in logs.items(3)
    ]
    return logs.write(path, items)


def test_a_frame_with_an_unreadable_image_has_no_pictures(tmp_path):
    broken = encoding.encode_image(logs.START_NS + STEP_NS, "camera", "png", b"no image")
    source = with_images(tmp_path / "in.mcap", lambda frame, item: broken if frame == 1 else item.data)
    replay(source, tmp_path / "out.mcap", CFG, on_request=("overlay", "debug"))
    found = pictures(tmp_path / "out.mcap")
    assert [m.sequence for m in found["/perception/overlay"]] == [0, 2]
    assert [m.sequence for m in found["/perception/debug/lanes"]] == [0, 2]


def test_an_image_of_another_size_stays_bare(tmp_path):
    """The tags have the calibration's size, so there are results, which would be drawn at wrong places."""
    white = cv2.imencode(".png", np.full((200, 400, 3), 255, np.uint8))[1].tobytes()
    source = with_images(
        tmp_path / "in.mcap", lambda _, item: encoding.encode_image(item.stamp_ns, "camera", "png", white)
    )
    summary = replay(source, tmp_path / "out.mcap", CFG, on_request=("overlay", "debug"))
    found = pictures(tmp_path / "out.mcap")
    assert "/perception/drivable" in {channel.topic for channel, *_ in others(tmp_path / "out.mcap")}
    assert set(found) == {"/perception/overlay"}
    for message in found["/perception/overlay"]:
        picture = decode("image", message.channel.schema_name, "protobuf", message.data, 0, Context()).payload.bgr
        assert picture.shape == (200, 400, 3)
        assert picture[:10].min() < 100
        assert picture[100:].min() > 245
    assert "in all 3 frames: image: 400x200 pixels, its calibration says 320x240" in summary.throughout
    assert write_video(tmp_path / "out.mcap", tmp_path / "overlays.mp4").pictures == 3
    replay(source, tmp_path / "bare.mcap", CFG)
    assert write_video(tmp_path / "bare.mcap", tmp_path / "drawn.mp4").pictures == 3
    written, drawn = (first_picture(tmp_path / f"{name}.mp4") for name in ("overlays", "drawn"))
    assert np.abs(written.astype(int) - drawn).mean() < 3
    assert np.abs(written.astype(int) - drawn)[100:].max() < 12


def first_picture(path):
    return cv2.VideoCapture(str(path)).read()[1]


YELLOW = (26, 230, 255)
WHITE, GREEN, MAGENTA, BLUE, RED = (255, 255, 255), (77, 230, 26), (255, 60, 255), (255, 204, 26), (60, 60, 255)
CAMERA = Camera("left", 320, 240, 100.0, 100.0, 159.5, 119.5)


def black(rows=240, columns=320):
    return np.zeros((rows, columns, 3), np.uint8)


def near(picture, colour):
    return (np.abs(picture.astype(int) - colour) <= 40).all(axis=-1)


@pytest.mark.parametrize("step", [1, 2])
def test_lines_are_drawn_in_the_colour_of_their_kind(step):
    edges = np.zeros((240 // step, 320 // step), bool)
    edges[130 // step, 300 // step] = True
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


def test_points_triples_and_the_side_view_of_the_plane_search():
    """The camera is 1.4 m above a flat road, the best hypothesis is the road; a point of 1 m is an outlier."""
    ahead = np.arange(4.0, 20.0)
    on_road, above = np.stack((ahead, 0 * ahead, 0 * ahead), axis=1), [[8.0, 2.0, 1.0]]
    triple, tilted = (
        [[4.0, -1.0, 0.0], [4.0, 1.0, 0.0], [8.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [9.5, 0.0, 0.125]],
    )
    search = PlaneSearch(
        np.concatenate((on_road, above)), np.array([triple, tilted]), np.array([16 / 17, 0.5]), 9, 0.05
    )
    picture = surface_picture(black(), CAMERA, mounting(z=1.4), Plane.of(np.array([0.0, 0.0, 1.0]), 0.0), search)
    assert near(picture, GREEN)[round(119.5 + 140 / 6), round(159.5)]
    assert near(picture, RED)[round(119.5 + 40 / 8), round(159.5 - 200 / 8)]
    assert near(picture, WHITE)[round(119.5 + 140 / 4), [140, 160, 180]].all()
    side = picture[:86, 320 - 176 :]
    assert near(side, WHITE)[43, [2, 5, 170]].all()
    assert near(side, RED)[0, round(8 / 19 * 175)]
    assert near(side, YELLOW)[round(85 / 4), round(9.5 / 19 * 175)]


def test_inliers_and_outliers_end_at_their_current_place():
    px = np.array([(100, 100), (200, 200)], np.float32)
    matches = Matches(px - np.float32(40), px, np.array([True, False]))
    picture = matches_picture(black(), matches)
    assert near(picture, GREEN)[100, 100]
    assert near(picture, GREEN)[80, 80]
    assert near(picture, RED)[200, 200]
    assert near(picture, RED)[180, 180]


def search(scores):
    return Correlation(100, 60, (21, 11), np.asarray(scores, np.float32))


def test_the_heat_map_is_at_the_middles_and_the_box_at_the_peak():
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


def test_unknown_disparity_is_black_and_equal_disparities_have_equal_colours():
    """At 100 px and 0.4 m the disparity is 40 px / depth; that of 2 m has the last colour."""
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
