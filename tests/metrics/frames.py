"""A frame of the analytic road and its result, with the truth of a test."""

import numpy as np

from roadperc_stream.chain.step import State
from roadperc_stream.config import ReplayConfig
from roadperc_stream.model import Boundary, Sample, Truth
from tests.analytic import Road, box
from tests.steps import step

CFG = ReplayConfig()


def sample_and_result(**truth):
    frame = Road().frame(detections=(box("Car", 0, 0, 10, 10), box("Unicorn", 300, 300, 340, 340)))
    _, result = step(CFG, State(), frame)
    return Sample(0, frame.stamp_ns, frame, Truth(**truth), (), 0), result


def boundary(offset_m, heading=0.0, side="left"):
    x = np.arange(0.0, 30.0)
    line = np.stack((x, offset_m + heading * x, np.zeros_like(x)), axis=-1)
    return Boundary(side, "measured", None, None, offset_m, heading, 0.0, line_ego_m=line)
