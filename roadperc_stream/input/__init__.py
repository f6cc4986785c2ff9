"""From a log to frames.

The modules in the order of use: ``source`` names the log and its time range, ``plan`` reads it in a first pass,
``stream`` decodes the messages of the assigned ``roles``, ``order`` sorts them by stamp, ``sync`` groups the messages
of each frame with the calibrations and transforms that hold, ``assemble`` makes the sample.
"""

from roadperc_stream.input.replay_input import ReplayInput, input_of, open_input
from roadperc_stream.input.source import ReplaySource
