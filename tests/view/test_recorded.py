"""Layouts of the sample stay as recorded.

After an intended change, ``pytest tests/view/test_recorded.py --force-regen`` records them again.
"""

import json

import pytest

from roadperc_stream.cli import replay
from roadperc_stream.view.layout.arrangement import layout_of
from roadperc_stream.view.layout.contents import OF_A_LIVE_REPLAY, contents_of
from tests.test_sample import SAMPLE


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """Some frames of the sample with all pictures on request."""
    path = tmp_path_factory.mktemp("recorded") / "out.mcap"
    assert replay.main([str(SAMPLE), str(path), "--frames", "3", "--overlay", "--debug"]) == 0
    return path


@pytest.mark.parametrize("of", ["input", "result", "running replay"])
def test_the_layout_equals_the_recorded_one(of, result, data_regression):
    contents = {"input": lambda: contents_of(SAMPLE, {}), "result": lambda: contents_of(result, {})}
    data_regression.check(json.loads(layout_of(contents.get(of, lambda: OF_A_LIVE_REPLAY)())))
