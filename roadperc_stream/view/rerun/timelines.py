"""Timelines of a recording, and the panel that opens the viewer at a frame.

A blueprint cannot set the viewer's time cursor, but it can follow the end of a timeline. So the messages up to the
frame are also on a timeline that ends there.
"""

from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from roadperc_stream.system.time import END_OF_TIME_NS
from roadperc_stream.view.frame_times import Stop

LOG_TIME: Final = "message_log_time"


def set_log_time(recording: rr.RecordingStream, log_time_ns: int, stop: Stop | None) -> None:
    """Set the time of the next messages, also on the timeline that ends at the frame to show."""
    time = np.datetime64(log_time_ns, "ns")
    recording.set_time(LOG_TIME, timestamp=time)
    if stop is not None and log_time_ns <= stop.log_time_ns:
        recording.set_time(stop.name, timestamp=time)
    elif stop is not None:
        recording.disable_timeline(stop.name)


def send_curve(recording: rr.RecordingStream, entity: str, times_ns: Any, values: Any, stop: Stop | None) -> None:
    """Send values (N,) at log times (N,) in ns; those up to the frame to show also on its timeline."""
    for name, until_ns in ((LOG_TIME, END_OF_TIME_NS), *([(stop.name, stop.log_time_ns)] if stop else [])):
        chosen = times_ns <= until_ns
        if chosen.any():
            time = rr.TimeColumn(name, timestamp=times_ns[chosen].astype("datetime64[ns]"))
            recording.send_columns(entity, [time], rr.Scalars.columns(scalars=values[chosen]))


def time_panel(stop: Stop | None) -> rrb.TimePanel:
    """The panel of a recording; with a frame, on the timeline that ends there, at its end."""
    if stop is None:
        return rrb.TimePanel(timeline=LOG_TIME, state="collapsed")
    return rrb.TimePanel(timeline=stop.name, state="collapsed", play_state="following")
