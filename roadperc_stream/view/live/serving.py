"""Serves a finished log until Ctrl-C, or the output of a replay during the replay."""

import shlex
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, suppress
from ipaddress import ip_address
from threading import Thread
from time import monotonic_ns
from typing import Final

from foxglove import Context, start_server
from foxglove.websocket import Capability

from roadperc_stream import log
from roadperc_stream.errors import LogError, RoadpercError
from roadperc_stream.log import LogWriter
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import print_line
from roadperc_stream.system.time import ns_to_seconds, seconds_to_ns
from roadperc_stream.view.live import PlaybackOptions
from roadperc_stream.view.live.player import LONGEST_WAIT_S, Player, Viewers
from roadperc_stream.view.live.source import Source, finished_log, has_times, running_replay, with_times
from roadperc_stream.view.result_frames import ReplayTimes, TableTimes

_BACKLOG_MESSAGES: Final = 512
"""Messages that wait for a slow viewer; older ones are dropped."""
_STOP_S: Final = 2.0
_HOW_TO_CONNECT: Final = (
    "Foxglove: Open connection > Foxglove WebSocket > this address; playback starts when a panel is open"
)


class ServeError(RoadpercError):
    """The server cannot start."""


def serve_log(file: log.AnyLog, options: PlaybackOptions, *, quiet: bool = False) -> None:
    """Serve a finished log to Foxglove until Ctrl-C or SIGTERM, which ``cli.launch`` turns into Ctrl-C.

    Raises:
        LogError: the log is unreadable or has no messages, or ``--start`` is outside it.
        TableError: the metrics table beside it cannot be read.
        ServeError: the port is not available.
    """
    path, source = log.LogFile.of(file).name, log_with_times(file)
    reach, start_ns = source.reach(), source.reach().first_ns + seconds_to_ns(options.start_s)
    if reach.clamp(start_ns) != start_ns:
        length_s = ns_to_seconds(reach.last_ns - reach.first_ns)
        raise LogError(
            f"{path}: --start {options.start_s:g}: expected 0 to {length_s:.3f}, the log's length in seconds"
        )
    named, beside = (shlex.quote(str(file)) for file in (path, path.with_suffix(".layout.json")))
    layout = f"{named} --foxglove --foxglove-layout {beside}"
    served = playing(source, path.name, (reach.first_ns, reach.last_ns), options, None if quiet else layout)
    with suppress(KeyboardInterrupt), served as (player, viewers):
        player.run(viewers)


def log_with_times(file: log.AnyLog) -> Source:
    """A finished log, with stage times if the table beside it has them.

    Raises:
        LogError: the log is unreadable or has no messages.
        TableError: the table cannot be read.
    """
    summary = log.summarise(file)
    source, times = finished_log(summary), TableTimes(sidecar_path(summary.path, "metrics")).of
    return with_times(source, times) if has_times(source, times) else source


class LiveReplay(ExitStack):
    """Serves the output of a replay from its first message on. Use it as a context manager around ``replay``."""

    def __init__(self, options: PlaybackOptions, *, quiet: bool = False) -> None:
        super().__init__()
        self._options, self._quiet = options, quiet
        self._playback: Future[None] | None = None
        self.times = ReplayTimes()
        """Collects the stage times of each frame."""

    def start(self, writer: LogWriter, span_ns: tuple[int, int]) -> None:
        """Start the server; ``replay`` calls it when all channels are registered, before the first message.

        ``span_ns`` is first and last log time of the complete output.

        Raises:
            ServeError: the port is not available.
        """
        source = with_times(running_replay(writer.while_written(), span_ns[0]), self.times.of)
        # For all topics, as the log's are unknown yet.
        layout = None if self._quiet else "--foxglove-layout layout.json"
        player, viewers = self.enter_context(playing(source, writer.path.name, span_ns, self._options, layout))
        self.port = viewers.server.port
        thread = self.enter_context(ThreadPoolExecutor(1, "player"))
        self.callback(player.stop)
        self._playback = thread.submit(player.run, viewers)

    def wait(self) -> None:
        """Serve the complete output until Ctrl-C; return at once if nothing is served.

        Raises:
            LogError: the output is no longer readable.
        """
        with suppress(KeyboardInterrupt):
            if self._playback and not self._quiet:
                with optional_output():
                    print("the replay is complete and still served; press Ctrl-C to end")
            while self._playback and not self._playback.done():
                wait([self._playback], LONGEST_WAIT_S)
        if self._playback and self._playback.done():
            self._playback.result()


def _is_this_machine(host: str) -> bool:
    """Whether only this machine reaches an address."""
    with suppress(ValueError):
        return ip_address(host).is_loopback
    return host == "localhost"


@contextmanager
def playing(
    source: Source, name: str, span_ns: tuple[int, int], options: PlaybackOptions, layout: str | None
) -> Iterator[tuple[Player, Viewers]]:
    """Start a server with a player; the caller runs the player.

    ``span_ns`` is first and last log time of the complete log. ``layout`` are the roadperc-view arguments that write a
    matching layout, which are printed; None prints nothing.

    Raises:
        ServeError: the address or the port is not available.

    Yields:
        The player and its viewers.
    """
    start_ns, host, context = source.reach().first_ns + seconds_to_ns(options.start_s), options.host, Context()
    player = Player(source, monotonic_ns, start_ns=start_ns, rate=options.rate, loop=options.loop)
    try:
        server = start_server(
            name=name,
            host=host,
            port=options.port,
            capabilities=[Capability.Time, Capability.PlaybackControl],
            server_listener=player,
            context=context,
            playback_time_range=span_ns,
            message_backlog_size=_BACKLOG_MESSAGES,
        )
    except RuntimeError as error:
        reason = str(error).removeprefix("FoxgloveError: ")
        hint = "; pass --port 0 for a free port" if "in use" in reason else ""
        raise ServeError(f"{host}:{options.port}: {reason}{hint}") from error
    try:
        viewers = Viewers(server, context, source.channels)
        if layout is not None:
            with optional_output():
                print_line(f"serving ws://{f'[{host}]' if ':' in host else host}:{server.port} (press Ctrl-C to end)")
                print_line(_HOW_TO_CONNECT)
                print_line(f"layout, for Layouts > Import from file: roadperc-view {layout}")
        if not _is_this_machine(host):
            note = "every machine that reaches it can read the messages and move the playback"
            with optional_output(sys.stderr):
                print_line(f"note: {host}: {note}; without --host only this machine can", sys.stderr)
        yield player, viewers
    finally:  # a viewer that does not respond must not block the end
        stopping = Thread(target=server.stop, name="stop", daemon=True)
        stopping.start()
        stopping.join(_STOP_S)
