"""The whole comparison of a candidate with a reference."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..configurations import Change, change
from .agreement import Agreement, together
from .messages import message_agreements
from .metrics import FRAMES, METRICS
from .pairing import Pairing
from .rules import Rules
from .tables import NOT_COMPARED, Overlap, overlap, table_agreements
from .verdicts import Mark, Verdict, verdicts


@dataclass(frozen=True)
class Comparison:
    """What two sets of runs share and where they part.

    ``columns`` and ``messages`` say how fields of the tables and of the logs' results agree, the latter only where logs
    were named; ``overlaps`` and ``changes``, what differs between the two configurations, are those of
    ``pairing.pairs``.
    """

    pairing: Pairing
    overlaps: tuple[Overlap, ...]
    changes: tuple[Change | None, ...]
    columns: Mapping[str, Agreement]
    messages: Mapping[str, Agreement]
    verdicts: tuple[Verdict, ...]

    @property
    def frames(self) -> int:
        """Frames that were compared."""
        return sum(found.common for found in self.overlaps)

    @property
    def fields(self) -> dict[str, Agreement]:
        """All fields compared, the tables' first."""
        return {**self.columns, **self.messages}

    def named(self, mark: Mark) -> list[Verdict]:
        """The judged metrics with this mark."""
        return [verdict for verdict in self.verdicts if verdict.judged and verdict.mark == mark]

    @property
    def regressions(self) -> list[str]:
        """Names of what became worse than allowed: metrics, and runs that the candidate lacks."""
        return [
            *(verdict.metric.name for verdict in self.named("worse")),
            *(f"no run of {item.relative}" for item in self.pairing.missing),
        ]

    @property
    def differences(self) -> list[str]:
        """Names of the fields that differ beyond their tolerance, and of what only one side has."""
        apart = any(found.only_reference or found.only_candidate for found in self.overlaps)
        alone = [*self.pairing.missing, *self.pairing.added]
        return [
            *(name for name, agreement in self.fields.items() if agreement.state == "differs"),
            *(["frames of one run alone"] if apart else []),
            *(f"the run {item.relative} of one side alone" for item in alone),
        ]


def compare_runs(pairing: Pairing, logs: tuple[Path, Path] | None, rules: Rules) -> Comparison:
    """Compare all pairs, one pair of files after another.

    Args:
        pairing: which runs belong together.
        logs: the two logs whose results are compared as well as their tables, if logs were named.
        rules: what is ignored, tolerated and allowed.

    Raises:
        RoadpercError: a file cannot be read, a pair shares no stamp, or a rule names nothing there is.
    """
    if logs is None:  # the fields of messages are known where they differ, no sooner
        rules.require_use({*_columns(pairing), *(metric.name for metric in METRICS), FRAMES.name})
    overlaps = tuple(overlap(pair) for pair in pairing.pairs)
    return Comparison(
        pairing,
        overlaps,
        tuple(change(pair.reference.run, pair.candidate.run) for pair in pairing.pairs),
        together(table_agreements(pair, rules) for pair in pairing.pairs),
        message_agreements(*logs, pairing.pairs[0].name, rules) if logs else {},
        verdicts(pairing.pairs, overlaps, rules),
    )


def _columns(pairing: Pairing) -> set[str]:
    sides = [side for pair in pairing.pairs for side in (pair.reference, pair.candidate)]
    return set().union(*(side.run.columns for side in sides)) - {*NOT_COMPARED}
