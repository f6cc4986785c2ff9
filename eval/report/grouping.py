"""Groups of frames by columns or SQL expressions (``--by``), and their names."""

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from roadperc_stream.batch.addresses import natural
from roadperc_stream.errors import TableError

from ..dataset.keys import in_order_of_runs
from ..expressions import as_key, key_name
from ..options import number_or_text
from .sources import Frames, numbered, of_runs
from .summaries import Groups, groups_of_runs

MOST_GROUPS: Final = 40
"""Most groups by values that change within a run."""
_NONE: Final = "none"
"""Name of an unknown value."""
Key = tuple[str | None, ...]
"""The values of a group."""


def grouped_frames(frames: Frames, by: Sequence[str]) -> Groups:
    """The groups of frames by expressions with which they were loaded.

    Groups are sorted: numbers by size, texts alphabetically, configurations by age, unknown values last.

    Raises:
        TableError: a column has other types than the expression expects, or values within a run give too many groups.
    """
    if not by:
        return groups_of_runs(frames, ["all"] * frames.runs.height)
    run_keys = frames.runs.select(as_key(text, frames.runs.schema) for text in by if of_runs(frames.source, text))
    keys = [key_name(text) for text in by]
    if frames.keys.width:
        rows = frames.keys.hstack(run_keys[frames.run]) if run_keys.width else frames.keys
        of_frames, distinct = numbered(rows.select(keys))
        of_run = np.zeros(frames.runs.height, np.int64)
        of_run[frames.run] = of_frames
        whole = bool((of_run[frames.run] == of_frames).all())
    else:
        of_run, distinct = numbered(run_keys.select(keys))
        of_frames, whole = of_run[frames.run], True
    if not whole:
        require_few(distinct.height, by)
    configs = frames.runs["config"].unique(maintain_order=True).to_list()
    if frames.source.many:
        configs = in_order_of_runs(configs, frames.source.facts)
    order = sorted(range(distinct.height), key=lambda group: _place(distinct.row(group), by, configs))
    place = np.argsort(order)
    names = [group_name(distinct.row(group)) for group in order]
    return Groups(names, place[of_frames], place[of_run] if whole else None)


def configuration_columns(frames: Frames) -> list[str]:
    """The columns that group a dataset's frames by configuration: of configuration and version those that differ."""
    return [name for name in ("config", "version") if frames.runs[name].n_unique() > 1]


def require_few(groups: int, by: Sequence[str]) -> None:
    """Check the number of groups whose frames are not those of whole logs.

    Raises:
        TableError: there are too many.
    """
    if groups > MOST_GROUPS:
        raise TableError(
            f"--by {','.join(by)}: has more than {MOST_GROUPS} different values in the frames; "
            'expected fewer, as in lane_left_status or "floor(distance_m / 10) * 10"'
        )


def group_name(key: Key) -> str:
    """The values of a group in a line."""
    return ", ".join(_NONE if value is None else " ".join(value.split()) for value in key)


def _place(key: Key, by: Sequence[str], configs: Sequence[str]) -> list[tuple[bool, float, Any]]:
    return [_place_of_value(*item, configs) for item in zip(by, key, strict=True)]


def _place_of_value(column: str, value: str | None, configs: Sequence[str]) -> tuple[bool, float, Any]:
    if value is None:
        return True, 0.0, ""
    if column == "log":
        return False, 0.0, natural(value)
    if column == "config":
        return False, float(configs.index(value)) if value in configs else math.inf, value
    typed = number_or_text(value)
    return False, typed if isinstance(typed, float) else math.inf, value
