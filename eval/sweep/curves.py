"""Curves of a sweep over corruptions: each metric by severity, as one SVG file that every browser shows."""

from collections.abc import Iterator, Sequence
from typing import Final

from ..html.figures import colour_of, escaped
from ..report_columns import rounded
from .ranking import SettingScore
from .robustness import Scored, names_of, of_corruption
from .settings import Combination

_ACROSS: Final = 3
_WIDTH, _HEIGHT = 300, 190
"""Pixels of a panel."""
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 12, 30, 22
"""Pixels around the curves of a panel."""
_LEGEND: Final = 24
_WORST: Final = 5


def curves(found: Sequence[Scored], made: Sequence[Combination]) -> str:
    """SVG of a panel per metric, with a curve per corruption. A severity without a value has no point."""
    names = names_of(made)
    rows = -(-len(found) // _ACROSS)
    legend_rows = -(-len(names) // _ACROSS)
    size = _ACROSS * _WIDTH, rows * _HEIGHT + legend_rows * _LEGEND
    parts = [part for at, scored in enumerate(found) for part in _panel(at, scored, made)]
    for at, name in enumerate(names):
        x, y = at % _ACROSS * _WIDTH + _LEFT, rows * _HEIGHT + at // _ACROSS * _LEGEND + 12
        parts.append(f'<path d="M{x} {y}h24" stroke="{colour_of(at)}" stroke-width="3"/>{_text(x + 30, y + 4, name)}')
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size[0]} {size[1]}" font-family="sans-serif"'
    return "\n".join((f'{head} font-size="12"><rect width="100%" height="100%" fill="white"/>', *parts, "</svg>\n"))


def _panel(at: int, scored: Scored, made: Sequence[Combination]) -> Iterator[str]:
    """Title, axes and curves of a metric; the vertical axis begins at 0."""
    (metric, scores), (row, column) = scored, divmod(at, _ACROSS)
    left, top, bottom = column * _WIDTH + _LEFT, row * _HEIGHT + _TOP, (row + 1) * _HEIGHT - _BOTTOM
    most = max((score.value or 0.0 for score in scores), default=0.0) or 1.0
    yield _text(left, top - 12, metric.quantity.label)
    yield f'<path d="M{left} {top}V{bottom}H{(column + 1) * _WIDTH - _RIGHT}" fill="none" stroke="grey"/>'
    yield _text(left - 4, top + 8, rounded(most, metric.quantity), "end") + _text(left - 4, bottom, "0", "end")
    step = (_WIDTH - _LEFT - _RIGHT) / _WORST
    for severity in range(_WORST + 1):
        yield _text(left + severity * step, bottom + 14, str(severity) if severity else "clean", "middle")
    for place, name in enumerate(names_of(made)):
        own: list[tuple[SettingScore, Combination]] = of_corruption(list(zip(scores, made, strict=True)), made, name)
        points = [
            f"{left + int(item.settings['severity']) * step:.0f},{bottom - (bottom - top) * score.value / most:.1f}"
            for score, item in own
            if score.value is not None
        ]
        yield f'<polyline points="{" ".join(points)}" fill="none" stroke="{colour_of(place)}" stroke-width="2"/>'


def _text(x: float, y: float, text: str, anchor: str = "start") -> str:
    return f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}">{escaped(text)}</text>'
