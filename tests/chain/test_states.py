"""What the chain keeps between frames: plain numbers and arrays in the order of C, none of which can be changed."""

from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest

from roadperc_stream.chain.step import ChainState, step
from roadperc_stream.config import load_config
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.system.time import TimeRange

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"


def faults(value, where):
    """Names of everything below a value that could be changed, or that its bytes would not give back as it was."""
    if isinstance(value, tuple):
        return [name for k, item in enumerate(value) for name in faults(item, f"{where}[{k}]")]
    if isinstance(value, np.ndarray):
        return [where] if value.flags.writeable or not value.flags.c_contiguous else []
    if is_dataclass(value) and value.__dataclass_params__.frozen:
        return [name for f in fields(value) for name in faults(getattr(value, f.name), f"{where}.{f.name}")]
    return [] if type(value) in {type(None), bool, int, float, str} else [f"{where}: {type(value).__name__}"]


@pytest.mark.parametrize("settings", [(), ("odometry.features=sift",)])
def test_a_state_holds_plain_values_that_cannot_be_changed(settings):
    """After frames in which every stage had something to keep."""
    cfg, state = load_config(None, settings), ChainState()
    for sample in open_input(ReplaySource(SAMPLE, time_range=TimeRange(frames=3)), cfg).samples():
        state, _ = step(cfg, state, sample.frame)
        assert faults(state, "state") == []
    assert state.lanes.left.track.measured_ns == state.lanes.right.track.measured_ns == state.stamp_ns
    assert state.objects.tracks
    assert state.odometry.keyframe is not None
