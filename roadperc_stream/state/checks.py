"""What the types of a state do not say: lengths that belong together, numbers that are numbers, cameras that see.

Whatever a state says is bounded by what the settings, their limits above all, let a replay leave.
"""

from typing import Final

from roadperc_stream.core.config import LimitsConfig, ReplayConfig
from roadperc_stream.core.time import END_OF_TIME_NS
from roadperc_stream.errors import StateError
from roadperc_stream.log import LostSpan
from roadperc_stream.state.input_checks import END_OF_FRAMES, END_OF_LOG_TIMES_NS, require_input
from roadperc_stream.state.memory_checks import require_chain, require_shown, require_transform
from roadperc_stream.state.replay_state import ReplayMemory, ReplayState

_MOST_GAPS: Final = 10_000


def require_sense(state: ReplayState, cfg: ReplayConfig) -> ReplayState:
    """A state as some replay can have left it; what is remembered with other settings is used by nobody.

    Raises:
        StateError: none can have.
    """
    try:
        require_input(state.input, cfg.limits)
        _require_gaps(state.lost)
        if not state.differences(cfg):
            _require_memory(state.memory, cfg)
    except (ValueError, TypeError) as error:
        raise StateError(f"damaged: {error}") from error
    return state


def require_numbers_for(state: ReplayState, frames: int) -> None:
    """Check that so many more frames still have a number.

    Raises:
        StateError: they do not.
    """
    if state.input.numbers.next + frames > END_OF_FRAMES:
        raise StateError(f"frame {state.input.numbers.next} and {frames} more: a log numbers {END_OF_FRAMES} at most")


def _require_gaps(gaps: tuple[LostSpan, ...]) -> None:
    if len(gaps) > _MOST_GAPS:
        raise ValueError(f"{len(gaps)} gaps: expected {_MOST_GAPS} at most")
    times = (time_ns for gap in gaps for time_ns in (gap.first_ns, gap.last_ns) if time_ns is not None)
    if any(not 0 <= time_ns < END_OF_LOG_TIMES_NS for time_ns in times):
        raise ValueError("a time out of its range")


def _require_memory(memory: ReplayMemory, cfg: ReplayConfig) -> None:
    require_chain(memory.chain, cfg, _most_objects(cfg.limits))
    require_shown(memory.shown)
    earlier = memory.earlier
    if earlier is not None and not 0 <= earlier.stamp_ns < END_OF_TIME_NS:
        raise ValueError("a time out of its range")
    if earlier is not None and earlier.odom_T_ego is not None:
        require_transform(earlier.odom_T_ego)


def _most_objects(limits: LimitsConfig) -> int:
    """As if every detection of every frame were a new object."""
    return END_OF_FRAMES * limits.detections
