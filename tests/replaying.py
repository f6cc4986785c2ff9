"""A replay as tests ask for it: every option by its name."""

from roadperc_stream import loop
from roadperc_stream.input import ReplaySource
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.state.checkpoint import CheckpointOptions
from roadperc_stream.state.opening import Beginning

_TARGET = ("results_only", "on_request", "force")
_WATCHER = ("progress", "opened")


def replay(
    source, target, cfg, *, continued=None, warm_up_s=0.0, checkpoint_every_s=None, resume=False, threads=1, **options
):
    """Replay a log; what is not named here are options of the source, the target and the watcher."""
    of_target = {name: options.pop(name) for name in _TARGET if name in options}
    of_watcher = {name: options.pop(name) for name in _WATCHER if name in options}
    return loop.replay(
        ReplaySource(source, **options),
        ReplayTarget(target, **of_target),
        cfg,
        beginning=Beginning(continued, warm_up_s),
        checkpoints=CheckpointOptions(checkpoint_every_s, resume),
        watcher=loop.Watcher(**of_watcher),
        threads=threads,
    )
