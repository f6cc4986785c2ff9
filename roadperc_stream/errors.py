"""The errors of this project, each with a one-line message; only the command line catches them."""


class RoadpercError(Exception):
    """Root of every error this project states: the message says what and where."""


class LogError(RoadpercError):
    """A log that cannot be read or written."""


class NoFrameError(LogError):
    """A log, or a part of one, in which there is no frame."""


class ChannelError(RoadpercError):
    """Topics, schemas or roles that do not fit together."""


class DecodeError(RoadpercError):
    """One message whose bytes are not what its schema promises."""


class ConfigError(RoadpercError):
    """A setting that does not exist or does not fit."""


class StateError(RoadpercError):
    """A saved state or checkpoint from which a replay cannot continue."""


class DumpError(RoadpercError):
    """A dump folder that cannot be converted."""


class TableError(RoadpercError):
    """A metrics table that cannot be read or reported."""


class RegressionError(RoadpercError):
    """A run that is worse than its reference: a result with its own exit code, not a failure."""


class TargetError(RoadpercError):
    """A file that may not be written under the name asked for."""


class StorageError(RoadpercError):
    """A place that cannot be reached, read or written."""


class ClusterError(RoadpercError):
    """A cluster that cannot be joined, or that is lost."""


class ProgramError(RoadpercError):
    """A program that was started for what it does or takes, and failed."""
