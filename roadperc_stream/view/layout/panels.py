"""Panels of Foxglove and Lichtblick and their arrangement, as the JSON that both viewers store.

A panel with nothing to show is None; rows, columns and tabs leave it out. ``foxglove.layouts`` of the SDK writes a form
that Lichtblick does not read.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
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
    """Settings of its panels by key, including panels in tabs."""


def panel(kind: str, name: str, title: str, **config: Any) -> Node:
    """A panel of one of the viewers' types.

    ``name`` is unique among the panels of this type; ``title`` is stored under the key of each viewer.
    """
    key = f"{kind}!{name}"
    return Node(key, {key: {**config, "foxglovePanelTitle": title, "lichtblickPanelTitle": title}})


def picture(name: str, title: str, topic: str | None, annotations: Iterable[str] = (), **mode: Any) -> Node | None:
    """An image panel with annotations; ``mode`` are its colour settings.

    It has no calibration topic, because images and annotations do not need one. With one, a viewer reports an error if
    an image arrives before the calibration.
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
    shown = [part for part in parts if part is not None]
    if len(shown) < 2:
        return shown[0] if shown else None
    rest = _split(direction, shown[1:], 100 / (len(shown) - 1))
    assert rest is not None
    place = {"direction": direction, "first": shown[0].place, "second": rest.place, "splitPercentage": first_percent}
    return Node(place, {**shown[0].configs, **rest.configs})


def tabs(name: str, parts: Mapping[str, Node | None]) -> Node | None:
    """Tabs by title, with the first one open; a single part gets no tab."""
    shown = {title: part for title, part in parts.items() if part is not None}
    if len(shown) < 2:
        return next(iter(shown.values()), None)
    configs = {key: config for part in shown.values() for key, config in part.configs.items()}
    tab = {"activeTabIdx": 0, "tabs": [{"title": title, "layout": part.place} for title, part in shown.items()]}
    return Node(f"Tab!{name}", {f"Tab!{name}": tab, **configs})
