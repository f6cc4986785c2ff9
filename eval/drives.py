"""Drives that were replayed in parts, with ``--continue``: each is one run, whose frames stand in several tables."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import pyarrow.parquet as pq

from .quantities import listed
from .runs import Run, find_runs

_PARTS_NAMED: Final = 12
_Link = tuple[Run, Run]
"""A part, and the one it goes on from."""


@dataclass(frozen=True)
class Drives:
    """Runs, those of a drive's parts as one, and what there is to say of the parts, a line each."""

    runs: tuple[Run, ...]
    notes: tuple[str, ...]


def find_drives(arguments: Sequence[str]) -> Drives:
    """The runs the arguments mean; the parts of a drive are one run, at the place of the first of them.

    Parts of several versions, and those that several others go on from, stay by themselves.

    Raises:
        TableError: an argument names no table, a file is not a metrics table, or its data cannot be read.
    """
    runs = find_runs(arguments)
    found = {run.name: _parts_before(run, runs) for run in runs if run.continues}
    links = [(run, found[run.name][0]) for run in runs if len(found.get(run.name, ())) == 1]
    chains = _chains(runs, [link for link in links if not _apart(*link, links)])
    notes = [
        *(_one_drive(chain) for chain in chains if len(chain) > 1),
        *(_without_part(run) for run in runs if found.get(run.name) == [] and run.first_frame),
        *(_undecided(name, before) for name, before in found.items() if len(before) > 1),
        *(f"{run.name}: {why}: evaluated by itself" for run, to in links if (why := _apart(run, to, links))),
    ]
    return Drives(tuple(map(_joined, chains)), tuple(notes))


def _parts_before(run: Run, runs: Iterable[Run]) -> list[Run]:
    """The results that a part may go on from: several only where neither version nor folder tells them apart."""
    same = (run.continues, run.config_digest)
    others = [other for other in runs if other is not run and (other.log_id, other.config_digest) == same]
    same_version = [other for other in others if other.version == run.version] or others
    return [other for other in same_version if other.path.parent == run.path.parent] or same_version


def _apart(run: Run, before: Run, links: Sequence[_Link]) -> str:
    """Why a part is not joined to the one it goes on from; empty where it is."""
    behind = [after.name for after, to in links if to is before]
    if len(behind) > 1:
        return f"{listed(behind)} go on from {before.name} alike"
    if run.version != before.version:
        return f"goes on from {before.name}, which another version made"
    same = pq.read_schema(run.path).equals(pq.read_schema(before.path))
    return "" if same else f"goes on from {before.name}, whose table has other columns"


def _chains(runs: Sequence[Run], links: Sequence[_Link]) -> list[list[Run]]:
    """The parts of each drive in order, in the order in which the first of any is named; a circle is no drive."""
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
        frames=sum(part.frames for part in chain),
        rows=sum(part.rows for part in chain),
        end_frame=None,
        next_part="",
        parts=tuple(chain),
    )


def _one_drive(chain: Sequence[Run]) -> str:
    names = [
        part.name if part.frames else f"{part.name} (all its {part.rows} frames are given again by {part.next_part})"
        for part in chain
    ]
    return f"{_joined(chain).name}: one drive in {len(chain)} parts: {listed(names, _PARTS_NAMED)}"


def _without_part(run: Run) -> str:
    missing = f"{run.name}: goes on from a part that is not among these tables (log {run.continues})"
    return f"{missing}: evaluated by itself, from frame {run.first_frame} on"


def _undecided(name: str, before: Sequence[Run]) -> str:
    alike = listed([run.name for run in before])
    return f"{name}: goes on from a part of which there are {len(before)} results ({alike}): evaluated by itself"
