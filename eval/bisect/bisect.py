"""Finds the shortest excerpt of a log, and the fewest changed settings, for which a criterion still fails."""

import math
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Final

from roadperc_stream.config import ReplayConfig, load_config, validated
from roadperc_stream.config.catalogue import catalogue
from roadperc_stream.config.settings import as_typed
from roadperc_stream.errors import ConfigError, RegressionError, RoadpercError
from roadperc_stream.input import ReplaySource
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.terminal import job_progress
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.system.files import scratch_folder
from roadperc_stream.system.text import number, print_line
from roadperc_stream.system.time import NS_PER_S, ns_to_seconds

from ..configurations import setting_of
from ..criteria import Criterion, hint
from ..replaying import require_log
from ..runs import open_run
from .delta_debugging import ddmin
from .excerpts import ExcerptReplays, ReplayVerdict, Window, first_ns

_FIRST_REACH_S: Final = 1.0
"""The first excerpt begins this long before the worst frame of the whole log."""
_GROWTH: Final = 4
"""Factor between the lengths of the first excerpts; the part after the worst frame is shorter by this factor."""


@dataclass(frozen=True)
class BisectOptions:
    """What to search: the log, the criteria, the settings that fail, and those that work.

    ``criterion`` is the title of one; None for the first that fails. ``config`` is a file of settings and ``changed``
    more of them as KEY=VALUE. ``base`` is the file of those that work, None for the defaults. ``topics`` are
    ROLE=/TOPIC.
    """

    log: Path
    criteria: Path
    out: Path
    criterion: str | None = None
    config: Path | None = None
    changed: Sequence[str] = ()
    base: Path | None = None
    topics: Sequence[str] = ()
    force: bool = False


def bisect(options: BisectOptions) -> None:
    """Search, write the excerpt, and print the commands that show the failure.

    Raises:
        RegressionError: no criterion fails on the whole log.
        RoadpercError: the log cannot be replayed, an option is invalid, or the excerpt cannot be written.
        KeyboardInterrupt: a signal stopped the search.
    """
    source = ReplaySource(options.log, parse_topic_options(options.topics))
    require_log(options.log)
    ReplayTarget(options.out, force=options.force).require_writable(source.files, None, resume=False)
    base, cfg = load_config(options.base), load_config(options.config, options.changed)
    with scratch_folder(options.out) as folder, job_progress() as show:
        replays = ExcerptReplays(source, options.criteria, options.out, folder, show)
        replays.criteria = _chosen(replays.criteria, options)
        try:
            lines = list(_search(replays, base, cfg, options))
        except KeyboardInterrupt:
            if replays.kept_verdicts.exists():
                raise KeyboardInterrupt("interrupted; run the same command again to continue") from None
            raise
    for line in lines:
        print_line(line)


def _chosen(criteria: tuple[Criterion, ...], options: BisectOptions) -> tuple[Criterion, ...]:
    """The chosen criterion, else all.

    Raises:
        ConfigError: the file has no such criterion.
    """
    name = options.criterion
    titles = [criterion.title for criterion in criteria]
    if name is not None and name not in titles:
        raise ConfigError(f"{options.criteria}: no criterion {name!r}; {hint(name, titles)}")
    return tuple(criterion for criterion in criteria if name in (None, criterion.title))


def _search(replays: ExcerptReplays, base: ReplayConfig, cfg: ReplayConfig, options: BisectOptions) -> Iterator[str]:
    """Search over time, then over the settings, and write the excerpt; yields what was found, and the commands."""
    whole = replays.verdict(cfg, None)
    if not whole.failed:
        replays.forget()
        raise RegressionError(f"{replays.input_log}: nothing fails on the whole log: {whole.text}")
    replays.criteria = tuple(item for item in replays.criteria if item.title == whole.failed)
    changed = changed_settings(base, cfg)
    window = shortest(replays, cfg, whole)
    needed = needed_settings(replays, base, cfg, changed, window)
    result = replays.write(with_settings(base, cfg, needed), window)
    if result is None or result.worst is None:
        raise RoadpercError(f"{replays.input_log}: {whole.failed} does not fail again; does it depend on times?")
    begin_ns = first_ns(ReplaySource(options.log))
    start_s, end_s = (ns_to_seconds(time_ns - begin_ns) for time_ns in window)
    frames = number(open_run(ReplayTarget(options.out).metrics, options.out.name).frames, "frame")
    values = [f"{key}={as_typed(setting_of(cfg, key))}" for key in needed]
    yield f"whole log  {whole.failed}: {whole.text}"
    yield f"excerpt    {options.out}: {start_s:.3f} to {end_s:.3f} s of the log, {frames}: {result.text}"
    if changed:
        needs = f"{len(needed)} of {number(len(changed), 'change')} needed"
        yield f"settings   {': '.join(filter(None, (needs, ' '.join(values))))}"
    yield f"replays    {replays.count}"
    yield f"show       {result.worst.command}"
    base_file = ["--config", str(options.base)] if options.base else []
    given = [*base_file, *(f"--set={value}" for value in values), *(f"--topic={topic}" for topic in options.topics)]
    yield f"replay     {shlex.join(['roadperc-replay', str(options.out), 'again.mcap', *given])}"
    yield f"judge      {shlex.join(['roadperc-check', 'again.mcap', '--criteria', str(options.criteria)])}"


def shortest(replays: ExcerptReplays, cfg: ReplayConfig, whole: ReplayVerdict) -> Window:
    """The shortest excerpt that fails.

    The first excerpts are around the worst frame of the whole log, and grow until one fails. Delta debugging shortens
    it. Its items are the times of frames, with the worst frame as 0.
    """
    frames = range(-whole.frames_before, whole.frames_after)

    def fails(part: Sequence[int]) -> bool:
        return bool(replays.verdict(cfg, _window(whole, part)).failed)

    passed: list[range] = []
    for power in count():
        reach = math.ceil(_FIRST_REACH_S * _GROWTH**power * NS_PER_S / whole.frame_ns)
        part = range(max(frames.start, -reach), min(frames.stop, 1 + reach // _GROWTH))
        if part == frames or fails(part):
            break
        passed.append(part)
    return _window(whole, ddmin(part, fails, passed, span=True))


def _window(whole: ReplayVerdict, part: Sequence[int]) -> Window:
    """Log times of an excerpt; its limits are in the middle between two frames."""
    start_ns, end_ns = (whole.frame_ns * (2 * place + side) // 2 for place, side in ((part[0], -1), (part[-1], 1)))
    return whole.worst_ns + start_ns, whole.worst_ns + end_ns


def needed_settings(
    replays: ExcerptReplays,
    base: ReplayConfig,
    cfg: ReplayConfig,
    changed: Sequence[str],
    window: Window,
) -> Sequence[str]:
    """The fewest changed settings with which the excerpt fails. A combination that is not valid counts as passed."""

    def fails(keys: Sequence[str]) -> bool:
        try:
            part = with_settings(base, cfg, keys)
        except ConfigError:
            return False
        return bool(replays.verdict(part, window).failed)

    return () if not changed or fails(()) else ddmin(changed, fails)


def changed_settings(base: ReplayConfig, cfg: ReplayConfig) -> tuple[str, ...]:
    """The keys of the settings that differ between two configurations, such as ``lanes.hold_s``."""
    keys = (setting.key for setting in catalogue())
    return tuple(key for key in keys if setting_of(base, key) != setting_of(cfg, key))


def with_settings(base: ReplayConfig, cfg: ReplayConfig, keys: Sequence[str]) -> ReplayConfig:
    """The configuration ``base`` with some settings of ``cfg``.

    Raises:
        ConfigError: the settings do not fit together.
    """
    tree = base.with_log_facts(cfg).model_dump(mode="json")
    for key in keys:
        section, _, name = key.rpartition(".")
        (tree[section] if section else tree)[name] = setting_of(cfg, key)
    return validated(tree, "")
