"""A drive whose depth fails: tags, mounting and odometry carry lanes on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roadperc_stream.chain.step import ChainState, step
from roadperc_stream.config import load_config
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.metrics.lanes import lane_errors
from roadperc_stream.model import Absent, DepthImage
from roadperc_stream.resume.encoding import decode, encode
from roadperc_stream.system.time import TimeRange

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
SETTINGS = ("objects.enabled=false", "stereo.method=off")
FIRST, FRAMES = 2, 7


def failing(*settings):
    """Results and lane errors of a drive whose depth has errors of 30 % from its third frame on."""
    cfg, state, found = load_config(None, (*SETTINGS, *settings)), ChainState(), []
    for sample in open_input(ReplaySource(SAMPLE, time_range=TimeRange(frames=FRAMES)), cfg).samples():
        frame = sample.frame
        if sample.index >= FIRST:
            depth_m = frame.depth.depth_m
            noise = np.random.default_rng(sample.index).normal(1, 0.3, depth_m.shape).astype(np.float32)
            noisy = (depth_m * noise, np.inf)
            frame = replace(frame, depth=DepthImage(frame.depth.frame_id, lambda noisy=noisy: noisy))
        state, result = step(cfg, decode(encode(state), ChainState), frame)
        found.append((result, lane_errors(result.lanes, sample.truth.lanes)))
    return found


@pytest.mark.parametrize(
    ("settings", "source", "code"),
    [((), "held", "plane_held"), (("odometry.enabled=false",), "assumed", "plane_assumed")],
)
def test_lanes_go_on_where_depth_fails(settings, source, code):
    found = failing(*settings)
    assert [result.surface.source for result, _ in found] == ["depth"] * FIRST + [source] * (FRAMES - FIRST)
    for result, errors in found[FIRST:]:
        assert {result.lanes.side(side).status for side in ("left", "right")} == {"measured"}
        assert max(abs(errors.lane_left_error_m), abs(errors.lane_right_error_m)) < 0.3
        reasons = {(reason.source, reason.code) for reason in result.reasons()}
        assert ("surface", code) in reasons
        assert ("occupancy", "heights_unknown") in reasons
        assert isinstance(result.occupancy, Absent)
