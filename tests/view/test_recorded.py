"""Layouts of the sample, and its Rerun recording, stay as recorded.

After an intended change, ``pytest tests/view/test_recorded.py --force-regen`` records them again.
"""

import json

import pytest

from roadperc_stream.cli import replay
from roadperc_stream.view.layout.arrangement import layout_of
from roadperc_stream.view.layout.contents import OF_A_LIVE_REPLAY, contents_of
from roadperc_stream.view.rerun import save_recording
from tests import summaries
from tests.test_sample import SAMPLE
from tests.view.rerun.chunks import recorded


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


def test_the_recording_equals_the_recorded_one(result, tmp_path, ndarrays_regression):
    save_recording(result, tmp_path / "out.rrd", {})
    found = recorded(tmp_path / "out.rrd")
    shown = {path: [sorted(entity.archetypes), *map(_without_varying, entity.static + entity.rows)]
             for path, entity in sorted(found.items()) if "/times/" not in path}  # fmt: skip
    summaries.check(ndarrays_regression, {"rerun": summaries.of_document(shown)})


def _without_varying(row):
    """Without row numbers and compressed pictures."""
    return {name: value for name, value in sorted(row.items()) if not name.startswith("rerun.") and "blob" not in name}
