"""Messages of one log into another, as far as other writing has come."""

from collections.abc import Iterable, Iterator

from roadperc_stream.log.records import Channel, Message
from roadperc_stream.log.writing import LogWriter


class MessageCopy:
    """Copies messages to a log that others write to as well, so that all stand in the order of log time."""

    def __init__(self, writer: LogWriter, channels: Iterable[Channel], messages: Iterator[Message]) -> None:
        """Register the channels, also those that never get a message.

        Args:
            writer: of the log to copy to.
            channels: of the messages, and others to be there.
            messages: in the order of log time.
        """
        self._writer, self._messages = writer, messages
        for channel in channels:
            writer.register(channel)
        self._next = next(messages, None)

    def through(self, log_time_ns: int | None) -> None:
        """Copy everything up to and including a log time; None copies all that is left."""
        while self._next is not None and (log_time_ns is None or self._next.log_time_ns <= log_time_ns):
            self._writer.write(self._next)
            self._next = next(self._messages, None)

    def rest(self) -> None:
        """Copy all that is left."""
        self.through(None)
