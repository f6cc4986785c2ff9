"""The most that one log or one message may ask for: far beyond real ones, and less than a machine has."""

from typing import Annotated, Final, Literal, get_args

from pydantic import BeforeValidator, Field

from roadperc_stream.config.fields import Section, split, unit

ImageFormat = Literal["png", "jpeg", "webp", "avif", "bmp", "gif"]
"""Whose size can be known before they are decoded: a TIFF may state several, JPEG 2000 two."""

_MEGA: Final = 1_000_000
_MIB: Final = 1024 * 1024


class LimitsConfig(Section):
    """What a log may ask for: what it declares is checked before memory is given to it.

    ``roadperc-info``, ``roadperc-view`` and the evaluation read with the defaults.
    """

    chunk_mb: Annotated[int, Field(ge=1, le=65_536), unit("MiB")] = 256
    """Largest chunk, decompressed; writers make chunks of 1 to 8 MiB, or of one message where that is larger."""
    chunk_messages: Annotated[int, Field(ge=1, le=1_000_000_000), unit("messages")] = 1_000_000
    """Most messages of a chunk; one of 8 MiB has 0.3 million of the shortest."""
    record_mb: Annotated[int, Field(ge=1, le=1_048_576), unit("MiB")] = 1024
    """Largest record of the file: a compressed chunk, an attachment, a message without a chunk."""
    attachments_mb: Annotated[int, Field(ge=1, le=1_048_576), unit("MiB")] = 1024
    """All attachments and metadata of a log together: they are held in memory."""
    gaps: Annotated[int, Field(ge=1, le=1_000_000), unit("gaps")] = 10_000
    """Most gaps that a repaired log says it has; one that has more gives those behind as one."""
    image_megapixels: Annotated[float, Field(ge=0.01, le=170.0), unit("megapixels")] = 40.0
    """Largest image, by its header and by its calibration; 8K has 33."""
    image_formats: Annotated[
        tuple[ImageFormat, ...],
        BeforeValidator(split),
        Field(min_length=1, json_schema_extra={"choices": [*get_args(ImageFormat)]}),
    ] = ("png", "jpeg", "webp")
    """Formats of the images that are decoded; others are refused by name."""
    points: Annotated[int, Field(ge=1, le=1_000_000_000), unit("points")] = 10_000_000
    """Most points of a lidar's message; a turn of 128 beams has 0.3 million."""
    message_mb: Annotated[int, Field(ge=1, le=4096), unit("MiB")] = 16
    """Largest message of anything but pixels and points."""
    detections: Annotated[int, Field(ge=1, le=100_000), unit("boxes")] = 2000
    """Most detections or objects of a message."""
    transforms: Annotated[int, Field(ge=1, le=100_000), unit("frames")] = 2000
    """Most frames in the tree of transforms."""
    name_length: Annotated[int, Field(ge=1, le=1_000_000), unit("characters")] = 1000
    """Longest name in a message: of a frame, a class, an object, an encoding."""

    @property
    def chunk_bytes(self) -> int:
        """Of the largest chunk."""
        return self.chunk_mb * _MIB

    @property
    def record_bytes(self) -> int:
        """Of the largest record."""
        return self.record_mb * _MIB

    @property
    def attachments_bytes(self) -> int:
        """Of all attachments and metadata."""
        return self.attachments_mb * _MIB

    @property
    def message_bytes(self) -> int:
        """Of the largest message of anything but pixels and points."""
        return self.message_mb * _MIB

    @property
    def image_pixels(self) -> int:
        """Of the largest image."""
        return int(self.image_megapixels * _MEGA)


DEFAULT_LIMITS: Final = LimitsConfig()
