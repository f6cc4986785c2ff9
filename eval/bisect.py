"""Finds the shortest excerpt of a log, and the fewest changed settings, for which a criterion still fails."""

import argparse
import math
import shlex
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig, load_config, validated
from roadperc_stream.config.catalogue import catalogue
from roadperc_stream.config.settings import as_typed
from roadperc_stream.errors import ConfigError, LogError, RegressionError, RoadpercError
from roadperc_stream.input import ReplaySource
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.terminal import job_progress
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.system.files import not_a_log
from roadperc_stream.system.text import number, print_line
from roadperc_stream.system.time import NS_PER_S, ns_to_seconds

from .bisect_replays import ExcerptReplays, Show, Verdict, Window
from .criteria import Criterion, hint, read_criteria
from .delta_debugging import ddmin
from .judging import Result
from .sweeping.settings import setting_of

_FIRST_REACH_S: Final = 1.0
"""The first excerpt begins this long before the worst frame of the whole log."""
_GROWTH: Final = 4
"""Factor between the lengths of the first excerpts; the part after the worst frame is shorter by this factor."""


def bisect(arguments: argparse.Namespace) -> None:
    """Search, write the excerpt, and print the commands that show the failure.

    Raises:
        RegressionError: no criterion fails on the whole log.
        RoadpercError: the log cannot be replayed, an option is invalid, or the excerpt cannot be written.
        KeyboardInterrupt: a signal stopped the search.
    """
    source = ReplaySource(arguments.log, parse_topic_options(arguments.topic))
    out: Path = arguments.out or Path(arguments.log.with_suffix(".bisect.mcap").name)
    if not arguments.log.is_file():
        raise LogError(not_a_log(arguments.log) if arguments.log.is_dir() else f"{arguments.log}: no such file")
    ReplayTarget(out, force=arguments.force).require_writable(source.files, None, resume=False)
    ReplayTarget(out, force=arguments.force).require_free(source.files)
    base, cfg = load_config(arguments.base), load_config(arguments.config, arguments.set)
    criteria = _chosen(read_criteria(arguments.criteria), arguments)
    with TemporaryDirectory(prefix=".roadperc-bisect-", dir=out.parent) as folder, job_progress() as show:
        replays = ExcerptReplays(source, arguments.criteria, criteria, out, Path(folder))
        try:
            lines = list(_searched(replays, base, cfg, arguments, out, show))
        except KeyboardInterrupt:
            if replays.can_continue:
                raise KeyboardInterrupt("interrupted; run the same command again to continue") from None
            raise
    for line in lines:
        print_line(line)


def _chosen(criteria: Sequence[Criterion], arguments: argparse.Namespace) -> Sequence[Criterion]:
    """The criterion of ``--criterion``, else all.

    Raises:
        ConfigError: the file has no such criterion.
    """
    name: str | None = arguments.criterion
    titles = [criterion.title for criterion in criteria]
    if name is not None and name not in titles:
        raise ConfigError(f"{arguments.criteria}: no criterion {name!r}; {hint(name, titles)}")
    return [criterion for criterion in criteria if name in (None, criterion.title)]


def _searched(
    replays: ExcerptReplays, base: ReplayConfig, cfg: ReplayConfig, arguments: argparse.Namespace, out: Path, show: Show
) -> Iterator[str]:
    """Search over time, then over the settings; yields the lines to print."""
    whole = replays.verdict(cfg, None, show)
    if not whole.failed:
        replays.forget()
        raise RegressionError(f"{arguments.log}: nothing fails on the whole log: {whole.text}")
    yield f"whole log  {whole.failed}: {whole.text}"
    replays.criteria = tuple(item for item in replays.criteria if item.title == whole.failed)
    changed = changed_settings(base, cfg)
    window = _shortest(replays, cfg, whole, len(changed), show)
    needed = _needed(replays, base, cfg, changed, window, show)
    found = replays.write(with_settings(base, cfg, needed), window, show)
    if found is None or found.worst is None:
        raise RoadpercError(f"{out}: {whole.failed} does not fail again; does it depend on times?")
    yield from _lines(found, window, arguments, out)
    values = [f"{key}={as_typed(setting_of(cfg, key))}" for key in needed]
    if changed:
        needs = f"{len(needed)} of {number(len(changed), 'change')} needed"
        yield f"settings   {': '.join(filter(None, (needs, ' '.join(values))))}"
    yield f"replays    {replays.count}"
    yield f"show       {found.worst.command}"
    options = [*(("--config", str(arguments.base)) if arguments.base else ()), *(f"--set={value}" for value in values)]
    options += [f"--topic={topic}" for topic in arguments.topic]
    yield f"replay     {shlex.join(['roadperc-replay', str(out), 'again.mcap', *options])}"
    yield f"judge      {shlex.join(['roadperc-check', 'again.mcap', '--criteria', str(arguments.criteria)])}"


def _lines(found: Result, window: Window, arguments: argparse.Namespace, out: Path) -> Iterator[str]:
    start_s = ns_to_seconds(window[0] - (log.summarise(arguments.log).first_ns or 0))
    length_s = ns_to_seconds(window[1] - window[0])
    frames = number(found.frames, "frame")
    yield f"excerpt    {out}: {length_s:.3g} s from {max(start_s, 0):.3f} s, {frames}: {found.text}"


def _shortest(replays: ExcerptReplays, cfg: ReplayConfig, whole: Verdict, settings: int, show: Show) -> Window:
    """The shortest excerpt that fails.

    The first excerpts are around the worst frame of the whole log, and grow until one fails. Delta debugging shortens
    it. Its items are the times of frames, with the worst frame as 0.
    """
    frames = range(-whole.frames_before, whole.frames_after)

    def fails(part: Sequence[int]) -> bool:
        return bool(replays.verdict(cfg, _window(whole, part), show).failed)

    def steps(items: int) -> int:
        return 2 * math.ceil(math.log2(items + 1))

    passed: list[range] = []
    for power in count():
        reach = math.ceil(_FIRST_REACH_S * _GROWTH**power * NS_PER_S / whole.frame_ns)
        part = range(max(frames.start, -reach), min(frames.stop, 1 + reach // _GROWTH))
        replays.left = steps(len(part)) + steps(settings) + 2
        if part == frames or fails(part):
            break
        passed.append(part)
    return _window(whole, ddmin(part, fails, passed, span=True))


def _window(whole: Verdict, part: Sequence[int]) -> Window:
    """Log times of an excerpt; its limits are in the middle between two frames."""
    start_ns, end_ns = (whole.frame_ns * (2 * place + side) // 2 for place, side in ((part[0], -1), (part[-1], 1)))
    return whole.worst_ns + start_ns, whole.worst_ns + end_ns


def _needed(
    replays: ExcerptReplays,
    base: ReplayConfig,
    cfg: ReplayConfig,
    changed: Sequence[str],
    window: Window,
    show: Show,
) -> Sequence[str]:
    """The fewest changed settings with which the excerpt fails. A combination that is not valid counts as passed."""

    def fails(keys: Sequence[str]) -> bool:
        try:
            part = with_settings(base, cfg, keys)
        except ConfigError:
            return False
        return bool(replays.verdict(part, window, show).failed)

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
    tree = base.model_dump(mode="json")
    for key in keys:
        section, _, name = key.rpartition(".")
        (tree[section] if section else tree)[name] = setting_of(cfg, key)
    return validated(tree, "")
