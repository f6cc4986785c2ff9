"""Types of settings, and the limits on the content of logs and messages."""

from collections.abc import Collection
from typing import Annotated, Any, ClassVar, Final

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
)

from roadperc_stream.errors import ConfigError
from roadperc_stream.model.tag_tables import CLASS_NAMES, LABEL_CLASSES, TABLES, normal_label, table_for_version

_ORDER: Final = ("road", "road_line", "ground", "sidewalk", "rail_track", "guard_rail", "vehicle", "pedestrian")
"""The classes of defaults, in an order that fits all of them; the other classes follow by name."""
_MEGA: Final = 1_000_000
_MIB: Final = 1024 * 1024


def _known_classes(names: tuple[str, ...]) -> tuple[str, ...]:
    """Each class once, in one order of all classes: lists that mean the same have the same digest."""
    unknown = [name for name in names if name not in CLASS_NAMES]
    if unknown:
        raise ValueError(f"unknown class {unknown[0]!r}; known: {', '.join(sorted(CLASS_NAMES))}")
    return tuple(name for name in dict.fromkeys((*_ORDER, *sorted(CLASS_NAMES))) if name in names)


def _known_table(version: str) -> str:
    try:
        return version if version == "auto" else table_for_version(version).name
    except ConfigError as error:
        raise ValueError(str(error)) from error


def _known_labels(labels: dict[str, str]) -> dict[str, str]:
    """Sorted, and each label in its normal form."""
    found = {normal_label(label): normal_label(known) for label, known in sorted(labels.items())}
    if unknown := [f"{label} = {known!r}" for label, known in found.items() if known not in LABEL_CLASSES]:
        raise ValueError(f"{unknown[0]}: expected one of {', '.join(sorted(LABEL_CLASSES))}")
    return found


def _odd(count: int) -> int:
    if count % 2 == 0:
        raise ValueError(f"must be odd, found {count}")
    return count


def split(names: Any) -> Any:
    """Split names at commas, as on the command line."""
    return tuple(name.strip() for name in names.split(",")) if isinstance(names, str) else names


def unit(name: str) -> Any:
    """Metadata with the unit of a setting whose name does not end in it; ``config.catalogue`` shows it."""
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
Labels = Annotated[dict[str, str], AfterValidator(_known_labels)]
BUILT_IN: Final = "built-in"
ImplementationName = Annotated[
    str,
    Field(max_length=1000, pattern=rf"^({BUILT_IN}|[A-Za-z_][\w.]*:[A-Za-z_]\w*)$"),
    Field(json_schema_extra={"choices": [BUILT_IN], "remark": "MODULE:NAME"}),
]
OddCount = Annotated[int, Field(ge=1, le=99, json_schema_extra={"remark": "odd"}), AfterValidator(_odd)]


class Section(BaseModel):
    """A part of the configuration: frozen, no unknown keys, no NaN."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    written_if_set: ClassVar[Collection[str] | None] = ()
    """Keys that are written only with another value than the default, so the digests of other configurations stay; None
    for all keys."""

    @field_validator("*")
    @classmethod
    def _without_negative_zero(cls, value: Any) -> Any:
        """0.0 for -0.0: equal settings have the same digest."""
        return 0.0 if isinstance(value, float) and value == 0.0 else value

    @model_serializer(mode="wrap")
    def _without_unset(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields = type(self).model_fields
        keys = fields if self.written_if_set is None else self.written_if_set
        defaults = {key: fields[key].get_default(call_default_factory=True) for key in keys}
        return {key: value for key, value in dump(self).items() if defaults.get(key, self) != getattr(self, key)}


class LimitsConfig(Section):
    """Limits on the content of a log, checked before memory is allocated.

    ``roadperc-info``, ``roadperc-view`` and the evaluation read with the defaults.
    """

    image_megapixels: Annotated[float, Field(ge=0.01, le=170.0), unit("megapixels")] = 40.0
    """Largest image, by its header and its calibration."""
    chunk_mb: Annotated[int, Field(ge=1, le=65_536), unit("MiB")] = 256
    """Largest decompressed chunk."""
    record_mb: Annotated[int, Field(ge=1, le=1_048_576), unit("MiB")] = 1024
    """Largest record of the file, and all attachments and metadata together."""

    chunk_messages: ClassVar[int] = 1_000_000
    """Most messages in a chunk; a chunk of 8 MiB holds 0.3 million of the shortest messages."""
    points: ClassVar[int] = 10_000_000
    """Most points in a lidar message; a turn of 128 beams has 0.3 million."""
    message_bytes: ClassVar[int] = 16 * _MIB
    """Size of the largest message except images and points; 2000 detections take 0.2 MB."""
    detections: ClassVar[int] = 2000
    """Most detections or objects in a message; the largest data sets have some hundred in a frame."""
    transforms: ClassVar[int] = 2000
    """Most frames in the tree of transforms; a car with all its sensors has some hundred."""

    @property
    def chunk_bytes(self) -> int:
        """Size of the largest chunk."""
        return self.chunk_mb * _MIB

    @property
    def record_bytes(self) -> int:
        """Size of the largest record, and of all attachments and metadata."""
        return self.record_mb * _MIB

    @property
    def image_pixels(self) -> int:
        """Pixels of the largest image."""
        return int(self.image_megapixels * _MEGA)


DEFAULT_LIMITS: Final = LimitsConfig()
