"""``roadperc-replay --verify``: a replay that can be repeated is identical; a stage that cannot be is named."""

import os
import re
import sys
from itertools import count
from pathlib import Path

import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli.replay import main
from roadperc_stream.eval.verify import verify
from roadperc_stream.output.target import ReplayTarget
from tests.test_sample import SAMPLE

SHORT = ("--set", "sync.max_wait_s=0.2", "--set", "stereo.method=off", "--only", "lanes", "--end", "0.6")
STAGES = """
import random, threading
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from roadperc_stream.model import Boundary, Lanes

FRAMES = count()

def lanes(x):
    return Lanes((Boundary("left", "measured", offset_m=float(x), heading=0.0, curvature_per_m=0.0),))

class Random:
    def __call__(self, cfg, state, *inputs):
        return state, lanes(random.random())

class Global:
    def __call__(self, cfg, state, *inputs):
        return state, lanes(next(FRAMES))

class Hidden:
    def __init__(self):
        self.frames = count()

    def __call__(self, cfg, state, *inputs):
        return state, lanes(next(self.frames))

class Threads:
    def __call__(self, cfg, state, *inputs):
        return state, lanes(any(thread.name == "roadperc_1" for thread in threading.enumerate()))

class Counting:
    @dataclass(frozen=True)
    class State:
        frames: int = 0

    def __call__(self, cfg, state, *inputs):
        return self.State(state.frames + 1), lanes(state.frames)
"""
MODULES = count()


@pytest.fixture
def verified(tmp_path, monkeypatch, capsys):
    """Verifies a short replay in an empty folder: its exit code, its output without the first line, its errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])

    def run(*options, stage=""):
        module = f"verified_{next(MODULES)}"
        (tmp_path / f"{module}.py").write_text(STAGES)
        own = ("--set", f"lanes.implementation={module}:{stage}") if stage else ()
        code = main([str(SAMPLE), "out.mcap", "--verify", *SHORT, *own, *options])
        printed = capsys.readouterr()
        assert not list(tmp_path.glob(".*"))
        return code, printed.out.splitlines(), printed.err.strip()

    return run


OPTIONS = {
    "whole": (),
    "one thread": ("--threads", "1"),
    "start": ("--start", "0.1"),
    "warm-up": ("--start", "0.1", "--warm-up", "0.1"),
    "frames": ("--frames", "11"),
    "results only": ("--results-only",),
    "pictures": ("--overlay", "--debug"),
    "checkpoints": ("--checkpoint-every", "0.1", "--resume"),
}


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_a_replay_is_identical_under_any_option(verified, options):
    code, printed, errors = verified(*options)
    messages = sum(log.summarise(Path("out.mcap")).counts.values())
    assert (code, printed[-1], errors) == (0, f"identical: {messages} messages, 2 tables", "")
    assert not [line for line in printed if "too short" in line]


def test_a_continued_replay_is_identical(verified):
    main([str(SAMPLE), "earlier.mcap", *SHORT[:-1], "0.3", "--quiet"])
    code, printed, _ = verified("--start", "0.3", "--continue", "earlier.mcap", "--end", "1")
    assert (code, printed[-1][:10]) == (0, "identical:")


def test_all_stages_are_identical(tmp_path, capsys):
    assert main([str(SAMPLE), str(tmp_path / "out.mcap"), "--verify", "--end", "0.5", *SHORT[:2]]) == 0
    assert re.fullmatch(r"identical: \d+ messages, 2 tables", capsys.readouterr().out.splitlines()[-1])


def test_a_log_that_is_too_short_to_cut_says_so(verified):
    code, printed, _ = verified("--set", "sync.max_wait_s=2")
    assert (code, printed[-2]) == (
        0,
        "note: too short to cut (sync.max_wait_s is 2 s), so replayed again in one part",
    )


REASONS = {
    "Random": (r"0\.\d+ → 0\.\d+ in frame 0", "not deterministic: the same replay again differs too"),
    "Global": (r"0 → 12 in frame 0", "not deterministic: the same replay again differs too"),
    "Hidden": (r"2 → 0 in frame 2", "depends on the cut before frame 2: it keeps values of earlier frames outside"),
    "Threads": (r"0 → 1 in frame \d+", "depends on the threads: 1 and 2 differ"),
}


@pytest.mark.parametrize("stage", REASONS)
def test_a_stage_that_cannot_be_repeated_is_named_with_the_reason(verified, stage):
    code, printed, error = verified("--threads", "1", stage=stage)
    values, reason = REASONS[stage]
    field = rf"differs: /perception/lanes boundaries\[0\]\.offset_m {values} \(stamp \d+ ns\)"
    assert code == 1
    assert re.match(rf"{field}; made by lanes \(verified_\d+:{stage}\); {re.escape(reason)}", error), error
    assert not [line for line in printed if "identical" in line]
    assert Path("out.mcap").exists()


def test_a_stage_that_keeps_its_state_is_identical(verified):
    code, printed, _ = verified(stage="Counting")
    assert (code, printed[-1][:10]) == (0, "identical:")


def test_a_row_that_differs_is_named(verified, monkeypatch):
    """No stage does this: the tables are compared although the messages are equal."""
    verified()
    changed = pl.read_parquet("out.metrics.parquet").with_columns(
        pl.when(pl.col("frame") == 3)
        .then(9.5)
        .otherwise("surface_height_hindsight_m")
        .alias("surface_height_hindsight_m")
    )

    def with_other_row(*arguments):
        changed.write_parquet(ReplayTarget(arguments[1].path).metrics)
        return verify(*arguments)

    monkeypatch.setattr("roadperc_stream.eval.verify.verify", with_other_row)
    code, _, error = verified("--force")
    assert code == 1
    assert re.match(
        r"differs: surface_height_hindsight_m .* in frame 3 .*; made by surface; in the table of metrics", error
    )


@pytest.mark.parametrize("options", [("--live",), ()])
def test_what_cannot_be_read_again_is_refused(tmp_path, capsys, options):
    os.mkfifo(tmp_path / "pipe")
    source = str(SAMPLE) if options else str(tmp_path / "pipe")
    with pytest.raises(SystemExit) as end:
        main([source, str(tmp_path / "out.mcap"), "--verify", *options])
    assert end.value.code == 2
    assert ("--verify cannot be combined with --live" if options else "expected a file, found a pipe") in (
        capsys.readouterr().err
    )
