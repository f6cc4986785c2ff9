"""Drives that were replayed in parts, with ``--continue``: each is one run, whose frames stand in several tables."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from .quantities import listed
from .runs import Run, find_runs

_PARTS_NAMED: Final = 12


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
    before = {name: parts[0] for name, parts in found.items() if len(parts) == 1}
    apart = {name: why for name in before if (why := _why_apart(name, before, runs))}
    after = {before[run.name].name: run for run in runs if run.name in before and run.name not in apart}
    chains = _chains(runs, after)
    notes = [
        *(_one_drive(chain) for chain in chains if len(chain) > 1),
        *(
            f"{run.name}: goes on from a part that is not among these tables (log {run.continues}): "
            f"evaluated by itself, from frame {run.first_frame} on"
            for run in runs
            if found.get(run.name) == [] and run.first_frame
        ),
        *(
            f"{name}: goes on from a part of which there are {len(parts)} results "
            f"({listed([run.name for run in parts])}): evaluated by itself"
            for name, parts in found.items()
            if len(parts) > 1
        ),
        *(f"{name}: {why}: evaluated by itself" for name, why in apart.items()),
    ]
    return Drives(tuple(map(_joined, chains)), tuple(notes))


def _parts_before(run: Run, runs: Iterable[Run]) -> list[Run]:
    """The results that a part may go on from: several only where neither version nor folder tells them apart."""
    same = (run.continues, run.config_digest)
    others = [other for other in runs if other is not run and (other.log_id, other.config_digest) == same]
    same_version = [other for other in others if other.version == run.version] or others
    return [other for other in same_version if other.path.parent == run.path.parent] or same_version


def _why_apart(name: str, before: Mapping[str, Run], runs: Iterable[Run]) -> str:
    """Why a part is not joined to the one it goes on from; empty where it is."""
    earlier = before[name]
    behind = [run for run in runs if before.get(run.name) is earlier]
    if len(behind) > 1:
        return f"{listed([run.name for run in behind])} go on from {earlier.name} alike"
    return f"goes on from {earlier.name}, which another version made" if behind[0].version != earlier.version else ""


def _chains(runs: Sequence[Run], after: Mapping[str, Run]) -> list[list[Run]]:
    """The parts of each drive in order, in the order in which the first of any is named; a circle is no drive."""
    later = {run.name for run in after.values()}
    chains = [[run] for run in runs if run.name not in later]
    for chain in chains:
        while chain[-1].name in after:
            chain.append(after[chain[-1].name])
    reached = {run.name for chain in chains for run in chain}
    chains += [[run] for run in runs if run.name not in reached]
    place = {run.name: at for at, run in enumerate(runs)}
    return sorted(chains, key=lambda chain: min(place[run.name] for run in chain))


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
