"""What is wrong with single messages of a log: counted, and put in words once a topic."""

from collections import Counter
from dataclasses import dataclass, field

from roadperc_stream.errors import DecodeError


@dataclass
class Problems:
    """Messages that could not be read: how many of each topic, and the first of each in words."""

    counts: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def add(self, topic: str, time_ns: int, error: DecodeError) -> None:
        """Count one more, by its log time or by the stamp of its frame."""
        self.counts[topic] += 1
        self.first.setdefault(topic, f"{topic}: message at {time_ns} ns: {error}")

    def report(self, topic: str, text: str) -> None:
        """Keep the first such text about messages of a topic that are read, but not used as they are."""
        self.first.setdefault(f"{topic}, in part", text)
