"""``roadperc-find``: find events in many logs by an SQL condition."""

import argparse
from pathlib import Path

from roadperc_stream.cli.completers import RUNS, files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_shared, command_parser, parse
from roadperc_stream.cli.values import number

_EXAMPLE = """\
example:
  roadperc-find dataset "time_to_impact_s < 2 and lane_change <> 'none'"
  roadperc-find dataset "abs(lane_left_error_m) > 0.3" --gap 0.5 --min-seconds 1
  roadperc-find dataset "objects.label = 'Pedestrian' and objects.distance_m < 10 and step_m > 0.5"
  roadperc-find dataset "odometry_status = 'lost'" --peak turn_deg --json events.json
  roadperc-find dataset "time_to_impact_s < 2" --clips clips    also an excerpt of the log for each event
  roadperc-find dataset "time_to_impact_s < 2" --gallery events.html    a page with a picture of each event
  roadperc-find out.mcap "time_to_impact_s < 2"                 the events of one run
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-find``: print the events, with the command that shows each."""
    arguments = parse(_parser(), argv)
    from roadperc_stream.eval.find.events import Clips
    from roadperc_stream.eval.find.find import Query, find

    query = Query(arguments.condition, arguments.peak or "", arguments.gap, arguments.min_seconds)
    clips = Clips(arguments.clips, arguments.topic, arguments.force) if arguments.clips else None
    return run(lambda: find(arguments.dataset, query, arguments.json, arguments.gallery, clips, arguments.set))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "find",
        "Find the frames that fulfil an SQL condition, in all logs of a dataset. Frames of one log that are close in\n"
        "time form an event. Print the events, the worst first, with the command that shows the peak of each.",
        _EXAMPLE,
    )
    runs = "the OUT_DIR of a batch, or its address; or runs, as in report"
    add(parser, "dataset", metavar="DATASET", help=runs, completer=files(*RUNS))
    condition = "SQL on columns of frames; objects.COLUMN is a column of objects"
    add(parser, "condition", metavar="CONDITION", help=condition)
    seconds = number(0, 3.2e9, "0 seconds or more")
    gap = "frames closer than this are one event (default 1)"
    add(parser, "--gap", metavar="SECONDS", type=seconds, default=1.0, help=gap)
    shortest = "leave out shorter events (default 0)"
    add(parser, "--min-seconds", metavar="SECONDS", type=seconds, default=0.0, help=shortest)
    peak = "its worst value is the peak of an event (default: the condition's first column of numbers)"
    add(parser, "--peak", metavar="COLUMN", help=peak)
    clips = "write an excerpt of the log, with results, for each event"
    add(parser, "--clips", metavar="DIR", type=Path, help=clips, completer=files())
    gallery = "write a page with a picture of each event; a click copies the command that shows it"
    add(parser, "--gallery", metavar="FILE.html", type=Path, help=gallery, completer=files(".html"))
    add_shared(
        parser,
        "topic",
        json="write all events as one nested object",
        force="with --clips: replace existing excerpts",
        set="if a log is replayed: repeat STAGE.implementation=MODULE:NAME, or change a setting",
    )
    return parser
