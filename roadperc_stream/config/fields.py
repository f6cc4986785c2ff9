"""The kinds of values a setting may have, each with its limits."""

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from roadperc_stream.errors import ConfigError
from roadperc_stream.model.tag_tables import CLASS_NAMES, TABLES, table_for_version


def _known_classes(names: tuple[str, ...]) -> tuple[str, ...]:
    unknown = [name for name in names if name not in CLASS_NAMES]
    if unknown:
        raise ValueError(f"unknown class {unknown[0]!r}; known: {', '.join(sorted(CLASS_NAMES))}")
    return names


def _known_table(version: str) -> str:
    try:
        return version if version == "auto" else table_for_version(version).name
    except ConfigError as error:
        raise ValueError(str(error)) from error


def _odd(count: int) -> int:
    if count % 2 == 0:
        raise ValueError(f"must be odd, found {count}")
    return count


def split(names: Any) -> Any:
    """One name, or several by commas, as a command line gives them."""
    return tuple(name.strip() for name in names.split(",")) if isinstance(names, str) else names


def unit(name: str) -> Any:
    """Metadata of a number whose name does not end in its unit; ``config.catalogue`` shows it."""
    return Field(json_schema_extra={"unit": name})


Classes = Annotated[
    tuple[str, ...],
    BeforeValidator(split),
    AfterValidator(_known_classes),
    Field(json_schema_extra={"choices": [*sorted(CLASS_NAMES)]}),
]
Ratio = Annotated[float, Field(ge=0.0, le=1.0), unit("ratio")]
Positive = Annotated[float, Field(ge=1e-6, le=1e4, allow_inf_nan=False)]
Pixels = Annotated[float, Field(ge=0.1, le=1e3, allow_inf_nan=False)]
Seconds = Annotated[float, Field(ge=0.0, le=3600.0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, le=100_000)]
TableName = Annotated[
    str,
    AfterValidator(_known_table),
    Field(json_schema_extra={"choices": ["auto", *TABLES], "remark": "a CARLA version"}),
]
OddCount = Annotated[int, Field(ge=1, le=99, json_schema_extra={"remark": "odd"}), AfterValidator(_odd)]


class Section(BaseModel):
    """A part of the configuration: frozen, no unknown keys, no NaN."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
