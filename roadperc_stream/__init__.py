"""Replay camera logs through one perception chain, frame by frame, the same way every time.

    import roadperc_stream as rp

    rp.replay("in.mcap", "out.mcap")                        # writes a log with results, and its tables
    for frame in rp.frames("in.mcap"): ...                  # yields the frames of a log with their results
    rp.Chain(camera).step(stamp_ns, depth_m=..., tags=...)  # runs the chain on your own arrays
    rp.draw(frame.input, frame.result)                      # returns an RGB image with the results
    rp.write_log("in.mcap", frames)                         # writes frames of your own arrays as a log
    rp.read_metrics("out.mcap")                             # returns a polars frame with a row per frame

Each name is imported when it is first used.
"""

TYPE_CHECKING = False  # importing typing would double the import time

__version__: str

if TYPE_CHECKING:
    from roadperc_stream.api import Chain as Chain
    from roadperc_stream.api import LogFrame as LogFrame
    from roadperc_stream.api import draw as draw
    from roadperc_stream.api import frames as frames
    from roadperc_stream.api import read_metrics as read_metrics
    from roadperc_stream.api import replay as replay
    from roadperc_stream.api import write_log as write_log
    from roadperc_stream.config import ReplayConfig as ReplayConfig
    from roadperc_stream.config import load_config as load_config
    from roadperc_stream.errors import RoadpercError as RoadpercError
    from roadperc_stream.geometry import Camera as Camera
    from roadperc_stream.geometry import mounting as mounting
    from roadperc_stream.model import Absent as Absent
    from roadperc_stream.model import Box as Box
    from roadperc_stream.model import Detection as Detection
    from roadperc_stream.model import Frame as Frame
    from roadperc_stream.model import FrameResult as FrameResult

_NAMES = {
    "api": ("Chain", "LogFrame", "draw", "frames", "read_metrics", "replay", "write_log"),
    "config": ("ReplayConfig", "load_config"),
    "errors": ("RoadpercError",),
    "geometry": ("Camera", "mounting"),
    "model": ("Absent", "Box", "Detection", "Frame", "FrameResult"),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = [*_HOMES, "__version__"]  # noqa: PLE0604


def __dir__() -> list[str]:
    return sorted(__all__)


if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """A public name or the version, imported or found at its first use."""
        from importlib import import_module  # noqa: PLC0415

        if name == "__version__":
            return import_module("importlib.metadata").version("roadperc_stream")
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"roadperc_stream.{_HOMES[name]}"), name)
