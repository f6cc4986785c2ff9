"""The messages of a frame's results."""

from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream.chain.step import State
from roadperc_stream.config import ReplayConfig
from roadperc_stream.metrics import frame_metrics
from roadperc_stream.model import Odometry, Reason, Sample, Truth
from roadperc_stream.output.results import result_messages
from roadperc_stream.schemas import roadperc_pb2 as pb
from tests.logs import SMALL
from tests.steps import step

POSES = {"/perception/odometry", "/perception/tf"}


@pytest.mark.parametrize("status", ["first", "tracked", "lost"])
def test_a_lost_frame_has_a_state_with_a_reason_and_no_pose(status):
    """The last known pose is not the pose of a lost frame; viewers would draw the car at a wrong place."""
    sample = Sample(0, 0, SMALL.frame(0), Truth())
    reason = Reason("odometry", "no_image") if status == "lost" else None
    _, result = step(ReplayConfig(), State(), sample.frame)
    result = replace(result, odometry=Odometry(status, np.eye(4), reason=reason))
    row = frame_metrics(ReplayConfig(), "log", sample, result)
    written = dict(result_messages(sample, result, row, (), (np.eye(4),)))
    assert POSES & set(written) == (set() if status == "lost" else POSES)
    state = pb.Odometry.FromString(written["/perception/odometry/state"])
    assert (state.status, state.reason.code) == (pb.Odometry.Status.Value(status.upper()), "no_image" if reason else "")
    assert ("odometry.lost" in row.reason_codes) == (status == "lost")
