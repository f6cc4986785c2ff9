"""The WebSocket server that Foxglove connects to.

Protocol and server are those of the foxglove-sdk: https://docs.foxglove.dev/docs/sdk/websocket-server.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from threading import Thread
from typing import Final

import foxglove
from foxglove import Context, Schema
from foxglove.websocket import Capability, ServerListener, WebSocketServer

from roadperc_stream.errors import RoadpercError
from roadperc_stream.log import Channel, Message

_BACKLOG_MESSAGES: Final = 256
"""A viewer that is slower than this many messages loses the oldest."""
_GOODBYE_S: Final = 2.0


class ServeError(RoadpercError):
    """A server that cannot start."""


class Audience:
    """The viewers that are connected to a server, and the channels that it offers them."""

    def __init__(self, server: WebSocketServer, context: Context, channels: Iterable[Channel]) -> None:
        self.server, self._context = server, context
        self._channels = {channel: _advertised(channel, context) for channel in channels}

    def send(self, message: Message) -> None:
        """Show a message, at its log time."""
        if message.channel not in self._channels:
            self._channels[message.channel] = _advertised(message.channel, self._context)
        self._channels[message.channel].log(message.data, log_time=message.log_time_ns)

    def restart(self) -> None:
        """Begin a new session, in which viewers forget what was shown, with channels of their own.

        Some viewers forget the schemas too and learn them only from channels that are new.
        """
        for advertised in self._channels.values():
            advertised.close()
        self.server.clear_session()
        self._channels = {channel: _advertised(channel, self._context) for channel in self._channels}


@contextmanager
def serving(
    name: str,
    address: tuple[str, int],
    span_ns: tuple[int, int],
    channels: Iterable[Channel],
    listener: ServerListener,
) -> Iterator[Audience]:
    """Run a server.

    Args:
        name: what viewers call the source.
        address: host and port to listen on; port 0 for a free one.
        span_ns: first and last log time of the log, once it is complete.
        channels: those announced to viewers at once.
        listener: does what viewers ask.

    Raises:
        ServeError: the address or the port cannot be had.
    """
    context, (host, port) = Context(), address
    try:
        server = foxglove.start_server(
            name=name,
            host=host,
            port=port,
            capabilities=[Capability.Time, Capability.PlaybackControl],
            server_listener=listener,
            context=context,
            playback_time_range=span_ns,
            message_backlog_size=_BACKLOG_MESSAGES,
        )
    except RuntimeError as error:
        reason = str(error).removeprefix("FoxgloveError: ")
        hint = "; --port 0 takes a free port" if "in use" in reason else ""
        raise ServeError(f"{host}:{port}: {reason}{hint}") from error
    try:
        yield Audience(server, context, channels)
    finally:  # wait no longer for viewers to say goodbye than a person does: one that sleeps never will
        stopping = Thread(target=server.stop, name="stop", daemon=True)
        stopping.start()
        stopping.join(_GOODBYE_S)


def _advertised(channel: Channel, context: Context) -> foxglove.Channel:
    schema = Schema(name=channel.schema_name, encoding=channel.schema_encoding, data=channel.schema_data)
    return foxglove.Channel(
        channel.topic,
        message_encoding=channel.message_encoding,
        schema=schema,
        metadata=dict(channel.metadata),
        context=context,
    )
