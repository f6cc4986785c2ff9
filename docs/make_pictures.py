"""Makes the pictures of docs/ from replayed logs with overlays and a report; ``make pictures`` runs it.

Usage:
    python docs/make_pictures.py report LOG.mcap REPORT.html          overlay.jpg and report.png
    python docs/make_pictures.py frames LOG.mcap PICTURE.jpg 12 30    overlays of some frames side by side
    python docs/make_pictures.py frames LOG.mcap PICTURE.jpg debug/lanes:12    another picture of a frame
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
_SHOWN_FRAME: Final = 12
_PANEL_SIZE: Final = (1110, 1240)
"""Columns and rows of the browser's window."""
_PANEL_SCALE: Final = 0.58
_PANELS: Final = (":is(header, .verdict, .verdict + section)", ".tables", ".worst")
"""What each of the panels shows, as CSS selectors of the page's parts."""
_COLOURS: Final = 128
_JPEG_QUALITY: Final = 80
_QUIET: Final = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=8000")


def jpegs(path: Path, topic: str = "overlay") -> dict[int, bytes]:
    """The pictures of a log below ``/perception``, as they are in it, by their frame."""
    with path.open("rb") as file:
        messages = make_reader(file).iter_messages(topics=[f"/perception/{topic}"])
        return {message.sequence: CompressedImage.FromString(message.data).data for _, _, message in messages}


def side_by_side(pictures: list[bytes]) -> NDArray[np.uint8]:
    """(H, sum of W, 3) pictures of one height beside each other."""
    return np.asarray(np.hstack([cv2.imdecode(np.frombuffer(jpeg, np.uint8), 1) for jpeg in pictures]), np.uint8)


def page_picture(page: Path, chromium: str) -> NDArray[np.uint8]:
    """(H, W, 3) the page's parts side by side, as a browser shows them."""
    html = page.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        panels = [_panel(html, part, chromium, Path(folder)) for part in _PANELS]
    small = cv2.resize(np.hstack(panels), None, fx=_PANEL_SCALE, fy=_PANEL_SCALE, interpolation=cv2.INTER_AREA)
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


def write_report(log_path: Path, page: Path) -> int:
    """Write overlay.jpg and report.png; without chromium the overlay alone."""
    (_DOCS / "overlay.jpg").write_bytes(jpegs(log_path)[_SHOWN_FRAME])
    chromium = shutil.which("chromium")
    if chromium is None:
        print("no chromium on this machine: docs/report.png stays as it is", file=sys.stderr)
        return 1
    picture = PillowImage.fromarray(page_picture(page, chromium)[..., ::-1])
    picture.quantize(_COLOURS, dither=PillowImage.Dither.NONE).save(_DOCS / "report.png", optimize=True)
    return 0


def write_frames(log_path: Path, target: Path, shown: list[str]) -> int:
    """Write pictures as one: the overlay of a frame, or ``TOPIC:FRAME``."""
    places = [place.rpartition(":") for place in shown]
    pictures = [jpegs(log_path, topic or "overlay")[int(frame)] for topic, _, frame in places]
    picture = PillowImage.fromarray(side_by_side(pictures)[..., ::-1])
    picture.save(target, quality=_JPEG_QUALITY, optimize=True)
    return 0


def main(arguments: list[str]) -> int:
    """Write the pictures that are asked for."""
    what, log_path, path, *frames = arguments
    if what == "report":
        return write_report(Path(log_path), Path(path))
    return write_frames(Path(log_path), Path(path), frames)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
