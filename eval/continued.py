"""Joins continued replays (``--continue``): the tables of one log that was replayed in several files are one run."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import pyarrow.parquet as pq

from .report_columns import listed
from .runs import Run, find_runs

_LISTED: Final = 12
_Link = tuple[Run, Run]
"""A run, and the run that it continues."""


@dataclass(frozen=True)
class JoinedRuns:
    """Runs, with continued replays joined, and notes on the joined runs, one line each."""

    runs: tuple[Run, ...]
    notes: tuple[str, ...]


def find_joined(arguments: Sequence[str]) -> JoinedRuns:
    """The runs that the arguments name, with continued replays joined at the position of their first replay.

    Replays of different versions, and several replays that continue the same one, are not joined.

    Raises:
        TableError: an argument names no table, a file is not a metrics table, or its data cannot be read.
    """
    runs = find_runs(arguments)
    found = {run.name: _continued_by(run, runs) for run in runs if run.continues}
    links = [(run, found[run.name][0]) for run in runs if len(found.get(run.name, ())) == 1]
    chains = _chains(runs, [(run, to) for run, to in links if not _why_apart(run, [to], links)])
    notes = [_note(chain) for chain in chains if len(chain) > 1]
    apart = ((run, _why_apart(run, found[run.name], links)) for run in runs if run.name in found)
    notes += [f"{run.name}: {why}; evaluated separately" for run, why in apart if why]
    return JoinedRuns(tuple(map(_joined, chains)), tuple(notes))


def _continued_by(run: Run, runs: Iterable[Run]) -> list[Run]:
    """The runs that a run may continue; several only if neither version nor folder distinguishes them."""
    same = (run.continues, run.config_digest)
    others = [other for other in runs if other is not run and (other.log_id, other.config_digest) == same]
    same_version = [other for other in others if other.version == run.version] or others
    return [other for other in same_version if other.path.parent == run.path.parent] or same_version


def _why_apart(run: Run, candidates: Sequence[Run], links: Sequence[_Link]) -> str:
    """Reason why a run is not joined to the run it continues; empty if it is joined or starts at frame 0."""
    if not candidates:
        missing = f"continues a replay that is not among these tables (log {run.continues}) at frame {run.first_frame}"
        return missing if run.first_frame else ""
    if len(candidates) > 1:
        return f"may continue any of {len(candidates)} results ({listed([other.name for other in candidates])})"
    (before,) = candidates
    following = [after.name for after, to in links if to is before]
    if len(following) > 1:
        return f"{listed(following)} all continue {before.name}"
    if run.version != before.version:
        return f"continues {before.name}, which is of another version"
    same = pq.read_schema(run.path).equals(pq.read_schema(before.path))
    return "" if same else f"continues {before.name}, whose table has other columns"


def _chains(runs: Sequence[Run], links: Sequence[_Link]) -> list[list[Run]]:
    """The runs to join, in order; sorted by the first argument of each chain. Circular links are not joined."""
    after = {before.name: run for run, before in links}
    later = {run.name for run, _ in links}
    chains = [list(_chain(run, after)) for run in runs if run.name not in later]
    reached = {run.name for chain in chains for run in chain}
    chains += [[run] for run in runs if run.name not in reached]
    place = {run.name: at for at, run in enumerate(runs)}
    return sorted(chains, key=lambda chain: min(place[run.name] for run in chain))


def _chain(run: Run | None, after: Mapping[str, Run]) -> Iterator[Run]:
    while run is not None:
        yield run
        run = after.get(run.name)


def _joined(chain: Sequence[Run]) -> Run:
    first = chain[0]
    if len(chain) == 1:
        return first
    return replace(
        first,
        name=f"{first.name}+{len(chain) - 1}",
        frames=sum(run.frames for run in chain),
        rows=sum(run.rows for run in chain),
        end_frame=None,
        next_run="",
        findings=tuple({finding.code: finding for run in reversed(chain) for finding in run.findings or ()}.values()),
        joined=tuple(chain),
    )


def _note(chain: Sequence[Run]) -> str:
    names = [run.name if run.frames else f"{run.name} ({run.repeated_by})" for run in chain]
    return f"{_joined(chain).name}: {len(chain)} continued replays as one run: {listed(names, _LISTED)}"
