"""The benchmark's logs: their content, and when they are rendered again."""

import pytest

from roadperc_stream.log import summarise
from roadperc_stream.tools.bench import inputs
from roadperc_stream.tools.bench.inputs import WARM_UP, bench_options, prepared


def topics(path):
    summary = summarise(path)
    return {channel.topic: summary.counts[channel.source_id] for channel in summary.channels}


def image_bytes(path):
    return next(summarise(path).source.messages(["/camera/front/image"], None, None)).data


def test_each_log_has_what_its_name_says(bench_logs):
    assert list(bench_logs) == ["png", "truth", "jpeg", "stereo"]
    found = {name: topics(log.path) for name, log in bench_logs.items()}
    for name, counts in found.items():
        assert counts["/camera/front/image"] == counts["/camera/front/depth"] == bench_logs[name].frames == 4
        assert ("/truth/pose" in counts) == (name == "truth")
        assert counts.get("/camera/right/image", 0) == (4 if name == "stereo" else 0)
        assert (b"\x89PNG" in image_bytes(bench_logs[name].path)) == (name in ("png", "truth"))


def test_the_first_frames_alone_are_logs(bench_logs):
    for log in bench_logs.values():
        for path, frames in ((log.first_frame, 1), (log.warm_up, WARM_UP)):
            counts = topics(path)
            assert counts["/camera/front/image"] == counts["/camera/front/segmentation"] == frames
            assert counts["/camera/front/calibration"] == 1
            assert summarise(path).metadata == summarise(log.path).metadata


def test_they_are_rendered_again_only_if_the_options_change(bench_logs, tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(inputs, "_make", lambda folder, options: made.append((folder, options.frames)))
    prepared(tmp_path, bench_options(4, (320, 240)))
    prepared(tmp_path, bench_options(4, (320, 240)))
    prepared(tmp_path, bench_options(5, (320, 240)))
    assert made == [(tmp_path, 4), (tmp_path, 5)]


def test_incomplete_logs_are_made_again(tmp_path, monkeypatch):
    def fails(folder, _options):
        (folder / "png.mcap").write_bytes(b"half")
        raise OSError("full")

    monkeypatch.setattr(inputs, "_make", fails)
    for _ in range(2):
        with pytest.raises(OSError, match="full"):
            prepared(tmp_path, bench_options(4, (320, 240)))
    made = []
    monkeypatch.setattr(inputs, "_make", lambda folder, _options: made.append(list(folder.iterdir())))
    prepared(tmp_path, bench_options(4, (320, 240)))
    assert made == [[]]
