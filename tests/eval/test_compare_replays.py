"""Deliberate damage to whole replays is found, under the name of what it damages; an unchanged replay is identical."""

from functools import partial
from pathlib import Path

import pytest

from roadperc_stream import log
from roadperc_stream.cli.compare import main
from roadperc_stream.config import load_config
from roadperc_stream.log import LogWriter
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.time import TimeRange
from tests.eval.tables import outcome
from tests.replaying import replay

pytestmark = pytest.mark.long

compare = partial(outcome, main)

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
SEGMENTATION = ROLES["segmentation"].topic
DROPPED = range(10, 14)
"""0.2 s without segmentation: shorter than a lane is held by default."""
FRAMES = 16


def replayed(source, target, *settings):
    replay(source, target, load_config(None, settings), time_range=TimeRange(frames=FRAMES))
    return target


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Replays of the sample: unchanged, twice; with a coarse plane fit; without some tags, lanes held and not held."""
    folder = tmp_path_factory.mktemp("runs")
    copy = without_tags(SAMPLE, folder / "dropped.mcap")
    return {
        "base": replayed(SAMPLE, folder / "base.mcap"),
        "again": replayed(SAMPLE, folder / "again.mcap"),
        "coarse": replayed(SAMPLE, folder / "coarse.mcap", "surface.inlier_m=1"),
        "held": replayed(copy, folder / "held.mcap"),
        "lost": replayed(copy, folder / "lost.mcap", "lanes.hold_s=0"),
    }


def without_tags(source, target):
    with LogWriter(target) as writer:
        seen = 0
        for message in log.read(log.summarise(source)):
            tags = message.channel.topic == SEGMENTATION
            if not tags or seen not in DROPPED:
                writer.write(message)
            seen += tags
    return target


def test_an_unchanged_run_is_identical(runs, capsys):
    code, text, _ = compare(capsys, runs["base"], runs["again"], "--exact")
    assert code == 0
    assert " 0 differ\n" in text


def test_a_coarse_plane_fit_changes_the_surface_alone(runs, capsys):
    code, text, error = compare(capsys, runs["base"], runs["coarse"], "--exact")
    assert code == 1
    assert error.startswith("differs from the base run: surface_")
    assert "  surface.camera_height_m: " in text
    assert "  surface_angle_error_deg: " in text
    assert "stereo" not in text.partition("\nfields of")[2]
    allowed = ("--allow", "surface_angle*=1", "--allow", "lane_*=1", "--allow", "*_m=1")  # no time is allowed by name
    assert compare(capsys, runs["base"], runs["coarse"], *allowed)[0] == 0


def test_lanes_that_are_not_held_lose_coverage(runs, capsys):
    code, text, error = compare(capsys, runs["held"], runs["lost"], "--exact")
    assert code == 1
    assert "lane_left_offset_m.coverage" in error
    assert "lane_right_offset_m.coverage" in error
    assert "surface" not in error
    assert "worse, lanes coverage (and " in text
    assert "lane_left_status: held → none, in 4 frames" in text
    assert "lanes.message: present → none, in 4 frames" in text
    assert "frame 10, stamp" in text


def test_runs_of_two_logs_need_other_log(runs, capsys):
    assert "--other-log" in compare(capsys, runs["base"], runs["held"])[2]
    code, text, error = compare(capsys, runs["base"], runs["held"], "--other-log", "--exact")
    assert (code, "lane_left_status.measured" in error) == (1, True)
    assert "lane_left_status: measured → held, in 4 frames" in text


def test_message_fields_are_tolerated_and_ignored_like_columns(runs, capsys):
    ignored = [f"--ignore={name}" for name in ("*_*", "drivable*", "occupancy*", "lanes*")]
    options = ("--exact", "--allow", "1000%", *ignored, "--tolerance", "surface.*=0.5")
    code, text, _ = compare(capsys, runs["base"], runs["coarse"], *options)
    assert code == 0
    assert f"within tolerance: surface.normal.x (in {FRAMES} frames, by up to 0.0" in text
    assert " 0 differ\n" in text


def test_pictures_on_request_are_compared_by_their_pixels(tmp_path, capsys):
    logs = [tmp_path / f"{name}.mcap" for name in ("one", "same", "other")]
    for path, inlier_m in zip(logs, (0.05, 0.05, 0.5), strict=True):
        cfg = load_config(None, (f"surface.inlier_m={inlier_m}",))
        replay(SAMPLE, path, cfg, time_range=TimeRange(frames=1), on_request=("overlay", "debug"))
    assert compare(capsys, *logs[:2], "--exact")[0] == 0
    code, text, errors = compare(capsys, logs[0], logs[2], "--exact")
    assert (code, "/perception/overlay" in text or "overlay.data" in text) == (1, True), text + errors
