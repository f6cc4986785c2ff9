"""The comparison of new runs with base runs: a verdict on every metric, and the agreement of every field."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from ..configurations import change
from ..options import APART_NS, WORST_FRAMES, Rules
from ..runs import Run
from .fields import NOT_COMPARED, Agreement, Overlap, added, compare_tables
from .metrics import FRAMES, METRICS
from .pairing import Pairing
from .verdicts import Mark, Place, Verdict, verdicts


@dataclass(frozen=True)
class CauseGroup:
    """Verdicts with one mark that restate one cause, the one with the largest effect first."""

    name: str
    verdicts: tuple[Verdict, ...]


@dataclass(frozen=True)
class Comparison:
    """The comparison of two sets of runs.

    ``columns`` and ``messages`` are the agreements of the tables' columns and of the messages; ``messages`` is empty if
    the arguments are not logs. ``overlaps`` and ``changes`` (lines on the settings that differ) belong to
    ``pairing.pairs``.
    """

    pairing: Pairing
    overlaps: tuple[Overlap, ...]
    changes: tuple[tuple[str, ...], ...]
    columns: Mapping[str, Agreement]
    messages: Mapping[str, Agreement]
    verdicts: tuple[Verdict, ...]

    @property
    def frames(self) -> int:
        """Number of compared frames."""
        return sum(found.common for found in self.overlaps)

    @property
    def fields(self) -> dict[str, Agreement]:
        """All compared fields, columns first."""
        return {**self.columns, **self.messages}

    def named(self, mark: Mark) -> list[Verdict]:
        """The judged metrics with this mark."""
        return [verdict for verdict in self.verdicts if verdict.judged and verdict.mark == mark]

    def groups(self, mark: Mark) -> list[CauseGroup]:
        """The judged metrics with this mark, by cause; the largest effect first, among the groups and in each."""
        by_name: dict[str, list[Verdict]] = {}
        for verdict in sorted(self.named(mark), key=lambda verdict: -verdict.weight):
            by_name.setdefault(verdict.metric.group, []).append(verdict)
        return [CauseGroup(name, tuple(found)) for name, found in by_name.items()]

    @property
    def worst_places(self) -> list[Place]:
        """The frames in which the new run is worse by most: the worst one of each cause, then the second ones.

        They are different moments, the one of the cause with the largest effect first.
        """
        by_cause = ([at for verdict in group.verdicts for at in verdict.places] for group in self.groups("worse"))
        found: list[Place] = []
        for place in (place for rank in zip_longest(*by_cause) for place in rank if place is not None):
            near = (abs(at.stamp_ns - place.stamp_ns) < APART_NS for at in found if at.pair is place.pair)
            found += [] if any(near) else [place]
        return found[:WORST_FRAMES]

    @property
    def regressions(self) -> list[str]:
        """Metrics that became worse than allowed, and runs that the new run lacks."""
        missing = [f"no run of {run.name}" for run in self.pairing.missing]
        return [*(verdict.metric.name for verdict in self.named("worse")), *missing]

    @property
    def differences(self) -> list[str]:
        """Fields that differ beyond their tolerance, and runs or frames that only one side has."""
        apart = any(found.only_base or found.only_new for found in self.overlaps)
        alone: list[Run] = [*self.pairing.missing, *self.pairing.added]
        return [
            *(name for name, agreement in self.fields.items() if agreement.state == "differs"),
            *(["frames that only one run has"] if apart else []),
            *(f"the run {run.name}, which only one side has" for run in alone),
        ]


def compare_runs(pairing: Pairing, logs: tuple[Path, Path] | None, rules: Rules) -> Comparison:
    """Compare all pairs: their tables, and the messages of two ``logs``.

    Raises:
        RoadpercError: a file cannot be read, a pair shares no stamp, or a rule matches no name.
    """
    if logs is None:  # fields of messages have names only where they differ, so rules cannot be checked with logs
        columns = set[str]().union(*(pair.columns for pair in pairing.pairs)).difference(NOT_COMPARED)
        rules.require_use({*columns, *(metric.name for metric in METRICS), FRAMES.name})
    overlaps, agreements = zip(*(compare_tables(pair, rules) for pair in pairing.pairs), strict=True)
    messages: Mapping[str, Agreement] = {}
    if logs:
        from .messages import message_agreements

        messages = message_agreements(*logs, pairing.pairs[0].name, rules)
    changes = tuple(change(pair.base, pair.new) for pair in pairing.pairs)
    return Comparison(pairing, overlaps, changes, added(agreements), messages, verdicts(pairing.pairs, overlaps, rules))
