"""A replay as tests ask for it: every option by its name."""

from roadperc_stream import loop
from roadperc_stream.input import ReplaySource
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import Callbacks
from roadperc_stream.resume.opening import ReplayOptions

_TARGET = ("results_only", "on_request", "force")
_OPTIONS = ("continued", "warm_up_s", "checkpoint_every_s", "resume", "threads")
_CALLBACKS = ("on_progress", "on_start", "on_frame")


def replay(source, target, cfg, *, progress=None, **options):
    """Replay a log; what is not named here are options of the source, the target, the replay and the callbacks."""
    if progress is not None:
        options["on_progress"] = progress
    of_target, of_replay, callbacks = (
        {name: options.pop(name) for name in names if name in options} for names in (_TARGET, _OPTIONS, _CALLBACKS)
    )
    return loop.replay(
        ReplaySource(source, **options),
        ReplayTarget(target, **of_target),
        cfg,
        ReplayOptions(**of_replay),
        Callbacks(**callbacks),
    )
