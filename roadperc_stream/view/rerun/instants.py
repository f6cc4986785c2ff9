"""Messages of one log time together, with the number of their frame."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby

from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream.input.earlier_replay import is_result_of
from roadperc_stream.log import Message
from roadperc_stream.schemas.roadperc_pb2 import FrameMetrics
from roadperc_stream.schemas.topics import METRICS_TOPIC


@dataclass(frozen=True)
class Instant:
    """All messages of one log time."""

    log_time_ns: int
    frame: int
    """Number of the frame it belongs to, from 0; -1 before the first."""
    messages: tuple[Message, ...]

    @property
    def has_results(self) -> bool:
        """Whether a frame's results are among them: each frame has its metrics."""
        return any(is_result_of(message.channel, METRICS_TOPIC) for message in self.messages)


def instants(messages: Iterable[Message], reference: str | None) -> Iterator[Instant]:
    """Group messages by log time.

    Args:
        messages: in log-time order.
        reference: topic of which every message is a frame, where no metrics number it; None where there is none.
    """
    frame = -1
    for log_time_ns, together in groupby(messages, key=lambda message: message.log_time_ns):
        group = tuple(together)
        frame = _frame(group, reference, frame)
        yield Instant(log_time_ns, frame, group)


def _frame(group: tuple[Message, ...], reference: str | None, last: int) -> int:
    """The number that the metrics of these messages say, else the next one where a frame is among them."""
    for message in (m for m in group if is_result_of(m.channel, METRICS_TOPIC)):
        with suppress(ProtobufError):  # a damaged one is reported where it would be drawn
            return int(FrameMetrics.FromString(message.data).frame)
    return last + any(message.channel.topic == reference for message in group)
