"""``roadperc-find``: find events in many logs by an SQL condition."""

import argparse
from pathlib import Path

from roadperc_stream.cli.arguments import add_topic_argument
from roadperc_stream.cli.completers import RUNS, completed_by, files
from roadperc_stream.cli.plumbing import command_parser, number, parse, run

_EXAMPLE = """\
example:
  roadperc-find dataset "time_to_impact_s < 2 and lane_change <> 'none'"
  roadperc-find dataset "abs(lane_left_error_m) > 0.3" --gap 0.5 --min-seconds 1
  roadperc-find dataset "objects.label = 'Pedestrian' and objects.distance_m < 10 and step_m > 0.5"
  roadperc-find dataset "odometry_status = 'lost'" --peak turn_deg --json events.json
  roadperc-find dataset "time_to_impact_s < 2" --clips clips    also an excerpt of the log for each event
  roadperc-find out.mcap "time_to_impact_s < 2"                 the events of one run
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-find``: print the events, with the command that shows each."""
    arguments = parse(_parser(), argv)
    from roadperc_stream.eval.find.events import Clips
    from roadperc_stream.eval.find.find import Query, find

    query = Query(arguments.condition, arguments.peak or "", arguments.gap, arguments.min_seconds)
    clips = Clips(arguments.clips, arguments.topic, arguments.set, arguments.force) if arguments.clips else None
    return run(lambda: find(arguments.dataset, query, arguments.json, clips))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "find",
        "Find the frames that fulfil an SQL condition, in all logs of a dataset. Frames of one log that are close in\n"
        "time form an event. Print the events, the worst first, with the command that shows the peak of each.",
        _EXAMPLE,
    )
    add = parser.add_argument
    dataset = add("dataset", metavar="DATASET", help="the OUT_DIR of a batch, or its address; or runs, as in report")
    add("condition", metavar="CONDITION", help="SQL on columns of frames; objects.COLUMN is a column of objects")
    seconds = number(0, 3.2e9, "0 seconds or more")
    add("--gap", metavar="SECONDS", type=seconds, default=1.0, help="frames closer than this are one event (default 1)")
    add("--min-seconds", metavar="SECONDS", type=seconds, default=0.0, help="leave out shorter events (default 0)")
    text = "its worst value is the peak of an event (default: the condition's first column of numbers)"
    add("--peak", metavar="COLUMN", help=text)
    json = add("--json", metavar="FILE", type=Path, help="write all events as one nested object")
    clips = add("--clips", metavar="DIR", type=Path, help="write an excerpt of the log, with results, for each event")
    add("--force", action="store_true", help="with --clips: replace existing excerpts")
    add_topic_argument(parser)
    text = "with --clips, if a log is replayed: repeat STAGE.implementation=MODULE:NAME, or change a setting"
    add("--set", metavar="KEY=VALUE", action="append", default=[], help=text)
    for action, completer in ((dataset, files(*RUNS)), (json, files(".json")), (clips, files())):
        completed_by(action, completer)
    return parser
