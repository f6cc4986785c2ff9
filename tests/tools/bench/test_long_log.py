"""A log of any length out of a short one."""

import roadperc_stream as rp
from roadperc_stream.log import summarise
from roadperc_stream.tools.bench.long import folded, write_long

STEP_NS = 50_000_000


def test_frames_go_forwards_and_backwards():
    assert [folded(k, 4) for k in range(9)] == [0, 1, 2, 3, 2, 1, 0, 1, 2]
    assert [folded(k, 2) for k in range(5)] == [0, 1, 0, 1, 0]


def test_stamps_go_on_in_the_log_and_in_the_messages(bench_logs, tmp_path):
    path = tmp_path / "long.mcap"
    write_long(bench_logs["stereo"].path, path, 9)
    first_ns = summarise(bench_logs["stereo"].path).first_ns
    found = list(rp.frames(path, config={"stereo": {"method": "off"}}))
    assert [frame.input.stamp_ns for frame in found] == [first_ns + k * STEP_NS for k in range(9)]
    assert all(frame.metrics.missing == found[0].metrics.missing for frame in found)
    assert {frame.metrics.sync_skew_ms for frame in found} == {0.0}
    assert all(frame.metrics.odometry_status == "tracked" for frame in found[1:])


def test_contents_are_those_of_the_frames(bench_logs, tmp_path):
    path = tmp_path / "long.mcap"
    write_long(bench_logs["png"].path, path, 8)
    images = [frame.input.image.bgr for frame in rp.frames(path)]
    assert all((images[k] == images[6 - k]).all() for k in range(3))
    assert not (images[0] == images[3]).all()
