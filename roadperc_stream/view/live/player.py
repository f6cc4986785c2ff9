"""Plays a log: one thread sends the messages at their time. Viewers move the playhead at once.

Protocol and server are those of the foxglove-sdk: https://docs.foxglove.dev/docs/sdk/websocket-server.
Log times and clock times are integer nanoseconds; the rate is log seconds per second.
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from threading import Event, Lock
from typing import Final

import foxglove
from foxglove import websocket as ws
from foxglove.websocket import PlaybackStatus

from roadperc_stream.log import Channel, Message
from roadperc_stream.system.time import LONGEST_PAUSE_NS, NS_PER_S, ns_to_seconds
from roadperc_stream.view.live import FASTEST, SLOWEST
from roadperc_stream.view.live.source import Reach, Source, held

TICK_S: Final = 0.1
"""Longest wait while playing, so that the viewer's clock moves through gaps of the log."""
EDGE_POLL_S: Final = 0.05
"""Interval of polling a log that is still written."""
RESUME_LEAD_S: Final = 0.25
"""Seconds of playback that must be computed before playback continues; avoids stutter."""
LOOP_PAUSE_S: Final = 0.5
"""Pause at the end before playback starts over, while sent messages arrive."""
LONGEST_WAIT_S: Final = 0.5
"""Longest wait without playback; Python handles a signal only after the wait."""
_STATUS_ID: Final = "roadperc"


@dataclass(frozen=True)
class Playhead:
    """Playback was at ``log_ns`` at clock time ``clock_ns`` and continues according to its status.

    Buffering means waiting for more of a running replay.
    """

    status: PlaybackStatus
    log_ns: int
    clock_ns: int
    rate: float = 1.0

    def at(self, clock_ns: int) -> int:
        """The log time at a clock time."""
        if self.status != PlaybackStatus.Playing:
            return self.log_ns
        return self.log_ns + round((clock_ns - self.clock_ns) * self.rate)

    def state(self, request_id: str = "", *, moved: bool = False) -> ws.PlaybackState:
        """The state for viewers; ``request_id`` is the id of the answered request."""
        return ws.PlaybackState(self.status, self.log_ns, self.rate, moved, request_id)


def apply_request(
    playhead: Playhead, request: ws.PlaybackControlRequest, reach: Reach, clock_ns: int
) -> tuple[Playhead, bool]:
    """Apply a viewer's request.

    Playing from the end starts over. A rate that is not a positive number is ignored; others are clamped to
    ``SLOWEST`` and ``FASTEST``.

    Returns:
        The new playhead, and whether the viewer moved it.
    """
    now_ns, seek_ns, rate = playhead.at(clock_ns), request.seek_time, request.playback_speed
    play = request.playback_command == ws.PlaybackCommand.Play
    if play and seek_ns is None and reach.complete and now_ns >= reach.last_ns:
        seek_ns = reach.first_ns
    rate = min(max(rate, SLOWEST), FASTEST) if math.isfinite(rate) and rate > 0 else playhead.rate
    status = PlaybackStatus.Playing if play else PlaybackStatus.Paused
    return Playhead(status, reach.clamp(now_ns if seek_ns is None else seek_ns), clock_ns, rate), seek_ns is not None


def advance(
    playhead: Playhead, next_ns: int | None, reach: Reach, clock_ns: int, *, loop_ns: int | None = None
) -> tuple[Playhead, float]:
    """The playhead now, and the seconds until it changes or the next message is due.

    A message is due when playback reaches its log time, or at once if log time goes back. A gap of more than an hour is
    skipped. A change from the end to a pause starts playback over: viewers then drop the messages that they showed.
    ``next_ns`` is the log time of the next message, ``reach`` the playable span, read before that message. ``loop_ns``
    is the log time to start over from at the end, None to stay there.
    """
    if playhead.status == PlaybackStatus.Buffering:
        return _at_the_edge(playhead, reach, clock_ns)
    if playhead.status == PlaybackStatus.Ended and loop_ns is not None:
        return _at_the_end(playhead, clock_ns, loop_ns)
    if playhead.status != PlaybackStatus.Playing:
        return playhead, LONGEST_WAIT_S
    now_ns = playhead.at(clock_ns)
    if next_ns is not None:
        if next_ns - now_ns > LONGEST_PAUSE_NS:
            playhead, now_ns = replace(playhead, log_ns=next_ns, clock_ns=clock_ns), next_ns
        return playhead, min(max(next_ns - now_ns, 0) / playhead.rate / NS_PER_S, TICK_S)
    if reach.complete:
        return Playhead(PlaybackStatus.Ended, reach.last_ns, clock_ns, playhead.rate), LOOP_PAUSE_S
    return Playhead(PlaybackStatus.Buffering, reach.clamp(now_ns), clock_ns, playhead.rate), EDGE_POLL_S


def _at_the_edge(playhead: Playhead, reach: Reach, clock_ns: int) -> tuple[Playhead, float]:
    if reach.complete or reach.last_ns - playhead.log_ns >= RESUME_LEAD_S * playhead.rate * NS_PER_S:
        return replace(playhead, status=PlaybackStatus.Playing, clock_ns=clock_ns), 0.0
    return playhead, EDGE_POLL_S


def _at_the_end(playhead: Playhead, clock_ns: int, loop_ns: int) -> tuple[Playhead, float]:
    wait_ns = playhead.clock_ns + round(LOOP_PAUSE_S * NS_PER_S) - clock_ns
    if wait_ns > 0:
        return playhead, wait_ns / NS_PER_S
    return Playhead(PlaybackStatus.Paused, loop_ns, clock_ns, playhead.rate), LONGEST_WAIT_S


class Viewers:
    """The viewers of a server, and the channels that it advertises to them."""

    def __init__(self, server: ws.WebSocketServer, context: foxglove.Context, channels: Iterable[Channel]) -> None:
        self.server, self._context = server, context
        self._channels = {channel: _advertised(channel, context) for channel in channels}

    def send(self, message: Message) -> None:
        """Send a message with its log time."""
        if message.channel not in self._channels:
            self._channels[message.channel] = _advertised(message.channel, self._context)
        self._channels[message.channel].log(message.data, log_time=message.log_time_ns)

    def restart(self) -> None:
        """Start a new session, so that viewers drop the old messages.

        Some viewers also drop the schemas and read them only from new channels, so the channels are new too.
        """
        for advertised in self._channels.values():
            advertised.close()
        self.server.clear_session()
        self._channels = {channel: _advertised(channel, self._context) for channel in self._channels}


def _advertised(channel: Channel, context: foxglove.Context) -> foxglove.Channel:
    schema = foxglove.Schema(name=channel.schema_name, encoding=channel.schema_encoding, data=channel.schema_data)
    return foxglove.Channel(
        channel.topic,
        message_encoding=channel.message_encoding,
        schema=schema,
        metadata=dict(channel.metadata),
        context=context,
    )


class Player(ws.ServerListener):
    """Plays a source from a log time on, after the first viewer subscribes.

    Any thread may call ``stop``. The server's threads call the ``on_`` methods. These never wait for the disk, since
    only ``run`` reads.
    """

    def __init__(
        self, source: Source, clock_ns: Callable[[], int], *, start_ns: int, rate: float = 1.0, loop: bool = False
    ) -> None:
        self._source, self._clock_ns, self._wake = source, clock_ns, Event()
        self._loop_ns = start_ns if loop else None
        self._lock = Lock()
        """Guards the fields that viewers change: the next four."""
        self._playhead = Playhead(PlaybackStatus.Paused, start_ns, clock_ns(), rate)
        self._watched = self._stopped = False
        self._fresh = set[str]()
        """Topics with new subscribers, which need the held messages."""
        self._seek_request: ws.PlaybackControlRequest | None = None
        """The newest seek that ``run`` has not handled yet."""
        self._follow_from(start_ns + 1)  # the first subscribers get the messages up to here as held ones

    def on_subscribe(self, client: ws.Client, channel: ws.ChannelView) -> None:  # noqa: ARG002 - the signature is the SDK's
        """Note a new subscriber; ``run`` sends it the held messages of the topic."""
        with self._lock:
            self._fresh.add(channel.topic)
        self._wake.set()

    def on_playback_control_request(self, playback_control_request: ws.PlaybackControlRequest) -> ws.PlaybackState:
        """Move the playhead. ``run`` then sends the messages there, or those of a newer request."""
        request = playback_control_request
        with self._lock:
            self._playhead, moved = apply_request(self._playhead, request, self._source.reach(), self._clock_ns())
            self._watched = True
            self._seek_request = request if moved else self._seek_request
            answer = self._playhead.state(request.request_id, moved=moved)
        self._wake.set()
        return answer

    def stop(self) -> None:
        """End ``run``."""
        self._stopped = True
        self._wake.set()

    def run(self, viewers: Viewers) -> None:
        """Play until ``stop``.

        Raises:
            LogError: the log can no longer be read.
        """
        self._viewers = viewers
        wait_s = 0.0
        while True:
            self._wake.wait(wait_s)
            self._wake.clear()
            if self._stopped:
                return
            self._seek()
            self._serve_new_subscribers()
            wait_s = self._advance()

    def _seek(self) -> None:
        """Send the messages held at the newest requested time, and continue there."""
        with self._lock:
            request, self._seek_request, log_ns = self._seek_request, None, self._playhead.log_ns
        if request is None:
            return
        reach, server = self._source.reach(), self._viewers.server
        if request.seek_time is not None and request.seek_time > reach.last_ns and not reach.complete:
            missing_s = ns_to_seconds(request.seek_time - reach.last_ns)
            warning = f"the replay is {missing_s:.1f} s before the requested time; playing from its end"
            server.publish_status(warning, ws.StatusLevel.Warning, _STATUS_ID)
        server.broadcast_time(log_ns)
        self._send_held({channel.topic for channel in self._source.channels}, log_ns)
        self._follow_from(log_ns + 1)

    def _serve_new_subscribers(self) -> None:
        """Send the messages held now to new subscribers. The first subscribers start playback."""
        with self._lock:
            if self._seek_request or not self._fresh:
                return  # a seek sends all topics
            fresh, self._fresh = self._fresh, set()
            clock_ns = self._clock_ns()
            now_ns = self._playhead.at(clock_ns)
            status = self._playhead.status if self._watched else PlaybackStatus.Playing
            self._watched, self._playhead = True, Playhead(status, now_ns, clock_ns, self._playhead.rate)
        coming = self._peek()
        self._viewers.server.broadcast_time(now_ns)  # a viewer that connects during a pause has no time yet
        self._send_held(fresh, min(now_ns, coming.log_time_ns - 1) if coming else now_ns)
        self._viewers.server.broadcast_playback_state(self._playhead.state())

    def _send_held(self, topics: Collection[str], log_ns: int) -> None:
        for message in held(self._source, topics, log_ns):
            self._viewers.send(message)

    def _follow_from(self, log_ns: int) -> None:
        self._coming: Iterator[Message | None] = self._source.follow(log_ns)
        self._next: Message | None = None

    def _peek(self) -> Message | None:
        self._next = self._next or next(self._coming, None)
        return self._next

    def _advance(self) -> float:
        """Send a message that is due and update the status; return the seconds to the next action."""
        reach, coming = self._source.reach(), self._peek()
        next_ns = coming.log_time_ns if coming else None
        with self._lock:
            if self._seek_request:
                return 0.0  # a seek has just moved the playhead
            before, clock_ns = self._playhead, self._clock_ns()
            head, wait_s = advance(before, next_ns, reach, clock_ns, loop_ns=self._loop_ns)
            restarts = before.status == PlaybackStatus.Ended and head.status == PlaybackStatus.Paused
            self._playhead, self._watched = head, self._watched and not restarts
        if restarts:  # viewers without seek would connect the end to the start
            self._viewers.restart()
            self._follow_from(head.log_ns + 1)
        elif coming and before.status == head.status == PlaybackStatus.Playing and wait_s == 0:
            self._viewers.send(coming)
            self._next = None
        elif head.status == PlaybackStatus.Playing:
            self._viewers.server.broadcast_time(head.at(self._clock_ns()))
        if head.status != before.status:
            self._viewers.server.broadcast_playback_state(head.state(moved=restarts))
        return wait_s
