"""What a sweep varies, as an argument says it."""

import argparse
from dataclasses import dataclass


@dataclass(frozen=True)
class Varied:
    """A setting and the values it takes, as they were typed."""

    key: str
    texts: tuple[str, ...]


def varied(text: str) -> Varied:
    """An argument such as ``lanes.fit_strip_m=0.2,0.3,0.5``.

    Raises:
        ArgumentTypeError: not of this form, or a value twice.
    """
    key, _, values = text.partition("=")
    texts = tuple(value.strip() for value in values.split(","))
    if not key.strip() or not all(texts):
        raise argparse.ArgumentTypeError(f"{text}: expected KEY=VALUE,VALUE,... such as lanes.fit_strip_m=0.2,0.3,0.5")
    if len({_number_or_text(value) for value in texts}) < len(texts):
        raise argparse.ArgumentTypeError(f"{text}: a value stands there twice")
    return Varied(key.strip(), texts)


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
