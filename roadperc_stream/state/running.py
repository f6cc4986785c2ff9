"""One frame of a replay: the chain's step on a sample, and its row."""

from roadperc_stream.chain.step import Timer, counted_from_here, step, untimed
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import FrameResult, Sample
from roadperc_stream.core.reasons import frame_reasons
from roadperc_stream.metrics import frame_metrics
from roadperc_stream.output.results import drop_beyond_ros_time
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.state.replay_state import ReplayMemory


def run_chain(
    cfg: ReplayConfig, memory: ReplayMemory, sample: Sample, timer: Timer = untimed
) -> tuple[ReplayMemory, FrameResult, FrameResult]:
    """Run the chain on a sample of a log.

    Returns:
        What is remembered then, the frame's result, and what of it a log can carry.
    """
    chain, made = step(cfg, memory.chain, sample.frame, timer)
    if memory.is_warming and sample.is_written:
        chain, made = counted_from_here(chain, made)
    result, written = drop_beyond_ros_time(made)
    shown = memory.shown
    if sample.is_written:
        shown = shown.after(result, frame_reasons(sample, result))
    is_warming = memory.is_warming and not sample.is_written
    return ReplayMemory(chain, sample.as_earlier, shown, is_warming), result, written


def run_frame(
    cfg: ReplayConfig, memory: ReplayMemory, log_id: str, sample: Sample, timer: Timer = untimed
) -> tuple[ReplayMemory, FrameResult, FrameResult, FrameMetrics]:
    """As ``run_chain``, and measure the result.

    Returns:
        What that gives, and the frame's row.
    """
    earlier = memory.earlier
    memory, result, written = run_chain(cfg, memory, sample, timer)
    with timer("metrics"):
        row = frame_metrics(cfg, log_id, sample, result, earlier)
    return memory, result, written, row
