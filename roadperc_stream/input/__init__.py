"""From a log to frames.

The path of a frame: ``plan`` finds the part of the log, ``stream`` decodes the messages of the assigned ``roles``,
``latched`` keeps calibrations and transforms, ``sync`` groups what belongs together, ``assemble`` makes the sample.
"""

from roadperc_stream.input.problems import Problems
from roadperc_stream.input.replay_input import ReplayInput, input_of, open_input

__all__ = ["Problems", "ReplayInput", "input_of", "open_input"]
