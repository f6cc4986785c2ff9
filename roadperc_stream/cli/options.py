"""The parser of every command, and the table of the options that several commands share."""

import argparse
import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NoReturn

from roadperc_stream.cli.completers import Completer, files, settings, topics, words
from roadperc_stream.cli.launch import COMPLETING
from roadperc_stream.cli.values import number, seconds, seed, whole_number
from roadperc_stream.schemas.topics import NEEDS, STAGES
from roadperc_stream.system.text import shown
from roadperc_stream.view.live import FASTEST, SLOWEST


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print the version; finding it takes 30 ms."""
        from roadperc_stream import __version__

        print(f"{parser.prog} {__version__}")
        parser.exit()


def _stages(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    unknown = [name for name in names if name not in STAGES]
    if unknown:
        raise argparse.ArgumentTypeError(f"no stage {unknown[0]!r}; stages: {', '.join(STAGES)}")
    return names + tuple(needed for name in names for needed in NEEDS.get(name, ()))


def _option(help_text: str, metavar: str = "", completer: Completer | None = None, **settings: Any) -> dict[str, Any]:
    """The settings of an option for ``add``; without a metavar it is a flag."""
    kind = {"metavar": metavar} if metavar else {"action": "store_true"}
    return {"help": help_text, "completer": completer} | kind | settings


_REPEATED: Final[Mapping[str, Any]] = {"action": "append", "default": []}
SHARED: Final[Mapping[str, dict[str, Any]]] = {
    "version": _option("show program's version number and exit", action=_Version, nargs=0),
    "config": _option("read settings from this TOML file", "FILE", files(".toml"), type=Path),
    "set": _option("change one setting; overrides FILE", "KEY=VALUE", settings, **_REPEATED),
    "topic": _option("use this topic for a role, such as image=/front/rgb", "ROLE=/NAME", topics, **_REPEATED),
    "start": _option("start this long after the first message", "SECONDS", type=seconds),
    "end": _option("end this long after the first message", "SECONDS", type=seconds),
    "frames": _option("replay at most N frames", "N", type=whole_number),
    "only": _option(
        f"run only these stages, and the stages that they need: {','.join(STAGES)}; a log without depth needs stereo",
        "STAGES",
        words(STAGES),
        type=_stages,
    ),
    "fov": _option(
        "horizontal field of view", "DEGREES", type=number(1e-3, math.nextafter(180, 0), "degrees below 180")
    ),
    "height": _option(
        "height of a level camera above the road", "METRES", type=number(0.05, 100, "metres from 0.05 to 100")
    ),
    "calibration": _option(
        "calibration of the camera: camera_info YAML of ROS, or JSON (default: that of the log)",
        "FILE",
        files(".yaml", ".yml", ".json"),
        type=Path,
    ),
    "labels": _option("TOML file with known labels for others", "FILE", files(".toml"), type=Path),
    "json": _option("write one nested object", "FILE", files(".json"), type=Path),
    "markdown": _option(
        "append a summary for merge requests to a file such as $GITHUB_STEP_SUMMARY", "FILE", files(".md"), type=Path
    ),
    "junit": _option("write JUnit XML for GitLab, GitHub and Jenkins", "FILE", files(".xml"), type=Path),
    "contract": _option(
        "judge each log by this contract, as roadperc-info --init writes it", "FILE.toml", files(".toml"), type=Path
    ),
    "rate": _option(
        "playback speed (default 1)", "FACTOR", type=number(SLOWEST, FASTEST, f"{SLOWEST:g} to {FASTEST:g}")
    ),
    "loop": _option("play the log again when it ends", default=None),
    "host": _option("address to listen on (default 127.0.0.1, this machine only)", "ADDRESS"),
    "port": _option(
        "port to listen on (default 8765; 0: any free port)", "N", type=number(0, 65535, "0 to 65535", int)
    ),
    "seed": _option("seed of the random numbers (default: 0)", "N", type=seed, default=0),
    "threads": _option(
        "number of threads (default: one per core); the results do not depend on it", "N", type=whole_number
    ),
    "recover": _option("replay the readable part of damaged logs and report the losses"),
    "force": _option("replace an existing output"),
    "quiet": _option("print errors only"),
}
"""The options that several commands have, by their names without dashes."""
EVERY: Final = ("version",)
"""The options of every command."""
REPLAY: Final = ("config", "set", "topic", "start", "end", "frames")
"""The options of a command that replays: settings, topics, and the part of the log."""
CAMERA: Final = ("fov", "height", "calibration")
ABOUT_LOG: Final = (*CAMERA, "labels")
"""The options that say what a log does not: its camera and its labels."""
RESULT_FILES: Final = ("json", "markdown", "junit")
SERVING: Final = ("rate", "loop", "host", "port")
"""The options of a server; without an option its value is None."""


def add(
    to: argparse._ActionsContainer, *names: str, completer: Completer | None = None, **settings: Any
) -> argparse.Action:
    """Add an argument of one command to a parser or a group; ``settings`` are those of argparse."""
    action = to.add_argument(*names, **settings)
    if completer is not None:
        action.completer = completer  # type: ignore[attr-defined]  # argcomplete's documented place for it
    return action


def add_shared(to: argparse._ActionsContainer, *names: str, **texts: str) -> None:
    """Add options of ``SHARED`` to a parser or a group; a keyword gives another help text for its option."""
    for name in (*names, *texts):
        text = {"help": texts[name]} if name in texts else {}
        add(to, f"--{name.replace('_', '-')}", **SHARED[name] | text)


def add_about_log(parser: argparse.ArgumentParser) -> None:
    """Add ``ABOUT_LOG`` as a group."""
    add_shared(parser.add_argument_group("instead of what the log says"), *ABOUT_LOG)


def add_result_files(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Add ``RESULT_FILES`` as a group."""
    group = parser.add_argument_group("results for other programs")
    add_shared(group, *RESULT_FILES)
    return group


def add_serving(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Add ``SERVING`` as a group."""
    group = parser.add_argument_group("serving to Foxglove")
    add_shared(group, *SERVING)
    return group


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Exit with code 2; the message is escaped, because a shell's pattern may insert any file name."""
        super().error(shown(message))


def command_parser(name: str, description: str, example: str, usage: str | None = None) -> argparse.ArgumentParser:
    """A parser with the options of ``EVERY`` command; its name is the one that the user typed.

    Options are not abbreviated, so that a new option changes the meaning of no script.
    """
    subcommand = f"roadperc {name}".strip()
    parser = _Parser(
        prog=subcommand if not name or sys.argv[0] == subcommand else f"roadperc-{name}",
        usage=usage,
        description=description,
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add_shared(parser, *EVERY)
    return parser


def parse(
    parser: argparse.ArgumentParser, argv: Sequence[str] | None, *, intermixed: bool = False
) -> argparse.Namespace:
    """The arguments of a command; if a shell asks for completions, print them and exit.

    ``intermixed`` allows options between files.
    """
    if COMPLETING in os.environ:
        import argcomplete
        from argcomplete.completers import SuppressCompleter

        silent = SuppressCompleter()  # an argument without a completer gets no files
        argcomplete.autocomplete(parser, always_complete_options=False, default_completer=silent)
    return parser.parse_intermixed_args(argv) if intermixed else parser.parse_args(argv)
