"""``roadperc-info``: print the content of logs, their damage, and the roles that a replay would use."""

import argparse
from pathlib import Path

from roadperc_stream.cli.arguments import about_log
from roadperc_stream.cli.completers import LOGS, files
from roadperc_stream.cli.launch import CONTRACT, run
from roadperc_stream.cli.options import ABOUT_LOG, add, add_about_log, add_shared, command_parser, parse

_EXAMPLE = """\
example:
  roadperc-info logs/sample.mcap
  roadperc-info bag.mcap --topic image=/front/rgb      with a topic for a role, as in roadperc-replay
  roadperc-info part_*.mcap                            the files of one log, and whether they fit together
  roadperc-info --json logs/*.mcap                     one line of JSON per log, for scripts; times in ns
  roadperc-info cut.mcap --recover whole.mcap          save the readable part of a damaged log
  roadperc-info good_*.mcap --init contract.toml       learn the limits that good logs of a car keep
  roadperc-info new.mcap --contract contract.toml      print the limits that a log breaks

The keys of --json are the fields in roadperc_stream/info/facts.py. If a log cannot be opened, its keys are "log" and
"error".

exit codes:
  0  every log is complete; with --recover: the readable part was saved
  1  a log is cut, damaged or not a log; the others are printed. With --recover: nothing was saved.
     With --contract: a log breaks it
  3  with --contract: a log cannot be opened, or the contract is invalid
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-info``: print the facts of logs."""
    parser = _parser()
    arguments = parse(parser, argv)
    if arguments.recover is not None:
        if len(arguments.logs) > 1:
            parser.error(f"--recover: expected one LOG, found {len(arguments.logs)}")
        for option in ("json", "init", "contract", "topic", *ABOUT_LOG):
            if getattr(arguments, option):
                parser.error(f"--{option} cannot be combined with --recover")
        from roadperc_stream.info.listing import recover_log

        return run(lambda: recover_log(arguments.logs[0], arguments.recover, force=arguments.force))
    if arguments.init is not None and (arguments.json or arguments.contract is not None):
        parser.error("--init writes a contract and prints nothing; remove --json and --contract")
    if arguments.force and arguments.init is None:
        parser.error("--force needs --recover or --init")
    from roadperc_stream.config import ReplayConfig
    from roadperc_stream.info.judging import judge_logs, learn_contract
    from roadperc_stream.info.listing import list_logs

    def listed() -> None:
        cfg = about_log(ReplayConfig(), arguments)
        if arguments.init is not None:
            learn_contract(arguments.logs, arguments.topic, cfg, arguments.init, force=arguments.force)
        elif arguments.contract is not None:
            judge_logs(arguments.logs, arguments.topic, cfg, arguments.contract, as_json=arguments.json)
        else:
            list_logs(arguments.logs, arguments.topic, cfg, as_json=arguments.json)

    return run(listed, CONTRACT if arguments.contract is not None else "")


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "info",
        "Print the channels of a log, the roles that they fill, missing roles, and damage. For a result log, also\n"
        "print its configuration and whether another program changed it.",
        _EXAMPLE,
    )
    logs = "an input or result log, also a damaged one; - for standard input"
    add(parser, "logs", metavar="LOG", type=Path, nargs="+", help=logs, completer=files(*LOGS))
    add_shared(parser, "topic")
    add_about_log(parser)
    add(parser, "--json", action="store_true", help="print one line of JSON per log")
    recover = "write the readable part of a damaged LOG as a new log"
    add(parser, "--recover", metavar="OUT.mcap", type=Path, help=recover, completer=files(".mcap"))
    init = "write the limits that these logs keep, each one the whole recording of a drive"
    add(parser, "--init", metavar="FILE.toml", type=Path, help=init, completer=files(".toml"))
    add_shared(parser, "contract", force="replace an existing OUT.mcap or FILE.toml")
    return parser
