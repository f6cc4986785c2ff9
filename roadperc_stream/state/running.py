"""One frame of a replay: the chain's step on a sample, and its row."""

from dataclasses import replace

from roadperc_stream.chain.step import Timer, counted_from_here, step, untimed
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import FrameResult, Sample
from roadperc_stream.metrics import frame_metrics
from roadperc_stream.output.results import drop_beyond_ros_time
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.state.replay_state import ReplayMemory


def run_frame(
    cfg: ReplayConfig, memory: ReplayMemory, log_id: str, sample: Sample, timer: Timer = untimed
) -> tuple[ReplayMemory, FrameResult, FrameResult, FrameMetrics]:
    """Run the chain on a sample of a log and measure it.

    Returns:
        What is remembered then, the frame's result, what of it a log can carry, and its row.
    """
    chain, made = step(cfg, memory.chain, sample.frame, timer)
    if memory.is_warming and sample.is_written:
        chain, made = counted_from_here(chain, made)
    result, written = drop_beyond_ros_time(made)
    row = frame_metrics(cfg, log_id, sample, result, memory.earlier)
    is_warming = memory.is_warming and not sample.is_written
    return replace(memory, chain=chain, earlier=sample.as_earlier, is_warming=is_warming), result, written, row
