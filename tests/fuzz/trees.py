"""Changes to single values of JSON, TOML, protobuf and ROS messages, and text that is not valid TOML."""

import json
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import tomli_w

from roadperc_stream.config.settings import parsed_toml
from roadperc_stream.errors import ConfigError
from tests.fuzz.choices import Choices, damage, wild_float, wild_integer, wild_like, wild_text

DEPTHS = (2, 50, 1000, 100_000)
COPIES = (2, 30, 1000)


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """(container, key) of every value in a tree of dictionaries and lists."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        yield tree, key
        yield from _places(value)


def mutate(tree: Any, choices: Choices) -> None:
    """Change one value of a tree of dictionaries and lists in place."""
    found = list(_places(tree))
    if not found:
        return
    container, key = found[choices.index("place", len(found))]
    fault = choices.of("fault", ("value", "value", "value", "remove", "rename", "copies", "nest"))
    if fault == "value":
        container[key] = wild_value(choices)
    elif fault == "remove":
        del container[key]
    elif fault == "rename" and isinstance(container, dict):
        container[wild_text(choices)] = container.pop(key)
    elif fault == "copies":
        container[key] = [container[key]] * choices.of("copies", COPIES)
    elif fault == "nest":
        for _ in range(choices.of("depth", DEPTHS[:2])):
            container[key] = [container[key]]


def wild_value(choices: Choices) -> Any:
    """A value of any type."""
    kind = choices.of("kind", ("integer", "float", "text", "true", "null", "list", "object", "digits"))
    if kind in ("integer", "float", "text"):
        return {"integer": wild_integer, "float": wild_float, "text": wild_text}[kind](choices)
    if kind == "digits":
        return 10 ** choices.of("digits", (20, 400, 4000))
    return {"true": True, "null": None, "list": [], "object": {}}[kind]


def mutate_json(data: bytes, choices: Choices) -> bytes:
    """A JSON document with one changed value, deep nesting, or damaged bytes."""
    how = choices.of("how", ("value", "value", "value", "bytes", "deep"))
    if how == "bytes":
        return damage(data, choices)
    if how == "deep":
        depth, opening = choices.of("depth", DEPTHS), choices.of("opening", ("[", '{"a":'))
        return (opening * depth + "1" + ("]" if opening == "[" else "}") * depth).encode()
    try:
        tree = [json.loads(data)]
    except (ValueError, RecursionError):  # an earlier step has damaged it
        return damage(data, choices)
    mutate(tree, choices)
    return json.dumps(tree[0] if tree else None).encode()


def mutate_message(message: Any, choices: Choices) -> None:
    """Change one field of a protobuf or ROS message in place, at any depth; a recipe names it as ``rotation.w``.

    Raises:
        Exception: of any type, if the library does not accept the new value.
    """
    fields = dict(_fields(message))
    owner, name = fields[choices.of("field", list(fields))]
    value = getattr(owner, name)
    if isinstance(value, np.ndarray):
        changed = damage(value.tobytes(), choices)[: value.nbytes].ljust(value.nbytes, b"\0")
        items = choices.of("items", (len(value), len(value), 0, len(value) // 2))
        vars(owner)[name] = np.frombuffer(changed, value.dtype)[:items]
    elif hasattr(value, "extend"):
        _mutate_items(value, choices)
    elif _is_message(value):
        owner.ClearField(name)
    else:
        _assign(owner, name, wild_like(value, choices))


def _is_message(value: Any) -> bool:
    return hasattr(value, "DESCRIPTOR") or hasattr(value, "__msgtype__")


def _fields(message: Any, prefix: str = "") -> Iterator[tuple[str, tuple[Any, str]]]:
    """Every field of a message and its submessages, by path; of repeated submessages the first."""
    is_ros = hasattr(message, "__msgtype__")
    for name in vars(message) if is_ros else [field.name for field in message.DESCRIPTOR.fields]:
        yield f"{prefix}{name}", (message, name)
        value = getattr(message, name)
        inner = value[0] if hasattr(value, "extend") and len(value) else value
        if _is_message(inner):
            yield from _fields(inner, f"{prefix}{name}.")


def _mutate_items(values: Any, choices: Choices) -> None:
    fault, items = choices.of("fault", ("remove", "copies", "value")), list(values)
    at = choices.index("item", max(len(items), 1))
    if fault == "value" and items and not _is_message(items[at]):
        items[at] = wild_like(items[at], choices)
    elif fault == "remove":
        items = items[:at] + items[at + 1 :]
    else:
        items *= choices.of("copies", (0, *COPIES))
    del values[:]
    values.extend(items)


def _assign(owner: Any, name: str, value: Any) -> None:
    """Assign a value; an integer that is too wide for a protobuf field is truncated."""
    if hasattr(owner, "__msgtype__"):
        vars(owner)[name] = value  # the class is frozen
        return
    for fitting in (value, *(value % 2**bits for bits in (64, 32, 31) if type(value) is int)):
        with suppress(ValueError, OverflowError):
            setattr(owner, name, fitting)
            return


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
    try:
        tree: dict[str, Any] = parsed_toml(text)
        mutate(tree, choices)
        return tomli_w.dumps(tree).encode()
    except (ConfigError, ValueError, TypeError, RecursionError):  # the text is not TOML, or the value has no TOML form
        return damage(text, choices.part("otherwise"))


def wild_setting(choices: Choices) -> str:
    """A KEY=VALUE for --set."""
    key = choices.of(
        "key", ("lanes.hold_s", "surface.model", "seed", "sync.max_wait_s", "stereo.method", "tag_table", "", "x.y")
    )
    values = (
        "1", "-1", "0", "nan", "inf", "1e308", "1e-300", "true", "[]", "{}", '"x"', "2020-01-01", "9" * 400, "[" * 60,
        "",
    )  # fmt: skip
    value = choices.of("value", values) if choices.chance("number", 0.8) else wild_text(choices, "text")
    return f"{key}={value}".replace("\0", "\x01")  # arguments of a process cannot contain NUL
