"""Tag tables of CARLA versions, datasets and users, and the class names that all stages use.

Each file in ``tables/`` is a table. CARLA 0.9.14 changed its order to that of Cityscapes' ``trainId``. Numbers do not
identify the table, so the log names it (channel metadata ``tag_table``). If a dataset splits a class, all its tags get
the common class. The name of a network's or a user's table lists its classes: ``classes:unlabeled,road,road_line``.
"""

import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import ConfigError

K = TypeVar("K")
UNLABELED: Final = "unlabeled"
_OF_CLASSES: Final = "classes:"
"""Prefix of the names of tables that list their classes."""
_LARGEST_TAG: Final = 255
_LABELS = 1024
"""Size of the cache of labels: a detector has fewer, but a log may hold any number."""
Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""


@dataclass(frozen=True)
class TagTable:
    """The classes of CARLA versions, a dataset, a network or a user: the tag is the position in ``names``."""

    name: str
    names: tuple[str, ...] = field(repr=False)
    colours: tuple[Colour, ...] = field(repr=False)
    tag_by_colour: Mapping[Colour, int] = field(default_factory=dict, repr=False)
    """The colours of palette images, and their tags."""
    gaps: frozenset[int] = field(default=frozenset(), repr=False)
    """Positions in ``names`` that are no tags; they are ``unlabeled``."""
    instances_per_tag: int = 0
    """Images of instances have tag * instances_per_tag + instance; 0 if the dataset has none."""
    title: str = ""
    """Name or file for messages."""

    def __hash__(self) -> int:
        """Hash the name only: it is unique, and hashing all classes and colours is slow."""
        return hash(self.name)

    def tags_of(self, classes: Iterable[str]) -> tuple[int, ...]:
        """Tags of the named classes; the name of a group includes all its members.

        Raises:
            ConfigError: no table has such a class.
        """
        wanted = {member for name in classes for member in _members(name)}
        return tuple(tag for tag, name in enumerate(self.names) if name in wanted)

    def lookup(self, classes: Iterable[str]) -> NDArray[np.uint8]:
        """(256,) uint8 with 1 at the tags of the named classes; index it with tags to get a mask."""
        table = np.zeros(256, np.uint8)
        table[list(self.tags_of(classes))] = 1
        return table

    def name_of(self, tag: int) -> str:
        """Class name of a tag; a tag outside the table is ``unlabeled``."""
        return self.names[tag] if tag < len(self.names) else UNLABELED


def _rgb(value: Any) -> Colour:
    if not (isinstance(value, str) and re.fullmatch("#[0-9A-Fa-f]{6}", value)):
        raise ValueError(f'colour {value!r}: expected one such as "#8040ff"')
    red, green, blue = bytes.fromhex(value[1:])
    return red, green, blue


_COLOURS: Final = {
    name: _rgb(text)
    for name, text in tomllib.loads(Path(__file__).with_name("colours.toml").read_text("utf-8")).items()
}


def table_of(document: dict[str, Any], source: str, name: str = "") -> TagTable:
    """The table of a TOML document; a table without a name, as a user's, is called by the class of each tag.

    ``[tags]`` has the tags of each class. ``[colours]`` has its colours in palette images: all of them in a user's
    table, those besides the common ones in a named table. ``instances_per_tag`` is that of ``TagTable``.

    Raises:
        ConfigError: a key, class, tag or colour of the file ``source`` is wrong.
    """
    try:
        of_tag = _class_of(document.pop("tags", {}), _tag)
        of_colour = _class_of(document.pop("colours", {}), _rgb)
        instances = document.pop("instances_per_tag", 0)
        _require_keys(document, of_tag, of_colour, instances)
    except (ValueError, AttributeError, ConfigError) as error:
        raise ConfigError(f"{source}: {error}") from error
    names = tuple(of_tag.get(tag, UNLABELED) for tag in range(max(of_tag) + 1))
    by_colour = {colour: names.index(found) for colour, found in of_colour.items()}
    if name or not by_colour:
        by_colour |= {_COLOURS[found]: tag for tag, found in sorted(of_tag.items())}
    gaps = frozenset(range(len(names))).difference(of_tag)
    return replace(
        _listed(names, name), tag_by_colour=by_colour, gaps=gaps, instances_per_tag=instances, title=name or source
    )


def _require_keys(
    others: Mapping[str, Any], of_tag: Mapping[int, str], of_colour: Mapping[Colour, str], instances: Any
) -> None:
    if others or not of_tag or type(instances) is not int or instances < 0:
        raise ValueError("expected [tags], and perhaps [colours] and a whole number instances_per_tag")
    if untagged := set(of_colour.values()).difference(of_tag.values()):
        raise ValueError(f"{min(untagged)} has colours, but no tag")


def _class_of(keys_of: Mapping[str, Any], key_of: Callable[[Any], K]) -> dict[K, str]:
    """The class of each tag or colour; a class has one or a list of them."""
    found: dict[K, str] = {}
    for name, values in keys_of.items():
        for value in values if isinstance(values, list) else [values]:
            if found.setdefault(key_of(value), name) != name:
                raise ValueError(f"{value} is both {found[key_of(value)]} and {name}")
    _require_known(keys_of)
    return found


def _tag(value: Any) -> int:
    if type(value) is not int or not 0 <= value <= _LARGEST_TAG:
        raise ValueError(f"tag {value!r}: expected a whole number from 0 to {_LARGEST_TAG}")
    return value


def _require_known(classes: Iterable[str]) -> None:
    if unknown := next((name for name in classes if name not in _COLOURS), None):
        raise ConfigError(f"class {unknown!r} is in no tag table; known: {', '.join(sorted(_COLOURS))}")


def _listed(names: tuple[str, ...], name: str = "") -> TagTable:
    """The table of the class of each tag; without a name it is called by them."""
    name = name or f"{_OF_CLASSES}{','.join(names)}"
    colours = tuple(_COLOURS[found] for found in names)
    return TagTable(name, names, colours, {colour: tag for tag, colour in enumerate(colours)}, title=name)


_FILES: Final = Path(__file__).with_name("tables")
TABLES: Final = tuple(sorted(path.stem for path in _FILES.glob("*.toml")))
"""Names of the tables of CARLA and of datasets."""


@cache
def _table_of_dataset(name: str) -> TagTable:
    path = _FILES / f"{name}.toml"
    return table_of(tomllib.loads(path.read_text("utf-8")), str(path), name)


CARLA_BEFORE_0_9_14: Final = _table_of_dataset("carla-before-0.9.14")
CARLA_FROM_0_9_14: Final = _table_of_dataset("carla-from-0.9.14")
CARLA_TABLES: Final = (CARLA_BEFORE_0_9_14, CARLA_FROM_0_9_14)

GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "vehicle": ("vehicle", "car", "truck", "bus", "train", "motorcycle", "bicycle"),
    "pedestrian": ("pedestrian", "rider"),
}
"""Groups of classes that some tables split: before 0.9.14 all vehicles have one tag."""

CLASS_NAMES: Final = frozenset(_COLOURS) | frozenset(GROUPS)

LABEL_CLASSES: Final[dict[str, tuple[str, ...]]] = {
    **dict.fromkeys(("vehicle", "car", "van", "truck", "bus", "tram", "train"), ("vehicle",)),
    **dict.fromkeys(("motorcycle", "bicycle"), ("vehicle", "rider")),
    **dict.fromkeys(("pedestrian", "person", "person_sitting", "walker"), ("pedestrian",)),
    "cyclist": ("vehicle", "rider", "pedestrian"),
    "rider": ("pedestrian", "rider"),
    "traffic_light": ("traffic_light", "traffic_sign"),
    **dict.fromkeys(("traffic_sign", "stop_sign"), ("traffic_sign",)),
}
"""Detector labels (lower case, blanks as underscores) and the classes their pixels may carry."""


def normal_label(label: str) -> str:
    """The label in lower case, with underscores for blanks and hyphens."""
    return label.strip().lower().replace(" ", "_").replace("-", "_")


def known_label(label: str, labels: Mapping[str, str]) -> str:
    """The known label of a label, by its normal form; the label itself if ``labels`` does not have it."""
    return labels.get(normal_label(label), label) if labels else label


@lru_cache(maxsize=_LABELS)
def classes_of_label(label: str) -> tuple[str, ...] | None:
    """Classes whose tags a detection of this label should cover; None if the label is unknown."""
    return LABEL_CLASSES.get(normal_label(label))


@cache
def label_lookup(table: TagTable, label: str) -> NDArray[np.uint8] | None:
    """(256,) uint8 mask table of a detector label; None if the label is unknown, or the table has none of its classes.

    Tags cannot judge such a detection.
    """
    classes = classes_of_label(label)
    return None if classes is None or not table.tags_of(classes) else table.lookup(classes)


def table_of_classes(classes: Iterable[str]) -> TagTable:
    """The table of a network's classes, such as ``classes:unlabeled,road,road_line``; repeated ones count once.

    Raises:
        ConfigError: no other table has such a class.
    """
    names = tuple(dict.fromkeys(classes))
    _require_known(names)
    return _listed(names)


def table_named(name: str) -> TagTable | None:
    """The table of a name in a log; None if it is unknown."""
    if name in TABLES:
        return _table_of_dataset(name)
    names = tuple(name.removeprefix(_OF_CLASSES).split(","))
    return _listed(names) if name.startswith(_OF_CLASSES) and _COLOURS.keys() >= set(names) else None


def table_for_version(version: str) -> TagTable:
    """Tag table of a CARLA version such as ``0.9.15``, or a table by its own name such as ``cityscapes``.

    Raises:
        ConfigError: ``version`` is neither a version nor the name of a table.
    """
    if version in TABLES:
        return _table_of_dataset(version)
    match = re.fullmatch(r"v?(\d{1,4})\.(\d{1,4})(?:\.(\d{1,4}))?(?:\D.*)?", version.strip())
    if not match:
        raise ConfigError(f"no tag table {version!r}; expected a CARLA version, such as 0.9.15, or {', '.join(TABLES)}")
    numbers = tuple(int(part or 0) for part in match.groups())
    return CARLA_FROM_0_9_14 if numbers >= (0, 9, 14) else CARLA_BEFORE_0_9_14


def _members(name: str) -> tuple[str, ...]:
    if name not in CLASS_NAMES:
        raise ConfigError(f"class {name!r} is in no tag table; known: {', '.join(sorted(CLASS_NAMES))}")
    return GROUPS.get(name, (name,))
