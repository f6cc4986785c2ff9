"""The first frames of the sample, replayed and saved as a recording once for all tests."""

from pathlib import Path

import pytest

from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.view.rerun import save_recording
from tests.view.rerun.chunks import recorded

SAMPLE = Path(__file__).parents[3] / "logs" / "sample.mcap"
FRAMES = 4


@pytest.fixture(scope="package")
def output(tmp_path_factory):
    target = tmp_path_factory.mktemp("seen") / "out.mcap"
    assert replay_main([str(SAMPLE), str(target), "--quiet", "--frames", str(FRAMES)]) == 0
    return target


@pytest.fixture(scope="package")
def saved(output):
    exported = save_recording(output, output.with_suffix(".rrd"), {})
    assert (exported.frames, exported.notes, dict(exported.problems)) == (FRAMES, (), {})
    return recorded(output.with_suffix(".rrd"))
