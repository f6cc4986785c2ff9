"""The table of docs/architecture.md: a depth image passes the functions that it names, in that order."""

import re
import sys
from pathlib import Path

from roadperc_stream.config import load_config
from tests import logs
from tests.replaying import replay

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PACKAGE = str(ROOT / "roadperc_stream")
MOST_TYPES = 8


def called(folder):
    """(room, function) of all calls of a replay of two frames in one thread, in their order."""
    calls = []

    def note(frame, event, _):
        if event == "call" and frame.f_code.co_filename.startswith(PACKAGE):
            room = Path(frame.f_code.co_filename).relative_to(PACKAGE).parts[0].removesuffix(".py")
            calls.append((room, frame.f_code.co_qualname))

    source = logs.write(folder / "in.mcap", logs.items(2, road=logs.SMALL))
    sys.setprofile(note)
    try:
        replay(source, folder / "out.mcap", load_config())
    finally:
        sys.setprofile(None)
    return calls


def test_a_depth_image_passes_the_functions_of_the_page_in_order(tmp_path):
    rows = re.findall(r"^\| `(\w+)` \| `([\w.]+)` \|", PAGE, re.MULTILINE)
    assert len(rows) > 20
    calls = iter(called(tmp_path))
    for row in rows:
        assert row in calls, f"{row} is not called after the rows before it"


def test_a_frame_passes_at_most_eight_types():
    """Between the bytes of a message and the row of the table."""
    (listed,) = re.findall(r"between the bytes of a message and its row: (.*?)\. `tests", PAGE, re.DOTALL)
    types = re.findall(r"`(\w+)`", listed)
    assert len(types) <= MOST_TYPES
    table = PAGE.partition("## The path of a depth image")[2].partition("A frame passes")[0]
    passed = dict.fromkeys(re.findall(r"`([A-Z]\w+)`", table))
    assert [name for name in passed if name not in {"Message", "DepthImage", "FrameMetrics"}] == types
    sources = "".join(path.read_text(encoding="utf-8") for path in Path(PACKAGE).rglob("*.py"))
    for name in passed:
        assert re.search(rf"^class {name}\b", sources, re.MULTILINE), name
