"""Joins continued replays (``--continue``): the tables of one log that was replayed in several files are one run."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from roadperc_stream.system.text import listed

from .runs import Run, find_runs

_LISTED: Final = 12


@dataclass(frozen=True)
class JoinedRuns:
    """Runs, with continued replays joined, and notes on the joined runs, one line each."""

    runs: tuple[Run, ...]
    notes: tuple[str, ...]


def find_joined(arguments: Sequence[str]) -> JoinedRuns:
    """The runs that the arguments name, with continued replays joined at the position of their first replay.

    A replay stays separate if several replays continue the same one, or if the one that it continues is ambiguous or
    missing; that has the same configuration, version and columns.

    Raises:
        TableError: an argument names no table, a file is not a metrics table, or its data cannot be read.
    """
    runs = find_runs(arguments)
    earlier = [(run, _continued_by(run, runs)) for run in runs if run.continues]
    followers = Counter(found[0].name for _, found in earlier if len(found) == 1)
    after = {found[0].name: run for run, found in earlier if len(found) == 1 and followers[found[0].name] == 1}
    later = {run.name for run in after.values()}
    chains = [list(_chain(run, after)) for run in runs if run.name not in later]
    notes = [_note(chain) for chain in chains if len(chain) > 1]
    apart = [(run, found) for run, found in earlier if run.name not in later and (found or run.first_frame)]
    notes += [f"{run.name}: {_why_apart(run, found)}; evaluated separately" for run, found in apart]
    return JoinedRuns(tuple(map(_joined, chains)), tuple(notes))


def _continued_by(run: Run, runs: Sequence[Run]) -> list[Run]:
    """The runs that a run may continue, those of its folder if there are any."""
    same = (run.continues, run.config_digest, run.version, run.columns)
    found = [
        other
        for other in runs
        if other is not run and (other.log_id, other.config_digest, other.version, other.columns) == same
    ]
    return [other for other in found if other.path.parent == run.path.parent] or found


def _why_apart(run: Run, candidates: Sequence[Run]) -> str:
    if not candidates:
        missing = f"log {run.continues}, same configuration, version and columns"
        return f"continues a replay that is not among these tables ({missing}) at frame {run.first_frame}"
    if len(candidates) > 1:
        return f"may continue any of {len(candidates)} results ({listed([other.name for other in candidates])})"
    return f"is not the only replay that continues {candidates[0].name}"


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
