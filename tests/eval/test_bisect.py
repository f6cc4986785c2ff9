"""roadperc-bisect: the excerpt fails alone and no shorter one does, it names the setting, and continues."""

import shlex
from contextlib import nullcontext

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from roadperc_stream.cli import bisect, check, replay
from roadperc_stream.config import load_config
from roadperc_stream.eval.bisect import bisect as searching
from roadperc_stream.eval.bisect import excerpts
from roadperc_stream.eval.bisect.bisect import changed_settings, needed_settings, shortest, with_settings
from roadperc_stream.eval.bisect.excerpts import ReplayVerdict
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.system.time import NS_PER_S
from tests import logs
from tests.analytic import STEP_NS, Road
from tests.eval.tables import outcome
from tests.faulty_log import with_fault

FRAMES, FAULT_AT, LOST = 60, 30, 20
INTERRUPTED = 4
HELD = 12
"""Held frames that the criterion needs; by default the lane is held for 0.5 s, 10 frames."""
CRITERIA = f"""
[[criterion]]
name = "height"
column = "camera_height_m"
statistic = "max"
most = 100

[[criterion]]
name = "held"
column = "lane_left_offset_std_m"
statistic = "max"
most = 0.001
least_frames = {HELD}
filter = "lane_left_status = 'held'"
"""
SETTINGS = ("lanes.hold_s=3", "seed=3", "lanes.process_noise=0.6", "surface.inlier_m=0.06")
BASE = "odometry.enabled = false\nobjects.enabled = false\noccupancy.enabled = false\n"


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A log of three seconds at 20 Hz; in the middle the segmentation is missing for a second."""
    folder = tmp_path_factory.mktemp("bisect")
    clean = logs.write(folder / "clean.mcap", logs.items(FRAMES, Road(width=160, height=120)))
    return with_fault(clean, folder / "drive.mcap", 1, FAULT_AT * STEP_NS / NS_PER_S, LOST * STEP_NS / NS_PER_S)


@pytest.fixture
def given(drive, tmp_path, monkeypatch):
    """The arguments; the current folder is empty except for the criteria and the base."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "limits.toml").write_text(CRITERIA)
    (tmp_path / "base.toml").write_text(BASE)
    files = ("--criteria", "limits.toml", "--config", "base.toml", "--base", "base.toml")
    return [drive, *files, *(f"--set={setting}" for setting in SETTINGS)]


def test_an_interrupted_search_continues_and_finds_the_excerpt_and_the_setting(given, capsys, tmp_path, monkeypatch):
    original, calls = excerpts.ExcerptReplays._replayed, []

    def replayed(self, *arguments):
        calls.append(self.count)
        if len(calls) == INTERRUPTED:
            raise KeyboardInterrupt
        return original(self, *arguments)

    shown = []
    monkeypatch.setattr(searching, "job_progress", lambda: nullcontext(lambda *values: shown.append(values)))
    monkeypatch.setattr(excerpts.ExcerptReplays, "_replayed", replayed)
    code, _, err = outcome(bisect.main, capsys, *given)
    assert (code, err) == (3, "error: interrupted; run the same command again to continue\n")
    assert names(tmp_path) == ["base.toml", "drive.bisect.replays.json", "limits.toml"]
    code, out, err = outcome(bisect.main, capsys, *given)
    assert (code, err) == (0, "")
    assert calls[INTERRUPTED:] == list(range(INTERRUPTED, calls[-1] + 1))
    results = [f"drive.bisect.{suffix}" for suffix in ("mcap", "metrics.parquet", "objects.parquet")]
    assert names(tmp_path) == ["base.toml", *results, "limits.toml"]
    lines = dict(line.split(maxsplit=1) for line in out.splitlines())
    assert lines["settings"] == "1 of 4 changes needed: lanes.hold_s=3.0"
    assert int(lines["replays"]) == calls[-1] + 1 <= 25
    assert (shown[0], shown[-1][0]) == (("replay 1", 1, FRAMES), f"replay {lines['replays']}")
    assert all(done <= total for _, done, total in shown)
    assert lines["show"] == f"roadperc-view drive.bisect.mcap --frame {HELD}"
    rows = pl.read_parquet(results[1])
    assert rows["lane_left_status"].to_list() == ["measured", *["held"] * HELD]
    assert (rows["stamp_ns"][0] - logs.START_NS) / STEP_NS >= FAULT_AT - 1
    assert replay.main([*shlex.split(lines["replay"])[1:], "--quiet"]) == 0
    assert check.main([*shlex.split(lines["judge"])[1:]]) == 1
    assert_frame_equal(pl.read_parquet("again.metrics.parquet").drop(TIME_COLUMNS), rows.drop(TIME_COLUMNS))
    assert "drive.bisect.mcap: exists; pass --force" in outcome(bisect.main, capsys, *given)[2]


def names(folder):
    return sorted(path.name for path in folder.iterdir())


class Judging:
    """Replays that fail if ``fails`` says so about the window in frames after the worst one, or about the settings."""

    def __init__(self, fails):
        self.fails, self.windows = fails, []

    def verdict(self, cfg, window):
        self.windows.append(window)
        return ReplayVerdict("limit" if self.fails(cfg, window) else "")


@pytest.mark.parametrize(("first", "last"), [(0, 0), (-19, 0), (-25, 3), (-7, 13), (-150, 150), (-4010, 0)])
def test_the_excerpt_has_the_frames_that_the_failure_needs(first, last):
    whole = ReplayVerdict("limit", "", 10**18, 10**8, 4013, 1987)

    def fails(_, window):
        return window[0] < 10**18 + first * 10**8 and 10**18 + last * 10**8 < window[1]

    judging = Judging(fails)
    window = shortest(judging, load_config(), whole)
    assert [(limit_ns - 10**18) / 10**8 for limit_ns in window] == [first - 0.5, last + 0.5]
    assert len(set(judging.windows)) == len(judging.windows)
    assert len(judging.windows) <= (16 if last - first < 40 else 31)


@pytest.mark.parametrize(
    ("given", "fails", "needed"),
    [
        ((), lambda _: True, ()),
        (("seed=1", "lanes.hold_s=3"), lambda _: True, ()),
        (
            ("seed=1", "lanes.hold_s=3", "lanes.use_odometry=false"),
            lambda cfg: cfg.seed and cfg.lanes.hold_s == 3,
            (0, 1),
        ),
        (("stereo.p1=1000", "stereo.p2=2000", "seed=1"), lambda cfg: cfg.stereo.p1 == 1000, (0, 1)),
    ],
    ids=["no change", "no needed change", "two needed", "not valid without the other"],
)
def test_the_needed_settings(given, fails, needed):
    base, cfg = load_config(), load_config(None, given)
    changed = changed_settings(base, cfg)
    found = needed_settings(Judging(lambda part, _: fails(part)), base, cfg, changed, (0, 1))
    assert set(found) == {given[place].partition("=")[0] for place in needed}


def test_settings_are_those_that_differ():
    base, cfg = load_config(None, ["lanes.hold_s=1"]), load_config(None, ["seed=2", "surface.classes=road,sidewalk"])
    keys = changed_settings(base, cfg)
    assert keys == ("seed", "surface.classes", "lanes.hold_s")
    assert with_settings(base, cfg, keys) == cfg
    assert with_settings(base, cfg, ("seed",)) == load_config(None, ["lanes.hold_s=1", "seed=2"])


def test_nothing_fails_is_one_line_and_exit_code_1(given, capsys, tmp_path):
    code, out, err = outcome(bisect.main, capsys, *given[:7], "--criterion", "held")
    expected = "nothing fails on the whole log: held is skipped: 10 frames, expected 12 at least"
    assert (code, out, err) == (1, "", f"{given[0]}: {expected}\n")
    assert names(tmp_path) == ["base.toml", "limits.toml"]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--criterion", "hold"), "limits.toml: no criterion 'hold'; did you mean held?"),
        (("--base", "none.toml"), "none.toml: No such file or directory"),
        (("--out", "limits.toml"), "limits.toml: expected a name that ends in .mcap"),
        (("--out", "base.mcap"), "refusing to overwrite base.mcap"),
    ],
)
def test_errors_come_before_the_first_replay(given, capsys, tmp_path, options, expected):
    (tmp_path / "base.mcap").write_bytes(given[0].read_bytes())
    code, out, err = outcome(bisect.main, capsys, *given, *options)
    assert (code, out) == (3, "")
    assert expected in err
    assert err.count("\n") == 1
