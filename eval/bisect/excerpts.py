"""Replays excerpts of a log alone and judges them; keeps the verdicts, so that an interrupted search can continue."""

import hashlib
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, Final

from roadperc_stream import __version__, log
from roadperc_stream.config import ReplayConfig, load_config
from roadperc_stream.errors import NoFrameError, TableError
from roadperc_stream.input import ReplaySource
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.schemas.topics import METRICS_TOPIC, STAGES, switched_off
from roadperc_stream.system.files import write_whole
from roadperc_stream.system.time import NS_PER_S, TimeRange, ns_to_seconds

from ..check.judging import Result, judge
from ..criteria import read_criteria
from ..replaying import replay_with
from ..runs import open_run

Window = tuple[int, int]
"""A part of a log by log time in nanoseconds: the start, and the end, which is not included."""
Show = Callable[[str, int, int], None]
"""Takes the activity, the frames done and the frames expected."""
_SUFFIX: Final = ".replays.json"
"""Of the file beside the output with the verdicts."""


@dataclass(frozen=True)
class ReplayVerdict:
    """What a replay shows: the title of the failing criterion, empty without one, and the worst frame's log time.

    ``text`` has value and bound, or the reason why nothing fails. ``frame_ns`` is the median time between frames, and
    the frames before the worst one and from it on are counted in this unit.
    """

    failed: str = ""
    text: str = ""
    worst_ns: int = 0
    frame_ns: int = 0
    frames_before: int = 0
    frames_after: int = 0


class ExcerptReplays:
    """Replays of one log and its excerpts, with ``criteria`` of the file ``path`` that judge them.

    ``count`` is the number of replays, including those before an interruption. Each failing excerpt replaces the last
    one, because the next excerpts are parts of it.
    """

    def __init__(self, source: ReplaySource, path: Path, out: Path, folder: Path, show: Show) -> None:
        """Read the criteria, and the verdicts of an interrupted search.

        ``out`` is the excerpt to write, ``folder`` is for temporary files, and ``show`` shows the progress.

        Raises:
            ConfigError: the criteria cannot be read.
            TableError: the file with the verdicts cannot be read.
        """
        self.criteria, self.count = read_criteria(path), 0
        self.input_log, self.kept_verdicts = source.files[0], out.with_suffix(_SUFFIX)
        self._source, self._path, self._out, self._folder, self._show = source, path, out, folder, show
        self._failing: tuple[Path, Window] | None = None
        self._known: dict[str, dict[str, Any]] = {}
        try:
            if self.kept_verdicts.exists():
                self._known = json.loads(self.kept_verdicts.read_text())
        except ValueError as error:
            raise TableError(f"{self.kept_verdicts}: is not JSON ({error}); remove it to start over") from error

    def verdict(self, cfg: ReplayConfig, window: Window | None) -> ReplayVerdict:
        """Replay an excerpt alone, or the whole log for None, and judge it.

        Raises:
            RoadpercError: it cannot be replayed, or a criterion does not fit.
        """
        self.count += 1
        facts = __version__, self._log_digest, self._source.overrides, self.criteria, cfg.to_toml(), window
        key = hashlib.sha256(repr(facts).encode()).hexdigest()
        if key not in self._known:
            self._known[key] = asdict(self._replayed(cfg, window))
            write_whole(self.kept_verdicts, json.dumps(self._known))
        return ReplayVerdict(**self._known[key])

    def write(self, cfg: ReplayConfig, window: Window) -> Result | None:
        """Write the output: the excerpt, replayed alone. Remove the file with the verdicts.

        Returns:
            The result of the failing criterion; None if none fails.

        Raises:
            RoadpercError: it cannot be replayed or written.
        """
        self.count += 1
        failed, _ = self._judged(self._excerpt(cfg, window), ReplayTarget(self._out, force=True), cfg)
        self.forget()
        return failed

    def forget(self) -> None:
        """Remove the file with the verdicts."""
        self.kept_verdicts.unlink(missing_ok=True)

    @cached_property
    def _log_digest(self) -> str:
        with self.input_log.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()

    def _replayed(self, cfg: ReplayConfig, window: Window | None) -> ReplayVerdict:
        target = ReplayTarget(self._folder / "replay.mcap", results_only=True, force=True)
        try:
            path = self.input_log if window is None else self._excerpt(cfg, window)
            failed, text = self._judged(path, target, cfg)
        except NoFrameError as error:
            return ReplayVerdict(text=str(error))
        if failed is None:
            return ReplayVerdict(text=text)
        if window is not None:
            self._failing = path.replace(self._folder / "excerpt.mcap"), window
        return _verdict(failed, target)

    def _excerpt(self, cfg: ReplayConfig, window: Window) -> Path:
        """A log with the window's messages: a replay without stages copies them, with the latched ones before it."""
        if self._failing is not None and self._failing[1] == window:
            return self._failing[0]
        whole = replace(self._source, paths=self._failing[0]) if self._failing else self._source
        start_s, end_s = (ns_to_seconds(time_ns - first_ns(whole)) for time_ns in window)
        target = ReplayTarget(self._folder / "cut.mcap", force=True)
        idle = load_config(None, [switched_off(stage) for stage in STAGES])
        reading = {"sync": cfg.sync, "limits": cfg.limits, "tag_table": cfg.tag_table}
        part = replace(whole, time_range=TimeRange(start_s, end_s))
        replay_with(part, target, idle.model_copy(update=reading), threads=1)
        return target.path

    def _judged(self, path: Path, target: ReplayTarget, cfg: ReplayConfig) -> tuple[Result | None, str]:
        """Replay a log; the first criterion that fails, and its text or the reason why none fails."""
        replay_with(
            replace(self._source, paths=path), target, cfg, progress=partial(self._show, f"replay {self.count}")
        )
        results = judge(self.criteria, [open_run(target.metrics, self.input_log.name)], self._path)
        failed = next((result for result in results if result.outcome == "failed"), None)
        if failed is not None:
            return failed, failed.text
        if len(results) == 1:
            return None, f"{results[0].criterion.title} is {results[0].outcome}: {results[0].text}"
        found = Counter(result.outcome for result in results)
        return None, ", ".join(f"{count} {outcome}" for outcome, count in found.items())


def first_ns(source: ReplaySource) -> int:
    """Log time of the first message of a log."""
    return log.summarise(log.received(source.files)).first_ns or 0


def _verdict(failed: Result, target: ReplayTarget) -> ReplayVerdict:
    """The failing criterion, and the place of its worst frame among the frames of the result log."""
    messages = log.read(log.summarise(target.path), topics=(METRICS_TOPIC,))
    by_frame = {message.sequence: message.log_time_ns for message in messages}
    times_ns = list(by_frame.values())
    steps_ns = [later - earlier for earlier, later in pairwise(times_ns) if later > earlier]
    frame_ns = round(median(steps_ns or [NS_PER_S]))
    worst_ns = by_frame[failed.worst.frame] if failed.worst else times_ns[0]
    before, after = round((worst_ns - times_ns[0]) / frame_ns), round((times_ns[-1] - worst_ns) / frame_ns) + 1
    return ReplayVerdict(failed.criterion.title, failed.text, worst_ns, frame_ns, before, after)
