"""Serving a finished log until Ctrl-C, and the output of a replay while it is computed."""

import shlex
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Thread
from time import monotonic_ns
from types import TracebackType
from typing import Self

from roadperc_stream.errors import LogError
from roadperc_stream.log import LogWriter
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.topics import TIMES_TOPIC
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import print_line
from roadperc_stream.system.time import ns_to_seconds, seconds_to_ns
from roadperc_stream.view.live.player import LONGEST_WAIT_S, Audience, Player
from roadperc_stream.view.live.playhead import PlaybackOptions
from roadperc_stream.view.live.server import serving
from roadperc_stream.view.live.source import FinishedLog, RunningReplay, Source, TimedSource
from roadperc_stream.view.result_frames import ReplayTimes, TableTimes


def serve_log(path: Path, options: PlaybackOptions, *, quiet: bool = False) -> None:
    """Serve a finished log to Foxglove until Ctrl-C or SIGTERM, which ``plumbing.run`` turns into Ctrl-C.

    Args:
        path: the log.
        options: speed, start, loop and address.
        quiet: print nothing.

    Raises:
        LogError: the log cannot be read or holds no message, or ``--start`` lies outside.
        TableError: the metrics table beside it cannot be read.
        ServeError: the port cannot be had.
    """
    log = FinishedLog.opened(path)
    span_ns, length_s = (log.first_ns, log.last_ns), ns_to_seconds(log.last_ns - log.first_ns)
    start_ns = log.first_ns + seconds_to_ns(options.start_s)
    if log.reach().clamp(start_ns) != start_ns:
        raise LogError(
            f"{path}: --start {options.start_s:g}: expected 0 to {length_s:.3f}, the log's length in seconds"
        )
    layout = (
        f"{shlex.quote(str(path))} --foxglove --foxglove-layout {shlex.quote(str(path.with_suffix('.layout.json')))}"
    )
    served = playing(with_times(log), path.name, span_ns, options, layout, quiet=quiet)
    with suppress(KeyboardInterrupt), served as (player, audience):
        player.run(audience)


def with_times(log: FinishedLog) -> Source:
    """A log with the times of its stages, where the table beside it has them.

    Raises:
        TableError: the table cannot be read.
    """
    timed = TimedSource(log, TableTimes(sidecar_path(log.summary.path, "metrics")))
    return timed if timed.has_times() else log


def serves_times(path: Path) -> bool:
    """Whether ``serve_log`` offers the times of a log's stages.

    Raises:
        LogError: the log cannot be read or holds no message.
        TableError: the metrics table beside it cannot be read.
    """
    return any(channel.topic == TIMES_TOPIC for channel in with_times(FinishedLog.opened(path)).channels)


class LiveReplay:
    """Serves the output of a replay from its first message on. Use it as a context manager around ``replay``.

    ``times`` takes each frame's times.
    """

    def __init__(self, options: PlaybackOptions, *, quiet: bool = False) -> None:
        self._options, self._quiet, self.times = options, quiet, ReplayTimes()
        self._until_exit = ExitStack()
        self._thread: Thread | None = None
        self._error: Exception | None = None

    def __enter__(self) -> Self:
        return self

    def start(self, writer: LogWriter, span_ns: tuple[int, int]) -> None:
        """Begin: ``replay`` calls it when all channels are known and nothing is written yet.

        Args:
            writer: writes the output.
            span_ns: first and last log time it will have.

        Raises:
            ServeError: the port cannot be had.
        """
        source = TimedSource(RunningReplay(writer.while_written(), span_ns[0]), self.times)
        layout = "--foxglove-layout layout.json"  # one for all topics: the log's own are not known yet
        served = playing(source, writer.path.name, span_ns, self._options, layout, quiet=self._quiet)
        player, audience = self._until_exit.enter_context(served)
        self._thread = Thread(target=self._run, args=(player, audience), name="player", daemon=True)
        self._thread.start()
        self._until_exit.callback(self._thread.join)
        self._until_exit.callback(player.stop)

    def wait(self) -> None:
        """Go on serving the complete output until Ctrl-C; return at once where nothing is served.

        Raises:
            LogError: it can no longer be read.
        """
        if self._thread is not None:
            with suppress(KeyboardInterrupt):
                if not self._quiet:
                    with optional_output():
                        print("the replay is complete and still served: Ctrl-C ends")
                while self._thread.is_alive():
                    self._thread.join(LONGEST_WAIT_S)
        if self._error is not None:
            raise self._error

    def _run(self, player: Player, audience: Audience) -> None:
        try:
            player.run(audience)
        except Exception as error:  # Whatever ends this thread is raised where the command waits for it.
            self._error = error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._until_exit.close()


@contextmanager
def playing(
    source: Source,
    name: str,
    span_ns: tuple[int, int],
    options: PlaybackOptions,
    layout: str,
    *,
    quiet: bool,
) -> Iterator[tuple[Player, Audience]]:
    """A player that is served under an address, and those who watch it; the caller runs it for them.

    Args:
        source: what to play.
        name: what viewers call it.
        span_ns: first and last log time there will be.
        options: speed, start, loop and address.
        layout: arguments with which roadperc-view writes a layout for it.
        quiet: do not print where to connect.
    """
    start_ns = source.reach().first_ns + seconds_to_ns(options.start_s)
    player = Player(source, monotonic_ns, start_ns=start_ns, rate=options.rate, loop=options.loop)
    with serving(name, options.host, options.port, span_ns, source.channels, player) as (audience, port):
        if not quiet:
            with optional_output():
                for line in _invitation(options.host, port, layout):
                    print_line(line)
        yield player, audience


def _invitation(host: str, port: int, layout: str) -> tuple[str, ...]:
    address = f"[{host}]" if ":" in host else host
    return (
        f"serving ws://{address}:{port} (Ctrl-C ends)",
        "Foxglove: Open connection > Foxglove WebSocket > this address; playback starts when a panel is open",
        f"layout, for Layouts > Import from file: roadperc-view {layout}",
    )
