"""Types of settings, and the limits on the content of logs and messages."""

from typing import Annotated, Any, Final, Literal, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, field_validator

from roadperc_stream.errors import ConfigError
from roadperc_stream.model.tag_tables import CLASS_NAMES, LABEL_CLASSES, TABLES, normal_label, table_for_version

ImageFormat = Literal["png", "jpeg", "webp", "avif", "bmp", "gif"]
"""Formats with one size in the header, known before decoding; a TIFF may have several sizes, JPEG 2000 two."""

_ORDER: Final = ("road", "road_line", "ground", "sidewalk", "rail_track", "guard_rail", "vehicle", "pedestrian")
"""The classes of defaults, in an order that fits all of them; the other classes follow by name."""
_MEGA: Final = 1_000_000
_MIB: Final = 1024 * 1024


def _known_classes(names: tuple[str, ...]) -> tuple[str, ...]:
    unknown = [name for name in names if name not in CLASS_NAMES]
    if unknown:
        raise ValueError(f"unknown class {unknown[0]!r}; known: {', '.join(sorted(CLASS_NAMES))}")
    return _in_order(names, (*_ORDER, *sorted(CLASS_NAMES)))


def _in_order(names: tuple[str, ...], order: tuple[str, ...]) -> tuple[str, ...]:
    """Each name once, in the order of all names: lists that mean the same have the same digest."""
    return tuple(name for name in dict.fromkeys(order) if name in names)


def _formats_in_order(names: tuple[str, ...]) -> tuple[str, ...]:
    return _in_order(names, get_args(ImageFormat))


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

    @field_validator("*")
    @classmethod
    def _without_negative_zero(cls, value: Any) -> Any:
        """0.0 for -0.0: equal settings have the same digest."""
        return 0.0 if isinstance(value, float) and value == 0.0 else value


class LimitsConfig(Section):
    """Limits on the content of a log, checked before memory is allocated.

    ``roadperc-info``, ``roadperc-view`` and the evaluation read with the defaults.
    """

    chunk_mb: Annotated[int, Field(ge=1, le=65_536), unit("MiB")] = 256
    """Largest decompressed chunk; writers make chunks of 1 to 8 MiB, or of one larger message."""
    chunk_messages: Annotated[int, Field(ge=1, le=1_000_000_000), unit("messages")] = 1_000_000
    """Most messages in a chunk; a chunk of 8 MiB holds 0.3 million of the shortest messages."""
    record_mb: Annotated[int, Field(ge=1, le=1_048_576), unit("MiB")] = 1024
    """Largest record of the file: a compressed chunk, an attachment or a message outside chunks."""
    attachments_mb: Annotated[int, Field(ge=1, le=1_048_576), unit("MiB")] = 1024
    """Largest total size of the attachments and metadata of a log, which are kept in memory."""
    gaps: Annotated[int, Field(ge=1, le=1_000_000), unit("gaps")] = 10_000
    """Most gaps that a repaired log lists; it lists the rest as one gap."""
    image_megapixels: Annotated[float, Field(ge=0.01, le=170.0), unit("megapixels")] = 40.0
    """Largest image, by its header and its calibration; 8K has 33 megapixels."""
    image_formats: Annotated[
        tuple[ImageFormat, ...],
        BeforeValidator(split),
        AfterValidator(_formats_in_order),
        Field(min_length=1, json_schema_extra={"choices": [*get_args(ImageFormat)]}),
    ] = ("png", "jpeg", "webp")
    """Image formats to decode; an error names any other format."""
    points: Annotated[int, Field(ge=1, le=1_000_000_000), unit("points")] = 10_000_000
    """Most points in a lidar message; a turn of 128 beams has 0.3 million."""
    message_mb: Annotated[int, Field(ge=1, le=4096), unit("MiB")] = 16
    """Largest message except images and points."""
    detections: Annotated[int, Field(ge=1, le=100_000), unit("boxes")] = 2000
    """Most detections or objects in a message."""
    transforms: Annotated[int, Field(ge=1, le=100_000), unit("frames")] = 2000
    """Most frames in the tree of transforms."""
    name_length: Annotated[int, Field(ge=1, le=1_000_000), unit("characters")] = 1000
    """Longest name in a message, such as a frame, a class, an object or an encoding."""

    @property
    def chunk_bytes(self) -> int:
        """Size of the largest chunk."""
        return self.chunk_mb * _MIB

    @property
    def record_bytes(self) -> int:
        """Size of the largest record."""
        return self.record_mb * _MIB

    @property
    def attachments_bytes(self) -> int:
        """Size of all attachments and metadata."""
        return self.attachments_mb * _MIB

    @property
    def message_bytes(self) -> int:
        """Size of the largest message except images and points."""
        return self.message_mb * _MIB

    @property
    def image_pixels(self) -> int:
        """Pixels of the largest image."""
        return int(self.image_megapixels * _MEGA)


DEFAULT_LIMITS: Final = LimitsConfig()
