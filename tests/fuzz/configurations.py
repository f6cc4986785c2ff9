"""Configuration files: values of another type or size, keys that do not exist, and text that is no TOML."""

from typing import Any

import tomli_w

from roadperc_stream.core.config.settings import parsed_toml
from roadperc_stream.errors import ConfigError
from tests.fuzz.choices import Choices, wild_text
from tests.fuzz.octets import damage
from tests.fuzz.trees import DEPTHS, mutate


def mutate_toml(text: bytes, choices: Choices) -> bytes:
    """The text with one fault."""
    how = choices.of("how", ("value", "value", "value", "bytes", "deep", "digits", "more"))
    if how == "bytes":
        return damage(text, choices)
    if how == "deep":
        depth = choices.of("depth", DEPTHS)
        dotted = ".".join(["a"] * depth)
        return f"{dotted} = 1\n".encode() if choices.chance("dotted", 0.5) else ("x = " + "[" * depth).encode()
    if how == "digits":
        return b"seed = " + b"9" * choices.of("digits", (19, 20, 400, 5000, 1_000_000)) + b"\n"
    if how == "more":
        return text + f"\n[{choices.of('table', ('lanes', 'unknown', 'a.b.c'))}]\nx = 1\n".encode()
    return _with_a_value(text, choices)


def _with_a_value(text: bytes, choices: Choices) -> bytes:
    try:
        tree: dict[str, Any] = parsed_toml(text)
        mutate(tree, choices)
        return tomli_w.dumps(tree).encode()
    except (ConfigError, ValueError, TypeError, RecursionError):  # no TOML to begin with, or no value that it has
        return damage(text, choices.part("otherwise"))


def wild_setting(choices: Choices) -> str:
    """A KEY=VALUE as --set takes it."""
    key = choices.of(
        "key", ("lanes.hold_s", "surface.model", "seed", "sync.max_wait_s", "stereo.method", "tag_table", "", "x.y")
    )
    values = (
        "1",
        "-1",
        "0",
        "nan",
        "inf",
        "1e308",
        "1e-300",
        "true",
        "[]",
        "{}",
        '"x"',
        "2020-01-01",
        "9" * 400,
        "[" * 60,
        "",
    )
    value = choices.of("value", values) if choices.chance("number", 0.8) else wild_text(choices, "text")
    return f"{key}={value}".replace("\0", "\x01")  # no argument of a process holds a NUL
