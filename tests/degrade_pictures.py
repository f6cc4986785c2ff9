"""Makes the pictures of docs/degrade.md with the command that the page shows; ``make pictures`` runs it.

Usage:
    python -m tests.degrade_pictures LOG.mcap FOLDER    degraded_*.jpg in docs/; FOLDER gets the logs
"""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream import log
from roadperc_stream.formats.images import encode_jpeg
from roadperc_stream.input.roles import assignment_of_log
from roadperc_stream.input.stream import decoded_messages
from roadperc_stream.tools.corruptions.levels import LEVELS

Picture = NDArray[np.uint8]
_DOCS: Final = Path(__file__).parents[1] / "docs"
_BIN: Final = Path(sys.executable).parent
_FRAME: Final = 20
_SIZE: Final = (240, 180)
_ACROSS: Final = 4
_QUALITY: Final = 70
_FARTHEST_M: Final = 60.0
_GRIDS: Final = {
    "images": ("", *list(LEVELS)[:11]),
    "sensors": list(LEVELS)[12:19],
    "messages": ("frame_drop", *list(LEVELS)[19:]),
}
"""Corruptions of each picture; the empty name is the clean log."""
_TOPICS: Final = tuple(f"/camera/front/{name}" for name in ("image", "depth", "segmentation", "detections"))


def payloads(path: Path, role: str) -> list[Any]:
    """The contents of a role's messages, in log-time order."""
    summary = log.summarise(path)
    items = decoded_messages(log.read(summary), assignment_of_log(summary, {}))
    return [item.payload for item in items if item.role == role]


def run(command: str, *arguments: str | Path) -> None:
    """Run a command of the package."""
    subprocess.run([_BIN / command, *arguments, "--force", "--quiet"], check=True)


def picture(name: str, path: Path) -> Picture:
    """What a corruption changes, at the shown frame."""
    if name in _GRIDS["messages"]:
        return _arrivals(path)
    if name == "calibration_turned":
        result = path.with_name("result.mcap")
        run("roadperc-replay", path, result, "--overlay")
        return np.asarray(_overlay(result), np.uint8)
    if name.startswith("depth"):
        near = 1 - np.nan_to_num(payloads(path, "depth")[_FRAME].depth_m, nan=_FARTHEST_M) / _FARTHEST_M
        return np.asarray(cv2.applyColorMap((255 * near.clip(0, 1)).astype(np.uint8), cv2.COLORMAP_TURBO), np.uint8)
    if name.startswith("tag"):
        found = payloads(path, "segmentation")[_FRAME]
        return np.asarray(found.table.colours, np.uint8)[found.tags][..., ::-1]
    images = [image.bgr for image in payloads(path, "image")]
    if name == "camera_crash":  # sixteen images of the whole log
        small = [cv2.resize(image, None, fx=0.25, fy=0.25) for image in images[:: len(images) // 16]]
        return np.asarray(np.vstack([np.hstack(small[at : at + 4]) for at in range(0, 16, 4)]), np.uint8)
    shown = images[_FRAME].copy()
    if name.startswith("detections"):
        for item in payloads(path, "detections")[_FRAME]:
            corners = np.rint([item.box_px.x_min, item.box_px.y_min, item.box_px.x_max, item.box_px.y_max]).astype(int)
            cv2.rectangle(shown, corners[:2].tolist(), corners[2:].tolist(), (0, 0, 255), 2)
    return np.asarray(shown, np.uint8)


def _overlay(result: Path) -> Picture:
    summary = log.summarise(result)
    data = [message.data for message in log.read(summary, topics=("/perception/overlay",))][_FRAME]
    return cv2.imdecode(np.frombuffer(data[data.index(b"\xff\xd8\xff") :], np.uint8), cv2.IMREAD_COLOR)


def _arrivals(path: Path) -> Picture:
    """A row per sensor: lines from the stamps of one second, above, to the arrivals, below."""
    drawn, summary = np.full((_SIZE[1], _SIZE[0], 3), 255, np.uint8), log.summarise(path)
    begin_ns, rows = summary.first_ns or 0, (_SIZE[1] - 20) // len(_TOPICS)
    for at, topic in enumerate(_TOPICS):
        counts: dict[tuple[int, int], int] = {}
        for message in log.read(summary, topics=(topic,)):
            times = (message.publish_time_ns - begin_ns, message.log_time_ns - begin_ns)
            columns = [8 + round(t / 1e9 * (_SIZE[0] - 16)) for t in times]
            counts[columns[0], columns[1]] = counts.get((columns[0], columns[1]), 0) + 1
        for (stamp, arrival), count in counts.items():
            top, bottom = 24 + at * rows, 20 + (at + 1) * rows - 10
            cv2.line(drawn, (stamp, top), (arrival, bottom), (160, 160, 160), 1, cv2.LINE_AA)
            cv2.circle(drawn, (arrival, bottom), 1 + 2 * count, (200, 80, 0), -1, cv2.LINE_AA)
    return drawn


def grid(pictures: Sequence[tuple[str, Picture]]) -> Picture:
    """Pictures with their names, four in a row."""
    panels = []
    for name, shown in pictures:
        panel = cv2.resize(shown, _SIZE, interpolation=cv2.INTER_AREA)
        cv2.rectangle(panel, (0, 0), (_SIZE[0], 16), (0, 0, 0), -1)
        cv2.putText(panel, name, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
        panels.append(panel)
    panels += [np.full_like(panels[0], 255)] * (-len(panels) % _ACROSS)
    rows = [np.hstack(panels[at : at + _ACROSS]) for at in range(0, len(panels), _ACROSS)]
    return np.asarray(np.vstack(rows), np.uint8)


def main(source: Path, folder: Path) -> None:
    """Write the pictures."""
    for title, names in _GRIDS.items():
        pictures = []
        for name in names:
            path = folder / f"{name or 'clean'}.mcap"
            run("roadperc-degrade", source, path, "--with", f"{name or 'fog'}={3 if name else 0}", "--seed", "1")
            pictures.append((f"{name} 3" if name else "clean", picture(name, path)))
        (_DOCS / f"degraded_{title}.jpg").write_bytes(encode_jpeg(grid(pictures), _QUALITY))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
