"""Writing a log's layout to a file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from roadperc_stream.core.files import completing, require_free
from roadperc_stream.view.layout.arrangement import layout_of
from roadperc_stream.view.layout.contents import OF_A_LIVE_REPLAY, contents_of

_NO_OVERRIDES: Final[Mapping[str, str]] = {}


def write_layout(
    target: Path,
    source: Path | None = None,
    overrides: Mapping[str, str] = _NO_OVERRIDES,
    *,
    timed: bool = False,
    force: bool,
) -> None:
    """Write the layout to a file for the viewers' "import from file".

    Args:
        target: the file, ``.json``.
        source: the log it is for; None for a replay that is served live and has all this project's own topics.
        overrides: topic of each role of ``source`` that another topic fills than the one found.
        timed: the log is served live with the times of its stages, which it does not hold itself.
        force: replace an existing file.

    Raises:
        RoadpercError: the log cannot be read or holds nothing to show, or the file's name is taken, or it
            cannot be written.
    """
    require_free(target, force=force, source=source, suffix=".json")
    has = contents_of(source, overrides) if source else OF_A_LIVE_REPLAY
    layout = layout_of(has.with_times() if timed else has)
    with completing(target, force=force) as temporary:
        temporary.write_text(layout, "utf-8")
