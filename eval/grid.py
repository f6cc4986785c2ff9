"""How a report writes its numbers."""

from .quantities import Quantity


def rounded(value: float, quantity: Quantity) -> str:
    """A value with the quantity's digits and never a negative zero."""
    return f"{value:z.{quantity.decimals}f}"


def percent(share: float) -> str:
    """A share from 0 to 1 in percent."""
    return f"{100 * share:.1f}"
