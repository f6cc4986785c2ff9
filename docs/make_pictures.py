"""Makes docs/overlay.jpg and docs/report.png of a replayed log and its report; ``make pictures`` runs it.

Usage: python docs/make_pictures.py LOG_WITH_OVERLAYS.mcap REPORT.html
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import make_reader
from numpy.typing import NDArray
from PIL import Image as PillowImage

_DOCS: Final = Path(__file__).parent
_SHOWN_FRAME: Final = 30
_PANEL_SIZE: Final = (1110, 1240)
"""Columns and rows of the browser's window."""
_PANEL_SCALE: Final = 0.58
_PANELS: Final = (".tables", "section:has(.charts)", ".worst")
"""What each of the panels shows, as CSS selectors of the page's parts."""
_COLOURS: Final = 128
_QUIET: Final = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=8000")


def overlay_jpeg(path: Path, frame: int) -> bytes:
    """The overlay of a frame, as it is in the log."""
    with path.open("rb") as file:
        messages = list(make_reader(file).iter_messages(topics=["/perception/overlay"]))
    return CompressedImage.FromString(messages[min(frame, len(messages) - 1)][2].data).data


def page_picture(page: Path, chromium: str) -> NDArray[np.uint8]:
    """(H, W, 3) the page's parts side by side, as a browser shows them."""
    html = page.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        panels = [_panel(html, part, chromium, Path(folder)) for part in _PANELS]
    side_by_side = np.hstack(panels)
    small = cv2.resize(side_by_side, None, fx=_PANEL_SCALE, fy=_PANEL_SCALE, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


def _panel(html: str, part: str, chromium: str, folder: Path) -> NDArray[np.uint8]:
    """A screenshot of one part of the page: the others are hidden."""
    style = f"<style>body > :is(header, .tables, section):not({part}) {{ display: none }}</style></head>"
    page, target = folder / "page.html", folder / "panel.png"
    page.write_text(html.replace("</head>", style, 1), encoding="utf-8")
    window = f"--window-size={_PANEL_SIZE[0]},{_PANEL_SIZE[1]}"
    profile = f"--user-data-dir={folder / 'profile'}"
    command = [chromium, *_QUIET, profile, window, f"--screenshot={target}", page.as_uri()]
    subprocess.run(command, capture_output=True, timeout=300, check=True)
    return np.asarray(cv2.imread(str(target)), np.uint8)


def main(arguments: list[str]) -> int:
    """Write the pictures; without chromium the overlay alone."""
    log_path, page = map(Path, arguments)
    (_DOCS / "overlay.jpg").write_bytes(overlay_jpeg(log_path, _SHOWN_FRAME))
    chromium = shutil.which("chromium")
    if chromium is None:
        print("no chromium on this machine: docs/report.png stays as it is", file=sys.stderr)
        return 1
    picture = PillowImage.fromarray(page_picture(page, chromium)[..., ::-1])
    picture.quantize(_COLOURS, dither=PillowImage.Dither.NONE).save(_DOCS / "report.png", optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
