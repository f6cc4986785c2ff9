"""A contradiction between two inputs, or between an input and a result."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Two values that contradict each other beyond their errors.

    Args:
        code: names the kind of contradiction, such as ``camera_height``.
        text: one line for the user: both values, the likely causes, and the option that mends it.
    """

    code: str
    text: str
