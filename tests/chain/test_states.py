"""What the stages remember: nothing in it can be changed, so that a state kept for later stays what it was."""

from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path

import numpy as np
import pytest

from roadperc_stream.chain.step import ChainState, step
from roadperc_stream.core.config import load_config
from roadperc_stream.core.time import TimeRange
from roadperc_stream.input import ReplaySource, open_input

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
PLAIN = (type(None), bool, int, float, str, bytes, Enum)


def changeable(value, where):
    """Names of everything below a value that could be changed in place."""
    if isinstance(value, PLAIN):
        return []
    if isinstance(value, tuple):
        return [name for k, item in enumerate(value) for name in changeable(item, f"{where}[{k}]")]
    if isinstance(value, np.ndarray):
        return [where] if value.flags.writeable else []
    if is_dataclass(value) and value.__dataclass_params__.frozen:
        return [name for f in fields(value) for name in changeable(getattr(value, f.name), f"{where}.{f.name}")]
    return [f"{where}: {type(value).__name__}"]


@pytest.fixture(scope="module")
def state():
    """After frames in which every stage had something to remember."""
    cfg = load_config()
    state = ChainState()
    for sample in open_input(ReplaySource(SAMPLE, time_range=TimeRange(frames=3)), cfg).samples():
        state, _ = step(cfg, state, sample.frame)
    return state


def test_nothing_that_is_remembered_can_be_changed(state):
    assert state.lanes.left.track.measured_ns == state.lanes.right.track.measured_ns == state.stamp_ns
    assert state.objects.tracks
    assert state.odometry.keyframe is not None
    assert changeable(state, "state") == []
