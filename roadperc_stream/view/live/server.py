"""The WebSocket server that Foxglove connects to: channels, messages, and the playback controls of its window.

Protocol and server are those of the foxglove-sdk: https://docs.foxglove.dev/docs/sdk/websocket-server.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from threading import Thread
from typing import Final

import foxglove
from foxglove import Context, Schema
from foxglove.websocket import (
    Capability,
    ChannelView,
    Client,
    PlaybackCommand,
    PlaybackControlRequest,
    PlaybackState,
    PlaybackStatus,
    ServerListener,
    StatusLevel,
    WebSocketServer,
)

from roadperc_stream.errors import RoadpercError
from roadperc_stream.log import Channel, Message
from roadperc_stream.view.live.player import Answer, Player
from roadperc_stream.view.live.playhead import Order, Status

_BACKLOG_MESSAGES: Final = 256
"""A viewer that is slower than this many messages loses the oldest."""
_GOODBYE_S: Final = 2.0
_STATUS_ID: Final = "roadperc"
_STATUS: Final = {
    Status.PLAYING: PlaybackStatus.Playing,
    Status.PAUSED: PlaybackStatus.Paused,
    Status.WAITING: PlaybackStatus.Buffering,
    Status.ENDED: PlaybackStatus.Ended,
}


class ServeError(RoadpercError):
    """A server that cannot start."""


class Controls(ServerListener):
    """Hands what viewers do to the player; called in the server's few threads, which must not wait."""

    def __init__(self, player: Player) -> None:
        self._player = player

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002 - the signature is the SDK's
        """Somebody opened a panel."""
        self._player.watch(channel.topic)

    def on_playback_control_request(self, playback_control_request: PlaybackControlRequest) -> PlaybackState:
        """Somebody pressed play or pause, sought or chose a speed."""
        asked = playback_control_request
        play = asked.playback_command == PlaybackCommand.Play
        answer = self._player.control(Order(play, asked.playback_speed, asked.seek_time))
        return _playback_state(answer, asked.request_id)


class FoxgloveAudience:
    """Those who are connected to a server."""

    def __init__(self, server: WebSocketServer, context: Context, channels: Iterable[Channel]) -> None:
        self._server, self._context = server, context
        self._channels = {channel: _advertised(channel, context) for channel in channels}

    def send(self, message: Message) -> None:
        """Show a message, at its log time."""
        if message.channel not in self._channels:
            self._channels[message.channel] = _advertised(message.channel, self._context)
        self._channels[message.channel].log(message.data, log_time=message.log_time_ns)

    def time(self, log_ns: int) -> None:
        """Tell what log time it is."""
        self._server.broadcast_time(log_ns)

    def state(self, answer: Answer) -> None:
        """Tell that playback changed by itself."""
        self._server.broadcast_playback_state(_playback_state(answer, ""))

    def warn(self, text: str) -> None:
        """Show a warning in the viewer."""
        self._server.publish_status(text, StatusLevel.Warning, _STATUS_ID)

    def restart(self) -> None:
        """Begin a new session, in which viewers forget what was shown, with channels of their own.

        Some viewers forget the schemas too and learn them only from channels that are new.
        """
        for advertised in self._channels.values():
            advertised.close()
        self._server.clear_session()
        self._channels = {channel: _advertised(channel, self._context) for channel in self._channels}


@contextmanager
def serving(
    name: str, host: str, port: int, span_ns: tuple[int, int], channels: Iterable[Channel], player: Player
) -> Iterator[tuple[FoxgloveAudience, int]]:
    """Run a server.

    Args:
        name: what viewers call the source.
        host: the address to listen on.
        port: 0 for a free one.
        span_ns: first and last log time of the log, once it is complete.
        channels: those announced to viewers at once.
        player: does what viewers ask.

    Yields:
        Those who are connected, and the port.

    Raises:
        ServeError: the address or the port cannot be had.
    """
    context = Context()
    try:
        server = foxglove.start_server(
            name=name,
            host=host,
            port=port,
            capabilities=[Capability.Time, Capability.PlaybackControl],
            server_listener=Controls(player),
            context=context,
            playback_time_range=span_ns,
            message_backlog_size=_BACKLOG_MESSAGES,
        )
    except RuntimeError as error:
        reason = str(error).removeprefix("FoxgloveError: ")
        hint = "; --port 0 takes a free port" if "in use" in reason else ""
        raise ServeError(f"{host}:{port}: {reason}{hint}") from error
    try:
        yield FoxgloveAudience(server, context, channels), server.port
    finally:
        _stop(server)


def _stop(server: WebSocketServer) -> None:
    """Stop, but wait no longer for viewers to say goodbye than a person does: one that sleeps never will."""
    stopping = Thread(target=server.stop, name="stop", daemon=True)
    stopping.start()
    stopping.join(_GOODBYE_S)


def _playback_state(answer: Answer, request_id: str) -> PlaybackState:
    head = answer.playhead
    return PlaybackState(_STATUS[head.status], head.log_ns, head.rate, answer.moved, request_id)


def _advertised(channel: Channel, context: Context) -> foxglove.Channel:
    schema = Schema(name=channel.schema_name, encoding=channel.schema_encoding, data=channel.schema_data)
    return foxglove.Channel(
        channel.topic,
        message_encoding=channel.message_encoding,
        schema=schema,
        metadata=dict(channel.metadata),
        context=context,
    )
