"""One frame of a replay: the chain's step on a sample, in its parts, and its row."""

from dataclasses import replace

from roadperc_stream.chain.step import Sight, Timer, Whereabouts, locate, perceive, see, untimed
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import FrameResult, Sample
from roadperc_stream.core.reasons import frame_reasons
from roadperc_stream.metrics import frame_metrics
from roadperc_stream.output.results import drop_beyond_ros_time
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.state.replay_state import ReplayMemory


def run_locating(
    cfg: ReplayConfig, memory: ReplayMemory, sample: Sample, sight: Sight, timer: Timer = untimed
) -> tuple[ReplayMemory, Whereabouts]:
    """Run the first part of the chain on what a sample shows.

    Returns:
        What this part remembers then, the rest of the memory being that of before, and where the car is.
    """
    place = locate(cfg, memory.chain, sight, timer)
    if memory.is_warming and sample.is_written:
        place = place.counted_from_here()
    return replace(memory, chain=place.state, is_warming=memory.is_warming and not sample.is_written), place


def run_perceiving(
    cfg: ReplayConfig, memory: ReplayMemory, sample: Sample, place: Whereabouts, timer: Timer = untimed
) -> tuple[ReplayMemory, FrameResult, FrameResult]:
    """Run the second part of the chain; of the memory what only the first one needs is not asked for.

    Returns:
        What is remembered then, the frame's result, and what of it a log can carry.
    """
    chain, made = perceive(cfg, memory.chain, place, timer)
    result, written = drop_beyond_ros_time(made)
    shown = memory.shown
    if sample.is_written:
        shown = shown.after(result, frame_reasons(sample, result))
    is_warming = memory.is_warming and not sample.is_written
    return ReplayMemory(chain, sample.as_earlier, shown, is_warming), result, written


def run_frame(
    cfg: ReplayConfig, memory: ReplayMemory, log_id: str, sample: Sample, timer: Timer = untimed
) -> tuple[ReplayMemory, FrameResult, FrameResult, FrameMetrics]:
    """Run the whole chain, and measure the result.

    Returns:
        What is remembered then, the frame's result, what of it a log can carry, and the frame's row.
    """
    earlier = memory.earlier
    _, place = run_locating(cfg, memory, sample, see(cfg, sample.frame, timer), timer)
    memory, result, written = run_perceiving(cfg, memory, sample, place, timer)
    with timer("metrics"):
        row = frame_metrics(cfg, log_id, sample, result, earlier)
    return memory, result, written, row
