"""Panels of Foxglove and Lichtblick and their arrangement, as the JSON that both viewers store.

A part with nothing to show is None; rows, columns and tabs leave it out. The SDK's own ``foxglove.layouts``
writes a form that Lichtblick does not read.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

Config = dict[str, Any]
"""Settings as the viewers store them."""
PRELOADED: Final[Config] = {"enablePreloading": True}
"""Read all transforms first: Lichtblick raises an alert for each panel that does not."""
_EVEN: Final = 50.0


@dataclass(frozen=True)
class Node:
    """A part of a window: a panel, or several of them."""

    place: Config | str
    """The key of a panel or of tabs, or a split into two parts beside or above each other."""
    configs: Mapping[str, Config]
    """Settings of its panels by their keys, those in tabs included."""


def panel(kind: str, name: str, title: str, **config: Any) -> Node:
    """A panel of a type that the viewers know.

    Args:
        kind: the type.
        name: unique among the panels of this type.
        title: stored under the name that either viewer looks for.
        config: its other settings.
    """
    key = f"{kind}!{name}"
    return Node(key, {key: {**config, "foxglovePanelTitle": title, "lichtblickPanelTitle": title}})


def picture(name: str, title: str, topic: str | None, annotations: Iterable[str] = (), **mode: Any) -> Node | None:
    """An image, with what is drawn over it; ``mode`` says how its numbers are coloured.

    It names no calibration: images and annotations work without one. A viewer reports an error if it draws an image
    before the calibration arrives.
    """
    if topic is None:
        return None
    mode |= {"imageTopic": topic, "synchronize": False}
    if drawn := {over: {"visible": True} for over in annotations}:
        mode["annotations"] = drawn
    return panel("Image", name, title, imageMode=mode, scene={"transforms": PRELOADED})


def row(*parts: Node | None, first_percent: float = _EVEN) -> Node | None:
    """Parts side by side. The first gets ``first_percent``; the others share the rest evenly."""
    return _split("row", parts, first_percent)


def column(*parts: Node | None, first_percent: float = _EVEN) -> Node | None:
    """Parts on top of each other. The first gets ``first_percent``; the others share the rest evenly."""
    return _split("column", parts, first_percent)


def _split(direction: str, parts: Iterable[Node | None], first_percent: float) -> Node | None:
    there = [part for part in parts if part is not None]
    if len(there) < 2:
        return there[0] if there else None
    rest = _split(direction, there[1:], 100 / (len(there) - 1))
    assert rest is not None
    place = {"direction": direction, "first": there[0].place, "second": rest.place, "splitPercentage": first_percent}
    return Node(place, {**there[0].configs, **rest.configs})


def tabs(name: str, parts: Mapping[str, Node | None]) -> Node | None:
    """Parts by their titles, the first one open; a single one needs no tab."""
    there = {title: part for title, part in parts.items() if part is not None}
    if len(there) < 2:
        return next(iter(there.values()), None)
    shown = [{"title": title, "layout": part.place} for title, part in there.items()]
    own = {f"Tab!{name}": {"activeTabIdx": 0, "tabs": shown}}
    return Node(f"Tab!{name}", own | dict(chain.from_iterable(part.configs.items() for part in there.values())))
