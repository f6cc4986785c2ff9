"""Every setting with its default, range, unit and meaning, read from the models themselves."""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from pydantic import BaseModel

from roadperc_stream.config.fields import Section
from roadperc_stream.config.stages import ABOUT_THE_LOG, ReplayConfig

_UNIT_OF_SUFFIX: Final[Mapping[str, str]] = {
    "_per_m": "1/m",
    "_mps": "m/s",
    "_dps": "deg/s",
    "_deg": "deg",
    "_percent": "%",
    "_px": "px",
    "_m": "m",
    "_s": "s",
}
"""Longer suffixes first."""
_LIMITS: Final = ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "multipleOf")
Value = bool | int | float | str | tuple[str, ...]


@dataclass(frozen=True)
class Setting:
    """One key of the configuration."""

    key: str
    """The key for ``--set``, such as ``lanes.hold_s``."""
    default: Value
    type: str
    """``boolean``, ``integer``, ``number``, ``string`` or ``array`` (of strings)."""
    choices: tuple[str, ...]
    """Named values: all values, or those allowed in addition to a range of numbers."""
    limits: Mapping[str, float]
    """Keywords of JSON Schema: minimum, maximum, exclusiveMinimum, exclusiveMaximum, multipleOf."""
    remark: str
    """Another condition on the values, such as ``odd``."""
    unit: str
    """Empty if the setting is not a quantity."""
    meaning: str

    @property
    def section(self) -> str:
        """The stage of the setting; empty for settings of all stages."""
        return self.key.rpartition(".")[0]

    @property
    def name(self) -> str:
        """The key within its section."""
        return self.key.rpartition(".")[2]

    @property
    def range(self) -> str:
        """The allowed values, in words."""
        parts = _range_in_words(self.limits, self.remark), ", ".join(self.choices)
        return "; or ".join(filter(None, parts))


@cache
def catalogue() -> tuple[Setting, ...]:
    """All settings in the order of the models; settings without a section come first."""
    found = tuple(_settings(ReplayConfig, ""))
    return (*(setting for setting in found if not setting.section), *(setting for setting in found if setting.section))


@cache
def sections() -> Mapping[str, str]:
    """One sentence about each section."""
    models = {name: field.default for name, field in ReplayConfig.model_fields.items() if name not in ABOUT_THE_LOG}
    texts = {name: type(model).__doc__ or "" for name, model in models.items() if isinstance(model, BaseModel)}
    return {name: text.partition("\n")[0] for name, text in texts.items()}


def _settings(model: type[BaseModel], prefix: str) -> Iterator[Setting]:
    schema = model.model_json_schema()["properties"]
    kinds = [kind for kind in reversed(model.__mro__) if issubclass(kind, Section)]
    meanings = {name: text for kind in kinds for name, text in _meanings(kind).items()}
    for name, field in model.model_fields.items():
        if not prefix and name in ABOUT_THE_LOG:
            continue
        if isinstance(field.default, BaseModel):
            yield from _settings(type(field.default), f"{name}.")
        else:
            yield _setting(f"{prefix}{name}", field.default, schema[name], meanings.get(name, ""))


def _setting(key: str, default: Value, schema: Mapping[str, Any], meaning: str) -> Setting:
    """A setting from its JSON schema; ``anyOf`` lists several kinds of values."""
    kinds = [schema, *schema.get("anyOf", ())]
    unit_of_name = next((unit for suffix, unit in _UNIT_OF_SUFFIX.items() if key.endswith(suffix)), "")
    return Setting(
        key=key,
        default=default,
        type=next(kind["type"] for kind in kinds if "type" in kind),
        choices=tuple(choice for kind in kinds for choice in _choices(kind)),
        limits={limit: kind[limit] for kind in kinds for limit in _LIMITS if limit in kind},
        remark=next((kind["remark"] for kind in kinds if "remark" in kind), ""),
        unit=next((kind["unit"] for kind in kinds if "unit" in kind), "") or unit_of_name,
        meaning=meaning,
    )


def _choices(kind: Mapping[str, Any]) -> tuple[str, ...]:
    if kind.get("type") == "boolean":
        return ("true", "false")
    named = kind.get("choices", kind.get("enum", (kind["const"],) if "const" in kind else ()))
    return tuple(str(choice) for choice in named)


def _range_in_words(limits: Mapping[str, float], remark: str) -> str:
    low, high = limits.get("minimum"), limits.get("maximum")
    above, below = limits.get("exclusiveMinimum"), limits.get("exclusiveMaximum")
    lower = f"above {_number(above)}" if above is not None else "" if low is None else _number(low)
    upper = f"below {_number(below)}" if below is not None else "" if high is None else _number(high)
    step = f"a multiple of {_number(limits['multipleOf'])}" if "multipleOf" in limits else ""
    return ", ".join(part for part in (" to ".join(filter(None, (lower, upper))), step, remark) if part)


def _number(value: float) -> str:
    """A limit as text: integers without decimals, other numbers with few digits."""
    return str(int(value)) if value == int(value) else f"{value:g}"


def _meanings(model: type[BaseModel]) -> dict[str, str]:
    """The docstring of each field, on one line and without marks.

    It is read from the source on demand. With ``use_attribute_docstrings`` pydantic would read it in every replay,
    which takes 90 ms.
    """
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, text in zip(definition.body, definition.body[1:], strict=False):
        match field, text:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(said))):
                found[name] = re.sub(r"\s+", " ", said.replace("``", "")).strip()
    return found
