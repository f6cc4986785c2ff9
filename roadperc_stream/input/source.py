"""Which part of which log is to be replayed, and how its messages are taken."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from roadperc_stream.core.config import LimitsConfig
from roadperc_stream.core.time import WHOLE, TimeRange
from roadperc_stream.input.damage import ReadableLog, readable_log


@dataclass(frozen=True)
class ReplaySource:
    """What is to be replayed.

    Args:
        paths: the log, or its parts; ``-`` is standard input.
        overrides: topic of each role that is not on the contract's topic.
        time_range: the part to replay; the copy of the input is cut with it.
        recover: replay what can be read of a damaged log; frames behind what was lost say so.
        strict: the first message that cannot be used is an error, instead of costing that message alone.
        is_audited: whether an earlier reading has checked the log, as ``log.summarise``: then no more of it is read
            than is replayed.
    """

    paths: Path | Sequence[Path]
    overrides: Mapping[str, str] = field(default_factory=dict)
    time_range: TimeRange = WHOLE
    recover: bool = False
    strict: bool = False
    is_audited: bool = False

    @property
    def files(self) -> tuple[Path, ...]:
        """The log's parts, one of a log that is not in parts."""
        return (self.paths,) if isinstance(self.paths, Path) else tuple(self.paths)

    def read(self, limits: LimitsConfig) -> ReadableLog:
        """The log, as far as it can be read.

        Raises:
            LogError: it cannot, or is damaged where that is an error.
            TargetError: there is no space for temporary files, where the log needs some.
        """
        return readable_log(self.files, limits, self.time_range, recover=self.recover, is_audited=self.is_audited)
