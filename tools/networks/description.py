"""Description of a network, from a TOML file: its model, input, outputs, classes and corrections."""

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveInt, ValidationError, field_validator, model_validator

from roadperc_stream.config.complaints import complaint, key_of
from roadperc_stream.config.settings import read_toml
from roadperc_stream.errors import ConfigError
from roadperc_stream.model.tag_tables import UNLABELED, TagTable, table_of_classes
from roadperc_stream.system.files import read_file
from roadperc_stream.system.text import nearest

Share = Annotated[float, Field(gt=0, le=1)]
Side = Annotated[int, Field(ge=1, le=8192)]
Numbers = tuple[float, float, float]
_SHOWN: Final = 80
_MOST_MODEL_BYTES: Final = 2**31
"""A model in one file is smaller: it is a protobuf message."""


class _Keys(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class InputKeys(_Keys):
    """How an image becomes the model's input: ``(pixel - mean) * scale`` of pixels from 0 to 255."""

    size: tuple[Side, Side]
    """Columns and rows."""
    layout: Literal["NCHW", "NHWC"] = "NCHW"
    colours: Literal["rgb", "bgr"] = "rgb"
    mean: Numbers = (0.0, 0.0, 0.0)
    scale: float | Numbers = 1.0
    resize: Literal["squeeze", "letterbox"] = "squeeze"
    aspect: Annotated[float, Field(gt=0)] = 2.0
    """With ``squeeze``, images with larger columns / rows than this and the input's get borders above and below."""
    align: Literal["corner", "centre"] = "corner"
    """Place of the image in a letterbox."""
    pad: Annotated[int, Field(ge=0, le=255)] = 114
    """Grey level around the image."""

    def shape(self) -> tuple[int, int, int, int]:
        """Shape of the model's input."""
        columns, rows = self.size
        return (1, 3, rows, columns) if self.layout == "NCHW" else (1, rows, columns, 3)


class _OutputKeys(_Keys):
    roi: tuple[tuple[float, float], ...] = ()
    """Polygon of (x, y) in shares of the image's width and height; pixels outside belong to no class."""
    ignore_below: Share = 1.0
    """Share of the image's height at which the own bonnet begins."""


class SegmentationKeys(_OutputKeys):
    """Outputs with scores of each pixel's class.

    ``semantic`` is one output with a channel per class, ``heads`` are several outputs with two channels (other, class)
    or one (positive scores are the class). ``classes`` has the class of each channel, or of each output.
    """

    decoder: Literal["semantic", "heads"]
    classes: dict[str, str] = Field(min_length=1)
    output: str = ""
    """Name of the output of ``semantic``; empty for the only one."""
    marking_width_m: Annotated[float, Field(gt=0, le=1)] | None = None
    """True width of a marking; None to keep the network's."""
    fill_holes: bool = False
    """Fill holes of the road before the car."""

    @field_validator("classes")
    @classmethod
    def _known(cls, classes: dict[str, str]) -> dict[str, str]:
        table_of_classes(classes.values())
        return classes

    @model_validator(mode="after")
    def _numbered(self) -> "SegmentationKeys":
        if self.decoder == "semantic" and not all(re.fullmatch("[0-9]{1,4}", key) for key in self.classes):
            raise ValueError(f"classes: expected numbers of channels as keys, found {', '.join(self.classes)}")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs; empty for the only one."""
        return tuple(self.classes) if self.decoder == "heads" else (self.output,) * bool(self.output)

    @property
    def table(self) -> TagTable:
        """The tag table of these classes; tag 0 is a pixel of no class."""
        return table_of_classes((UNLABELED, *self.classes.values()))


class DetectionKeys(_OutputKeys):
    """Outputs with boxes; ``classes`` has the label of each class number, other classes are left out.

    ``yolo_grid``: YOLOX's raw grids. ``yolov8``: rows of centre, size and class scores, one column a box. ``boxes``:
    corners in pixels of the input, then score and class, in one output or in three (boxes, scores, classes).
    """

    decoder: Literal["yolo_grid", "yolov8", "boxes"]
    classes: dict[Annotated[int, Field(ge=0)], str] = Field(min_length=1)
    outputs: tuple[str, ...] = ()
    """Names of the outputs; empty for the model's own."""
    strides: Annotated[tuple[PositiveInt, ...], Field(min_length=1, max_length=8)] = (8, 16, 32)
    min_score: Share = 0.3
    max_overlap: Share = 0.45
    """Largest intersection over union of two boxes, whatever their classes."""
    max_area: Share = 0.4
    """Largest share of the image that a box may cover."""
    tiles: Literal["none", "centre"] = "none"
    """``centre``: a second pass on the image's middle, twice as large, for small objects."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs; empty for the model's own."""
        return self.outputs


class NetworkKeys(_Keys):
    """All keys of a network's TOML file."""

    file: str
    """The ``.onnx`` file, relative to the TOML file."""
    sha256: str = Field("", pattern=r"^([0-9a-f]{64})?$")
    """Digest of the file; empty if any file will do."""
    source: str = ""
    licence: str = ""
    input: InputKeys
    output: Annotated[SegmentationKeys | DetectionKeys, Field(discriminator="decoder")]


@dataclass(frozen=True)
class Network:
    """A network with the bytes of its model."""

    path: Path
    """Of the TOML file."""
    keys: NetworkKeys
    model: bytes
    sha256: str

    @property
    def model_path(self) -> Path:
        """The ``.onnx`` file."""
        return self.path.parent / self.keys.file

    @property
    def role(self) -> Literal["segmentation", "detections"]:
        """The role of the channel that it computes."""
        return "segmentation" if isinstance(self.keys.output, SegmentationKeys) else "detections"

    @property
    def settings(self) -> str:
        """Digest of everything in the TOML file that changes the results."""
        text = self.keys.model_dump_json(include={"input", "output"})
        return hashlib.sha256(text.encode()).hexdigest()


def read_network(path: Path) -> Network:
    """Return the network of a TOML file.

    Raises:
        ConfigError: a file cannot be read, a key is invalid, or the model's digest is not the stated one.
    """
    tree = read_toml(path)
    try:
        keys = NetworkKeys.model_validate(tree)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    except ValidationError as error:
        raise ConfigError(f"{path}: {_complaint(error)}") from error
    file = path.parent / keys.file
    try:
        model = read_file(file, _MOST_MODEL_BYTES)
    except OSError as error:
        hint = f"; download it from {keys.source}" if keys.source else ""
        raise ConfigError(f"{file}: {error.strerror or error}, named by {path}{hint}") from error
    digest = hashlib.sha256(model).hexdigest()
    if keys.sha256 not in ("", digest):
        raise ConfigError(
            f"{file}: SHA-256 {digest}, expected {keys.sha256} as in {path}; download the file again, or change "
            "the key sha256 if the model is the right one"
        )
    return Network(path, keys, model, digest)


def _complaint(error: ValidationError) -> str:
    """The first error, such as ``input.size: expected ..., found ...``; a misspelt key is also missing."""
    first = min(error.errors(), key=lambda found: found["type"] != "extra_forbidden")
    key = key_of(first["loc"], _DECODERS)
    sections = key.split(".")
    if first["type"] == "extra_forbidden":
        models = _MODELS[1:] if len(sections) > 1 else _MODELS[:1]
        near = nearest(sections[-1], (name for model in models for name in model.model_fields))
        return f"no key {key}; " + (f"did you mean {near}?" if near else "docs/networks.md lists all keys")
    if first["type"].startswith("union_tag"):
        key = f"{key}.decoder"
    example = "; see docs/networks.md for an example" if complaint(first) == "missing" else ""
    return f"{key}: {complaint(first, _SHOWN)}{example}"


_MODELS: Final = (NetworkKeys, InputKeys, SegmentationKeys, DetectionKeys)
_DECODERS: Final = ("semantic", "heads", "yolo_grid", "yolov8", "boxes")
