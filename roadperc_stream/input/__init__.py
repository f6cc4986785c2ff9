"""From a log to frames.

The path of a frame: ``source`` says which part of which log, ``plan`` finds it in a first pass, ``stream`` decodes the
messages of the assigned ``roles``, ``order`` puts them in the order of their stamps, ``latched`` keeps calibrations and
transforms, ``sync`` groups what belongs together, ``assemble`` makes the sample.
"""

from roadperc_stream.input.replay_input import ReplayInput, input_of, open_input
from roadperc_stream.input.source import ReplaySource
