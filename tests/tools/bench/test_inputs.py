"""The benchmark's logs: their content, and when they are rendered again."""

import pytest

from roadperc_stream.log import read, summarise
from roadperc_stream.tools.bench import inputs
from roadperc_stream.tools.bench.inputs import WARM_UP, bench_options, prepared


def topics(path):
    summary = summarise(path)
    return {channel.topic: summary.counts[channel.source_id] for channel in summary.channels}


def test_each_log_has_what_its_name_says(bench_logs):
    assert set(bench_logs) == {"png", "truth", "jpeg", "stereo"}
    for name, log in bench_logs.items():
        counts = topics(log.path)
        assert counts["/camera/front/image"] == counts["/camera/front/depth"] == log.frames == 4
        assert ("/truth/pose" in counts) == (name == "truth")
        assert counts.get("/camera/right/image", 0) == (4 if name == "stereo" else 0)
        image = next(message for message in read(summarise(log.path)) if message.channel.topic == "/camera/front/image")
        assert (b"\x89PNG" in image.data) == (name in ("png", "truth"))
        for path, frames in ((log.first_frame, 1), (log.warm_up, WARM_UP)):
            counts = topics(path)
            assert counts["/camera/front/image"] == counts["/camera/front/segmentation"] == frames
            assert counts["/camera/front/calibration"] == 1
            assert summarise(path).metadata == summarise(log.path).metadata


def test_they_are_rendered_again_if_incomplete_or_for_other_options(tmp_path, monkeypatch):
    made = []

    def make(_folder, options, _logs):
        made.append(options.frames)
        if made == [4]:
            raise OSError("full")

    monkeypatch.setattr(inputs, "_make", make)
    with pytest.raises(OSError, match="full"):
        prepared(tmp_path, bench_options(4, (320, 240)))
    for frames in (4, 4, 5):
        prepared(tmp_path, bench_options(frames, (320, 240)))
    assert made == [4, 4, 4, 5, 5]
