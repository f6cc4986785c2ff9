"""One step of the chain on a frame that is not prepared."""

from contextlib import nullcontext

from roadperc_stream.chain import step as chain
from roadperc_stream.chain.prepare import prepare


def step(cfg, state, frame, timer=nullcontext):
    """Prepare a frame and run the chain on it."""
    return chain.step(cfg, state, prepare(cfg, frame, timer), timer)
