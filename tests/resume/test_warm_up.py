"""A replay that starts in the middle of a log after a warm-up on the seconds before."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from roadperc_stream import log, read_metrics
from roadperc_stream.cli.replay import main
from roadperc_stream.config import load_config
from roadperc_stream.errors import ConfigError
from roadperc_stream.input import ReplaySource
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.resume.opening import ReplayOptions, open_replay, run_of
from roadperc_stream.schemas.topics import ODOMETRY_TOPIC, TRAJECTORY_TOPIC
from roadperc_stream.system.time import TimeRange
from tests import logs
from tests.analytic import STEP_NS
from tests.replaying import replay
from tests.resume.parts import inputs, results, write

CFG = load_config(None, ("sync.max_wait_s=0.2",))
ROAD = replace(logs.SMALL, width=96, height=72)
START = TimeRange(start_s=0.5)
FROM_START = ["odom_x_m", "odom_y_m", "odom_z_m", "odom_qx", "odom_qy", "odom_qz", "odom_qw"]


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return logs.write(tmp_path_factory.mktemp("drive") / "in.mcap", logs.items(18, road=ROAD))


@pytest.fixture(scope="module")
def warmed(source):
    replay(source, source.with_name("warmed.mcap"), CFG, time_range=START, warm_up_s=0.4)
    return source.with_name("warmed.mcap")


def test_written_frames_begin_at_the_start(source, warmed):
    rows = read_metrics(warmed)
    assert rows["frame"].to_list() == list(range(8))
    assert rows["stamp_ns"][0] == logs.START_NS + 10 * STEP_NS
    images = list(log.read(log.summarise(warmed), topics=["/camera/front/image"]))
    assert [m.log_time_ns for m in images] == [logs.START_NS + k * STEP_NS for k in range(10, 18)]


def test_odometry_starts_at_the_identity_and_is_tracked(warmed):
    first = read_metrics(warmed).row(0, named=True)
    assert [first[name] for name in FROM_START] == [0, 0, 0, 0, 0, 0, 1]
    assert first["odometry_status"] == "tracked"
    lengths = [len(m.data) for m in log.read(log.summarise(warmed), topics=[TRAJECTORY_TOPIC])]
    assert lengths == sorted(lengths)
    assert len(next(iter(log.read(log.summarise(warmed), topics=[ODOMETRY_TOPIC]))).data) > 0


def test_the_state_is_that_of_earlier_frames(source, warmed, tmp_path):
    """Equal to a replay from the start of the warm-up, except for the origin of the pose."""
    replay(source, tmp_path / "longer.mcap", CFG, time_range=TimeRange(start_s=0.1))
    rows, longer = read_metrics(warmed), read_metrics(tmp_path / "longer.mcap").tail(8)
    same = [n for n in rows.columns if n not in {"log_id", "frame", *FROM_START} and (n[-3:] != "_ms" or n[0] == "y")]
    for name in same:
        ours, theirs = rows[name], longer[name]
        if ours.dtype == pl.Float64:
            np.testing.assert_allclose(ours.to_numpy(), theirs.to_numpy(), rtol=1e-6, atol=1e-9, err_msg=name)
        else:
            assert ours.equals(theirs), name


def test_a_replay_of_the_output_says_that_it_begins_without_the_state(warmed, tmp_path):
    summary = replay(warmed, tmp_path / "again.mcap", CFG)
    assert any("began with a warm-up; this replay begins without its state" in note for note in summary.notes)
    assert read_metrics(tmp_path / "again.mcap")["odometry_status"][0] == "first"


def test_a_warmed_up_result_can_be_continued(source, warmed, tmp_path):
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    replay(source, first, CFG, time_range=TimeRange(0.5, 0.85), warm_up_s=0.4)
    replay(source, second, CFG, time_range=TimeRange(0.85), continued=first)
    assert results([first, second]) == results([warmed])


def test_a_warmed_up_result_without_a_complete_frame_cannot_be_continued(source, tmp_path):
    summary = replay(source, tmp_path / "a.mcap", CFG, time_range=TimeRange(0.5, 0.6), warm_up_s=0.4)
    assert any("cannot be continued: no frame is complete" in note for note in summary.notes)


def test_a_checkpoint_is_of_the_state_that_it_began_with(source, tmp_path):
    """Two results of the same messages, one with a warm-up, are continued."""
    runs = []
    for warm_up_s in (0.0, 0.4):
        first = tmp_path / f"{warm_up_s}.mcap"
        replay(source, first, CFG, time_range=TimeRange(0.5, 0.85), warm_up_s=warm_up_s)
        later = ReplaySource(source, time_range=TimeRange(0.85))
        opened = open_replay(later, CFG, ReplayOptions(continued=first))
        runs.append(run_of(opened, ReplayTarget(tmp_path / "out.mcap")))
    assert [name for name in runs[0] if runs[0][name] != runs[1][name]] == ["beginning"]


def test_late_messages_around_the_start(source, tmp_path):
    """A frame whose image came before the start is not written, even if its depth comes later."""
    late = [
        replace(m, log_time_ns=m.log_time_ns + 120_000_000 * (m.channel.topic == "/camera/front/depth"))
        for m in inputs(source)
    ]
    drive = write(tmp_path / "in.mcap", late)
    replay(drive, tmp_path / "out.mcap", CFG, time_range=START, warm_up_s=0.4)
    rows = read_metrics(tmp_path / "out.mcap")
    assert rows["stamp_ns"].to_list() == [logs.START_NS + k * STEP_NS for k in range(10, 18)]
    assert rows["missing"].to_list() == [[]] * 8


def test_a_warm_up_longer_than_the_log(source, tmp_path):
    summary = replay(source, tmp_path / "a.mcap", CFG, time_range=TimeRange(start_s=0.1), warm_up_s=5.0)
    assert summary.notes[0] == "warm-up: 0.1 s; the log has no more before the start"
    assert read_metrics(tmp_path / "a.mcap")["odometry_status"][0] == "tracked"
    summary = replay(source, tmp_path / "b.mcap", CFG, time_range=TimeRange(start_s=0.0), warm_up_s=5.0)
    assert summary.notes[0].startswith("warm-up: 0 s")
    replay(source, tmp_path / "c.mcap", CFG)
    assert results([tmp_path / "b.mcap"]) == results([tmp_path / "c.mcap"])


def test_without_an_earlier_frame_the_state_is_empty(source, tmp_path):
    messages = [
        m for m in inputs(source) if m.log_time_ns >= logs.START_NS + 10 * STEP_NS or "image" not in m.channel.topic
    ]
    drive = write(tmp_path / "in.mcap", messages)
    replay(drive, tmp_path / "out.mcap", CFG, time_range=START, warm_up_s=0.4)
    assert read_metrics(tmp_path / "out.mcap")["odometry_status"].to_list()[:2] == ["first", "tracked"]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--warm-up", "5"], "--warm-up needs --start"),
        (["--start", "1", "--warm-up", "5", "--continue", "o.mcap"], "--warm-up cannot be combined with --continue"),
        (["--start", "1", "--warm-up", "0"], "expected more than 0 seconds"),
        (["--resume"], "--resume needs --checkpoint-every"),
        (["--checkpoint-every", "-1"], "expected more than 0 seconds"),
    ],
)
def test_wrong_usage(capsys, options, expected):
    with pytest.raises(SystemExit) as ended:
        main(["in.mcap", "out.mcap", *options])
    assert ended.value.code == 2
    assert expected in capsys.readouterr().err


def test_wrong_use_of_the_function(source, tmp_path):
    with pytest.raises(ConfigError, match="expected a start"):
        replay(source, tmp_path / "out.mcap", CFG, warm_up_s=1.0)
    with pytest.raises(ConfigError, match="cannot be combined"):
        replay(source, tmp_path / "out.mcap", CFG, time_range=START, warm_up_s=1.0, continued=source)
