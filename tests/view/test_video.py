"""A video shows the frames of a log at the pace of the log."""

import cv2
import numpy as np
import pytest

from roadperc_stream.config import load_config
from roadperc_stream.errors import LogError, TargetError
from roadperc_stream.log import LogWriter, Message
from roadperc_stream.output import encoding
from roadperc_stream.output.results import encode_metrics, result_channel
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.view.frame_times import find_stop
from roadperc_stream.view.pictures import picture_of
from roadperc_stream.view.video import frame_rate_hz, pictures_shown, write_video
from tests import logs
from tests.replaying import replay

CFG = load_config()
MS = 1_000_000
START = 1_600_000_000_000_000_000


def stamps(*ms):
    return [START + round(m * MS) for m in ms]


def overlays(path, times, colours, size=(91, 121)):
    """Write a log with an overlay of one colour per frame; None for a frame without overlay."""
    metrics = result_channel("/perception/metrics", "roadperc.FrameMetrics")
    overlay = result_channel("/perception/overlay", "foxglove.CompressedImage")
    with LogWriter(path) as writer:
        for k, (stamp, colour) in enumerate(zip(times, colours, strict=True)):
            row = encode_metrics("camera", FrameMetrics("log", k, stamp))
            writer.write(Message(metrics, stamp, stamp, k, row))
            if colour is not None:
                jpeg = cv2.imencode(".jpg", np.full((*size, 3), colour, np.uint8))[1].tobytes()
                data = encoding.encode_image(stamp, "camera", "jpeg", jpeg)
                writer.write(Message(overlay, stamp, stamp, k, data))
    return path


def read_video(path):
    capture = cv2.VideoCapture(str(path))
    pictures = []
    while True:
        there, picture = capture.read()
        if not there:
            return pictures, capture.get(cv2.CAP_PROP_FPS)
        pictures.append(picture)


def blue_red(picture):
    blue, _, red = (int(v) for v in picture[40, 60])
    return "blue" if blue > red + 100 else "red" if red > blue + 100 else "other"


def test_the_video_rate_comes_from_the_median_interval():
    assert frame_rate_hz(stamps(0, 50, 100, 150, 1000)) == pytest.approx(20)
    assert frame_rate_hz(stamps(0)) == 1
    assert frame_rate_hz(stamps(0, 0, 0)) == 1
    assert frame_rate_hz(stamps(0, 0.1, 0.2)) == 120


@pytest.mark.parametrize(
    ("times", "shown"),
    [
        ([0, 50, 100, 150], [1, 1, 1, 1]),
        ([0, 51, 99, 152, 199], [1, 1, 1, 1, 1]),
        ([0, 50, 250, 300], [1, 4, 1, 1]),
        ([0, 5, 50, 100, 150, 200], [0, 1, 1, 1, 1, 1]),
        ([500, 550, 0, 50, 100], [1, 1, 1, 1, 1]),
        ([0, 50, 100, 3_600_000, 3_600_050], [1, 1, 200, 1, 1]),
    ],
)
def test_video_time_follows_the_stamps(times, shown):
    assert pictures_shown(stamps(*times), 20.0) == shown


@pytest.mark.parametrize("suffix", [".webm", ".mp4"])
def test_a_video_shows_overlays_and_repeats_the_last_one_in_gaps(capfd, tmp_path, suffix):
    """The second frame has no overlay, which is also a gap."""
    times = stamps(0, 50, 100, 150, 350, 400)
    colours = [(220, 0, 0), None, (0, 0, 220), (0, 0, 220), (220, 0, 0), (220, 0, 0)]
    source, reported = overlays(tmp_path / "out.mcap", times, colours), []
    done = write_video(source, tmp_path / f"video{suffix}", progress=lambda *counts: reported.append(counts))
    assert (done.pictures, done.frames) == (9, 6)
    assert reported == [(k, 6) for k in range(1, 7)]
    assert capfd.readouterr().err == "", "OpenCV's message about a tag"
    pictures, rate_hz = read_video(tmp_path / f"video{suffix}")
    assert rate_hz == pytest.approx(20)
    assert [blue_red(p) for p in pictures] == ["blue"] * 2 + ["red"] * 5 + ["blue"] * 2
    assert pictures[0].shape == (90, 120, 3)
    assert not list(tmp_path.glob(".*"))


def test_a_log_without_overlays_gives_the_same_video(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(3))
    bare, full = tmp_path / "bare.mcap", tmp_path / "full.mcap"
    replay(source, bare, CFG)
    replay(source, full, CFG, on_request=("overlay",))
    for path in (bare, full):
        assert write_video(path, path.with_suffix(".mp4")).pictures == 3
    drawn, written = read_video(bare.with_suffix(".mp4"))[0], read_video(full.with_suffix(".mp4"))[0]
    for a, b in zip(drawn, written, strict=True):
        assert np.abs(a.astype(int) - b).mean() < 4
        assert a[200, 160, 0] > a[200, 160, 2] + 20


def test_only_the_pictures_that_the_encoder_made_alone_are_key_frames(tmp_path):
    """Browsers refuse a video in which others are marked."""
    source = overlays(tmp_path / "out.mcap", stamps(*range(0, 1000, 50)), [(220, 0, 0), (0, 0, 220)] * 10)
    write_video(source, tmp_path / "video.webm")
    capture = cv2.VideoCapture(str(tmp_path / "video.webm"), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    marked, is_key = [], []
    while capture.grab():
        marked.append(bool(capture.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME)))
        is_key.append(not capture.retrieve()[1].ravel()[0] & 1)  # the first bit of a frame of VP8
    assert marked == is_key
    assert 1 <= sum(marked) < len(marked) == 20


def test_a_video_of_a_debug_picture(tmp_path):
    source = logs.write(tmp_path / "in.mcap", logs.items(3))
    bare, full = tmp_path / "bare.mcap", tmp_path / "full.mcap"
    replay(source, bare, CFG)
    replay(source, full, CFG, on_request=("debug",))
    topic = "/perception/debug/lanes"
    assert write_video(full, tmp_path / "lanes.webm", topic).pictures == 3
    dimmed, plain = (read_video(tmp_path / "lanes.webm")[0][0], picture_of(full, find_stop(full, 0)))
    assert dimmed[200:].mean() < 0.7 * plain[200:].mean()
    with pytest.raises(LogError, match=rf"bare.mcap: no pictures on {topic}; replay the log with --debug$"):
        write_video(bare, tmp_path / "none.webm", topic)
    with pytest.raises(LogError, match="a video shows /perception/overlay, /perception/debug/"):
        write_video(full, tmp_path / "none.webm", "/camera/front/image")
    assert not list(tmp_path.glob("*none*"))


def test_an_existing_video_is_replaced_only_with_force(tmp_path):
    source = overlays(tmp_path / "out.mcap", stamps(0, 50), [(220, 0, 0)] * 2)
    target = tmp_path / "video.mp4"
    target.write_bytes(b"mine")
    with pytest.raises(TargetError, match=r"video.mp4: exists; pass --force to overwrite it"):
        write_video(source, target)
    assert target.read_bytes() == b"mine"
    write_video(source, target, force=True)
    assert len(read_video(target)[0]) == 2


def test_a_video_of_an_input_log_says_to_replay_it_first(tmp_path):
    (tmp_path / "my logs").mkdir()
    source = logs.write(tmp_path / "my logs" / "in.mcap", logs.items(2))
    with pytest.raises(
        LogError, match=f"in.mcap: no results for a video; run roadperc-replay '{source}' OUT.mcap first"
    ):
        write_video(source, tmp_path / "video.mp4")
    assert not (tmp_path / "video.mp4").exists()


def test_a_log_without_images_gives_no_video(tmp_path):
    source = overlays(tmp_path / "out.mcap", stamps(0, 50), [None, None])
    with pytest.raises(LogError, match=r"no camera image in any of 2 frames"):
        write_video(source, tmp_path / "video.mp4")
    assert {p.name for p in tmp_path.iterdir()} == {"out.mcap"}
