"""The page of events: a picture of each one's peak, and the command that shows it."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from roadperc_stream.errors import RoadpercError
from roadperc_stream.output.drawing.canvas import Canvas
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.output.text_table import Table
from roadperc_stream.system.files import write_whole
from roadperc_stream.system.progress import no_progress
from roadperc_stream.system.text import number
from roadperc_stream.view.frame_times import find_stop
from roadperc_stream.view.pictures import picture_of

from ..dataset.keys import LogKey
from ..html.page import render
from ..html.pictures import data_uri
from ..replaying import shown
from ..runs import Run
from .events import Event

DRAWN: Final = 40
"""Most events on the page, the worst ones; a frame of a log that was not kept takes a replay."""
_WIDTH_PX: Final = 640


def write_gallery(
    target: Path, events: Sequence[Event], runs: Mapping[LogKey, Run], title: str, peak: str, changed: Sequence[str]
) -> None:
    """Write the page of the worst events; ``changed`` are the settings ``KEY=VALUE`` of ``--set`` for replays.

    ``title`` is the heading, ``peak`` the column of the events' peaks.

    Raises:
        TargetError: the page cannot be written.
    """
    drawn, count = events[:DRAWN], number(len(events), "event")
    cards = []
    with frame_progress("drawing", enabled=True) as progress:
        for place, event in enumerate(drawn, 1):
            cards.append((event, *_picture(event, runs[event.key].table_of(event.peak_frame), changed)))
            progress(place, len(drawn))
    notes = [f"The page shows the worst {DRAWN} of {count}."] if len(events) > DRAWN else []
    page = {"stages": Table("", (), ()), "events": cards, "peak": peak, "notes": notes}
    write_whole(target, render([title], [("unchanged", count)], [], **page))


def _picture(event: Event, run: Run, changed: Sequence[str]) -> tuple[str, str]:
    """The picture of an event's peak as a data URI, or an empty text and why there is none."""
    try:
        with ExitStack() as files:
            found = shown(run, event.peak_frame, {}, "", changed, files, no_progress)
            assert found.number is not None  # a frame was asked for
            picture = picture_of(found.log, find_stop(found.log, found.number))
    except RoadpercError as error:
        return "", str(error)
    return data_uri(Canvas.resized(picture, min(_WIDTH_PX / picture.shape[1], 1.0)).pixels), ""
