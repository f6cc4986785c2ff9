"""The look of a report's tables: labels on the left, whole numbers of digits on the right, no lines but one."""

from typing import Final

from rich.box import Box
from rich.table import Table

from .quantities import Quantity

_RULE_BELOW_HEADER: Final = Box("\n".join(["    ", "    ", " ── ", "    ", "    ", "    ", "    ", "    "]))


def grid(title: str, *headers: str, text: str = "", label_columns: int = 26) -> Table:
    """A table without lines: labels, columns of numbers, and maybe a column of text.

    Where it gets narrow, labels and text fold; numbers neither wrap nor shorten.
    """
    table = Table(box=_RULE_BELOW_HEADER, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0), header_style="bold")
    # One column at most may fold: of two, rich narrows both alike, below what the labels must have.
    table.add_column(title, min_width=label_columns, no_wrap=bool(text), overflow="fold", header_style="bold cyan")
    for header in headers:
        table.add_column(header, justify="right", no_wrap=True, min_width=len(header))
    if text:
        table.add_column(text, overflow="fold")
    return table


def rounded(value: float, quantity: Quantity) -> str:
    """A value with the quantity's digits and never a negative zero."""
    return f"{value:z.{quantity.decimals}f}"


def percent(share: float) -> str:
    """A share from 0 to 1 in percent."""
    return f"{100 * share:.1f}"
