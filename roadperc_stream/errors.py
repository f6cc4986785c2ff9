"""Errors of this project, each with a one-line message; only the command line catches them."""

from typing import Final

WITHOUT_CALIBRATION: Final = "--fov DEGREES or --calibration FILE"
"""The options for a log without calibration."""


class RoadpercError(Exception):
    """Root of all errors of this project; the message says what is wrong and where.

    ``option`` is what the user may pass to a command instead, and ``purpose`` what for. The text names both.
    """

    def __init__(self, message: str = "", option: str = "", purpose: str = "") -> None:
        super().__init__(message)
        self.option, self.purpose = option, purpose

    def __str__(self) -> str:
        return f"{super().__str__()}; pass {self.option} {self.purpose}".rstrip() if self.option else super().__str__()


class LogError(RoadpercError):
    """A log that cannot be read or written."""


class NoFrameError(LogError):
    """A log, or a part of it, without frames."""


class ChannelError(RoadpercError):
    """Topics, schemas or roles that do not fit together."""


class DecodeError(RoadpercError):
    """One message whose bytes do not fit its schema."""


class ConfigError(RoadpercError):
    """A setting that does not exist or has an invalid value."""


class StageError(RoadpercError):
    """A stage of the user's own that failed, or whose output cannot be used."""


class StateError(RoadpercError):
    """A saved state or checkpoint from which a replay cannot continue."""


class DumpError(RoadpercError):
    """A dump, dataset, video or calibration that cannot be converted."""


class TableError(RoadpercError):
    """A metrics table that cannot be read or reported."""


class RegressionError(RoadpercError):
    """A run that is worse than its reference: a result with its own exit code, not a failure."""


class TargetError(RoadpercError):
    """An output that may not or cannot be written."""


class StorageError(RoadpercError):
    """A file or folder of a batch that cannot be reached, read or written."""


class ClusterError(RoadpercError):
    """A cluster that cannot be joined or was lost."""


class ProgramError(RoadpercError):
    """An external program that failed."""
