"""Replay camera logs through one perception chain, frame by frame, the same way every time."""

from importlib.metadata import version

__version__ = version("roadperc_stream")
