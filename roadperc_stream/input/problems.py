"""What is wrong with single messages of a log: counted, and put in words once a topic."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from roadperc_stream.errors import DecodeError, LogError


@dataclass
class Problems:
    """Messages that could not be read: how many of each topic, and the first of each in words.

    Args:
        strict_in: the log whose first such message is an error; None where it costs that message alone.
    """

    strict_in: Path | None = None
    counts: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def add(self, topic: str, time_ns: int, error: DecodeError) -> None:
        """Count one more, by its log time or by the stamp of its frame.

        Raises:
            LogError: the replay is strict.
        """
        self._require_lenient(f"{topic}: message at {time_ns} ns: {error}")
        self.counts[topic] += 1
        self.first.setdefault(topic, f"{topic}: message at {time_ns} ns: {error}")

    def report(self, topic: str, text: str) -> None:
        """Keep the first such text about messages of a topic that are read, but not used as they are.

        Raises:
            LogError: the replay is strict.
        """
        self._require_lenient(text)
        self.first.setdefault(f"{topic}, in part", text)

    def _require_lenient(self, text: str) -> None:
        if self.strict_in is not None:
            raise LogError(f"{self.strict_in}: {text}; --strict stops there")
