"""The settings in four forms: text for a terminal, JSON, TOML to start from, and the page ``docs/settings.md``.

``python -m roadperc_stream.cli.settings`` prints the page.
"""

import argparse
import json
import shutil
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from itertools import groupby
from typing import Final

import tomli_w

from roadperc_stream.cli.arguments import config_of
from roadperc_stream.config import ReplayConfig
from roadperc_stream.config.catalogue import Setting, Value, catalogue, sections
from roadperc_stream.config.stages import ABOUT_THE_LOG
from roadperc_stream.model.tag_tables import CLASS_NAMES, LABEL_CLASSES

_NARROWEST, _WIDEST = 50, 100
_CLASSES: Final = "names of classes"
_CLASS_NAMES: Final = tuple(sorted(CLASS_NAMES))
_SCALING: Final = (
    "Lengths in pixels refer to 960 image rows and scale with the image. Lengths of `stereo` do not scale."
)
_PLAIN_SCALING: Final = _SCALING.replace("`", "")
_OF_LOG: Final = (
    "Two more tables say what a log does not: `calibration`, with the keys of `calibration.json`, and `labels`, such "
    'as `auto = "car"`. See recordings.md.'
)
_PAGE_HEAD: Final = f"""\
# Settings

Change a setting with `--set KEY=VALUE`, or several with `--config FILE` (TOML); `--set` overrides the file.
`roadperc-replay --print-config > mine.toml` writes a file to start from. `roadperc-replay --list-settings` prints
these tables on the terminal, with `--json` for programs.

{_SCALING}
{_OF_LOG.replace("recordings.md", "[your own recordings](recordings.md#logs-without-a-calibration)")}
`STAGE.implementation = "MODULE:NAME"` selects [a stage of your own](own_stage.md).
"""
_LABELS_HEAD: Final = """\
## labels

The known labels of detections, and the classes of their pixels. Case does not matter; blanks and hyphens are
underscores. Tags do not judge a box with another label. `--labels FILE.toml` gives a known label for others:

```toml
[labels]
auto = "car"
Mensch = "person"
3 = "truck"
```

| label | classes |
|---|---|"""


def print_settings(arguments: argparse.Namespace) -> None:
    """Print the settings for ``--list-settings``, or the configuration for ``--print-config``.

    Raises:
        ConfigError: a given setting is invalid.
    """
    if arguments.print_config:
        print(as_toml(config_of(arguments)), end="")
    elif arguments.json:
        print(as_json())
    else:
        print(as_text(min(max(shutil.get_terminal_size().columns, _NARROWEST), _WIDEST)), end="")


def as_text(width: int) -> str:
    """All settings by stage, in lines of at most ``width`` characters; longer words are not broken."""
    lines = [f"{len(catalogue())} settings: KEY = DEFAULT [UNIT] (RANGE), for --set and --config", _PLAIN_SCALING]
    for section, settings in _by_section():
        lines += ["", f"{section}: {sections()[section]}" if section else "whole replay:"]
        for setting in settings:
            quantity = f"  {setting.key} = {_value(setting.default)}{f'  [{setting.unit}]' if setting.unit else ''}"
            lines += [f"{quantity}  ({_range(setting)})", f"    {setting.meaning}"]
    lines += ["", f"{_CLASSES}: {', '.join(_CLASS_NAMES)}", "", _OF_LOG.replace("`", "")]
    return "".join(f"{_wrapped(line, width)}\n" for line in lines)


def as_json() -> str:
    """A JSON array with one object per setting; limits are named as in JSON Schema."""
    facts = [{**asdict(item), "section": item.section, "range": item.range} for item in catalogue()]
    return json.dumps(facts, indent=2)


def as_toml(cfg: ReplayConfig) -> str:
    """A configuration as TOML for ``load_config``, every key with its meaning, range and default."""
    values = cfg.model_dump(mode="json")
    lines = ["# Settings of roadperc-replay, for --config. Missing keys have their defaults."]
    lines += [f"# {_PLAIN_SCALING}"]
    for section, settings in _by_section():
        lines += ["", *([f"# {sections()[section]}", f"[{section}]"] if section else [])]
        for setting in settings:
            value = (values[section] if section else values).get(setting.name, setting.default)
            lines += [*_comment(setting), tomli_w.dumps({setting.name: value}).rstrip()]
    about_log = {name: values[name] for name in ABOUT_THE_LOG if name in values}
    lines += ["", tomli_w.dumps(about_log).rstrip()] if about_log else []
    return "\n".join(lines) + "\n"


def as_page() -> str:
    """The page ``docs/settings.md``."""
    lines = [_PAGE_HEAD]
    for section, settings in _by_section():
        lines += [f"## {section}\n\n{sections()[section]}\n" if section else "## whole replay\n"]
        lines += ["| setting | default | range | meaning |", "|---|---|---|---|"]
        lines += [*(_row(setting) for setting in settings if not setting.name.startswith("implementation")), ""]
    lines += ["## Classes\n\n```text", textwrap.fill(", ".join(_CLASS_NAMES), _WIDEST), "```\n", _LABELS_HEAD]
    labels: dict[str, list[str]] = {}
    for label, classes in sorted(LABEL_CLASSES.items()):
        labels.setdefault(", ".join(classes), []).append(f"`{label}`")
    lines += [f"| {', '.join(names)} | {classes} |" for classes, names in labels.items()]
    return "\n".join(lines) + "\n"


def _by_section() -> Iterator[tuple[str, Iterable[Setting]]]:
    return groupby(catalogue(), key=lambda setting: setting.section)


def _wrapped(line: str, width: int) -> str:
    """A line folded between words, with continuation lines indented."""
    indent = " " * (len(line) - len(line.lstrip()))
    further = indent if len(indent) == len("    ") else f"{indent}      "
    return textwrap.fill(line, width, subsequent_indent=further, break_long_words=False, break_on_hyphens=False)


def _comment(setting: Setting) -> Iterator[str]:
    facts = f"{_range(setting)}{f' [{setting.unit}]' if setting.unit else ''}; default {_value(setting.default)}"
    for text in (setting.meaning, facts):
        yield from textwrap.wrap(text, _WIDEST, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False)


def _row(setting: Setting) -> str:
    default = f"{_value(setting.default)} {setting.unit}".strip()
    return f"| `{setting.key}` | {default} | {_range(setting)} | {setting.meaning} |"


def _range(setting: Setting) -> str:
    """The range of a setting; a short name for the list of all classes."""
    return _CLASSES if setting.choices == _CLASS_NAMES else setting.range


def _value(value: Value) -> str:
    """A value as ``--set`` takes it."""
    if isinstance(value, tuple):
        return ",".join(value)
    return str(value).lower() if isinstance(value, bool) else str(value)


if __name__ == "__main__":
    print(as_page(), end="")
