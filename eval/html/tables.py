"""The page's table of what the runs are."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from roadperc_stream.output.text_table import TextRow, TextTable

from ..configurations import UNKNOWN, short_digest
from ..grid import percent
from ..names import listed
from ..overview import in_segments
from ..summary import Summary
from .sources import Sources


def identity(summaries: Sequence[Summary], sources: Sequence[Sequence[Sources]]) -> TextTable:
    """What each run is: log, configuration, version, names and extent."""
    facts = [_facts(summary, files) for summary, files in zip(summaries, sources, strict=True)]
    rows = tuple(TextRow(label, tuple((fact[label],) for fact in facts)) for label in facts[0])
    return TextTable("What was replayed", ("",), rows, subjects=tuple(summary.name for summary in summaries))


def _facts(summary: Summary, files: Sequence[Sources]) -> dict[str, str]:
    rate = f", {summary.rate_hz:.1f} frames/s" if summary.rate_hz else ""
    missing = ", ".join(f"{role} {percent(n / summary.frames)} %" for role, n in summary.missing.most_common())
    return {
        "log": listed(summary.log_ids),
        "configuration": short_digest(summary.configs[0]),
        "version": summary.versions[0] or UNKNOWN,
        "input": _names(table.source for table in files),
        "output": _names(table.log for table in files),
        "frames": f"{summary.frames}{in_segments(summary)} over {summary.span_s:.2f} s{rate}",
        "longest gap": f"{summary.longest_gap_s:.2f} s",
        "messages missing": missing or "none in any frame",
    }


def _names(paths: Iterable[Path | None]) -> str:
    return listed([path.name if path else "not named" for path in paths])
