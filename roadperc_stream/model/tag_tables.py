"""Tag tables of CARLA versions and two datasets, and the class names that all stages use.

Sources: CARLA's documentation of the semantic segmentation camera and ``CityScapesPalette.h`` of the versions
0.8.2 to 0.9.15; ``labels.py`` of cityscapesScripts (``id``, not ``trainId``, which has only the evaluated classes);
the configuration of Mapillary Vistas 1.2. CARLA 0.9.14 changed its order to that of Cityscapes' ``trainId``. Numbers
do not identify the table, so the log names it (channel metadata ``tag_table``). If a dataset splits a class, all its
tags get the common class. The name of a network's table lists its classes: ``classes:unlabeled,road,road_line``.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import ConfigError

UNLABELED: Final = "unlabeled"
_OF_CLASSES: Final = "classes:"
"""Prefix of the names of tables that list their classes."""
_LABELS = 1024
"""Size of the cache of labels: a detector has fewer, but a log may hold any number."""
Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""


@dataclass(frozen=True)
class TagTable:
    """The classes of one range of CARLA versions, or of a dataset: the tag is the position in ``names``."""

    name: str
    names: tuple[str, ...] = field(repr=False)
    colours: tuple[Colour, ...] = field(repr=False)
    other_colours: tuple[tuple[Colour, int], ...] = field(default=(), repr=False)
    """Other colours that some versions in the range use for a tag."""

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

    def tag_by_colour(self) -> dict[Colour, int]:
        """Every palette colour of these versions and its tag."""
        return {**dict(self.other_colours), **{colour: tag for tag, colour in enumerate(self.colours)}}


_COLOURS: Final[dict[str, Colour]] = {
    "unlabeled": (0, 0, 0),
    "building": (70, 70, 70),
    "fence": (190, 153, 153),
    "other": (250, 170, 160),
    "pedestrian": (220, 20, 60),
    "pole": (153, 153, 153),
    "road_line": (157, 234, 50),
    "road": (128, 64, 128),
    "sidewalk": (244, 35, 232),
    "vegetation": (107, 142, 35),
    "vehicle": (0, 0, 142),
    "car": (0, 0, 142),
    "wall": (102, 102, 156),
    "traffic_sign": (220, 220, 0),
    "sky": (70, 130, 180),
    "ground": (81, 0, 81),
    "bridge": (150, 100, 100),
    "rail_track": (230, 150, 140),
    "guard_rail": (180, 165, 180),
    "traffic_light": (250, 170, 30),
    "static": (110, 190, 160),
    "dynamic": (170, 120, 50),
    "water": (45, 60, 150),
    "terrain": (152, 251, 152),
    "rider": (255, 0, 0),
    "truck": (0, 0, 70),
    "bus": (0, 60, 100),
    "train": (0, 80, 100),
    "motorcycle": (0, 0, 230),
    "bicycle": (119, 11, 32),
    "parking": (250, 170, 160),
    "crosswalk": (140, 140, 200),
    "bike_lane": (128, 64, 255),
}
_OF_SOME_VERSIONS: Final[dict[Colour, str]] = {
    (100, 40, 40): "fence",
    (55, 90, 80): "other",
    (145, 170, 100): "terrain",
}
"""Colours of fences and other things in later versions, and of terrain in early ones."""


def _table(name: str, names: str, variants: dict[Colour, str]) -> TagTable:
    classes = tuple(names.split())
    colours = tuple(_COLOURS[c] for c in classes)
    return TagTable(name, classes, colours, tuple((colour, classes.index(c)) for colour, c in variants.items()))


CARLA_BEFORE_0_9_14: Final = _table(
    "carla-before-0.9.14",
    "unlabeled building fence other pedestrian pole road_line road sidewalk vegetation vehicle wall traffic_sign "
    "sky ground bridge rail_track guard_rail traffic_light static dynamic water terrain",
    _OF_SOME_VERSIONS,
)
CARLA_FROM_0_9_14: Final = _table(
    "carla-from-0.9.14",
    "unlabeled road sidewalk building wall fence pole traffic_light traffic_sign vegetation terrain sky pedestrian "
    "rider car truck bus train motorcycle bicycle static dynamic other water road_line ground bridge rail_track "
    "guard_rail",
    _OF_SOME_VERSIONS,
)
CITYSCAPES: Final = _table(
    "cityscapes",
    "unlabeled unlabeled unlabeled unlabeled static dynamic ground road sidewalk parking rail_track building wall "
    "fence guard_rail bridge building pole pole traffic_light traffic_sign vegetation terrain sky pedestrian rider car "
    "truck bus truck truck train motorcycle bicycle",
    {(111, 74, 0): "dynamic", (150, 120, 90): "building", (0, 0, 90): "truck", (0, 0, 110): "truck"},
)
MAPILLARY_VISTAS: Final = _table(
    "mapillary-vistas-1.2",
    "dynamic dynamic sidewalk fence guard_rail static wall bike_lane crosswalk sidewalk parking sidewalk rail_track "
    "road road sidewalk bridge building building pedestrian rider rider rider crosswalk road_line terrain terrain sky "
    "terrain terrain vegetation water static static static static road static static static static road static road "
    "pole pole static pole traffic_light traffic_sign traffic_sign static bicycle dynamic bus car truck motorcycle "
    "train truck truck truck dynamic unlabeled unlabeled unlabeled",
    {},  # its palette is not CARLA's
)
CARLA_TABLES: Final = (CARLA_BEFORE_0_9_14, CARLA_FROM_0_9_14)
TABLES: Final = {table.name: table for table in (*CARLA_TABLES, CITYSCAPES, MAPILLARY_VISTAS)}

GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "vehicle": ("vehicle", "car", "truck", "bus", "train", "motorcycle", "bicycle"),
    "pedestrian": ("pedestrian", "rider"),
}
"""Groups of classes that some tables split: before 0.9.14 all vehicles have one tag."""

CLASS_NAMES: Final = frozenset(name for table in TABLES.values() for name in table.names) | frozenset(GROUPS)

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


@lru_cache(maxsize=_LABELS)
def classes_of_label(label: str) -> tuple[str, ...] | None:
    """Classes whose tags a detection of this label should cover; None if the label is unknown."""
    return LABEL_CLASSES.get(label.strip().lower().replace(" ", "_").replace("-", "_"))


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
    if unknown := next((name for name in names if name not in _COLOURS), None):
        raise ConfigError(f"class {unknown!r} is in no tag table; known: {', '.join(sorted(_COLOURS))}")
    return _table(f"{_OF_CLASSES}{','.join(names)}", " ".join(names), {})


def table_named(name: str) -> TagTable | None:
    """The table of a name in a log; None if it is unknown."""
    if not name.startswith(_OF_CLASSES):
        return TABLES.get(name)
    try:
        return table_of_classes(name.removeprefix(_OF_CLASSES).split(","))
    except ConfigError:
        return None


def table_for_version(version: str) -> TagTable:
    """Tag table of a CARLA version such as ``0.9.15``, or a table by its own name such as ``cityscapes``.

    Raises:
        ConfigError: ``version`` is neither a version nor the name of a table.
    """
    if version in TABLES:
        return TABLES[version]
    match = re.fullmatch(r"v?(\d{1,4})\.(\d{1,4})(?:\.(\d{1,4}))?(?:\D.*)?", version.strip())
    if not match:
        raise ConfigError(f"CARLA version {version!r}: expected a number such as 0.9.15, or one of {', '.join(TABLES)}")
    numbers = tuple(int(part or 0) for part in match.groups())
    return CARLA_FROM_0_9_14 if numbers >= (0, 9, 14) else CARLA_BEFORE_0_9_14


def _members(name: str) -> tuple[str, ...]:
    if name not in CLASS_NAMES:
        raise ConfigError(f"class {name!r} is in no tag table; known: {', '.join(sorted(CLASS_NAMES))}")
    return GROUPS.get(name, (name,))
