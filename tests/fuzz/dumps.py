"""Folders of frames for roadperc-convert, each with a fault."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz.choices import Choices, damage
from tests.fuzz.pictures import mutate_picture
from tests.fuzz.trees import mutate_json
from tests.tools import dump_writer

FRAMES = (0, 1)
POINTS = np.linspace(1, 9, 32, dtype="<f4").reshape(8, 4)
NAMES = (
    "000001", "1", "-1", "1305031102.933", "99999999999999999999", "1e5", "nan", "a", "", " ", "\x1b[31m5",
    "5\nINJECTED", "\uff11\uff12", "1403636579763555584", "0001_0002", "..5", "x" * 200, "[nope]7", "[red]8",
)  # fmt: skip
SUFFIXES = (".png", ".jpg", ".PNG", ".npy", ".csv", ".bin", ".ply", ".txt", "")


def write_dump(folder: Path, choices: Choices) -> None:
    """Write a small dump of one of several kinds, with its documents."""
    dump_writer.plain_dump(folder, FRAMES)
    for extra in EXTRAS[choices.of("kind", tuple(EXTRAS))]:
        extra(folder)


def mutate_dump(folder: Path, choices: Choices) -> None:
    """Change one file, or its name."""
    FAULTS[choices.of("do", WEIGHTED)](folder, choices)


def _right(folder: Path) -> None:
    for number in FRAMES:
        dump_writer.png(folder / "right" / f"{number:06d}.png", dump_writer.camera_pixels(number))
    _say(folder, baseline_m=0.5)


def _say(folder: Path, **more: object) -> None:
    path = folder / "calibration.json"
    dump_writer.document(path, json.loads(path.read_text()) | more)


ORIGIN = dict.fromkeys("xyz", 0.0), dict.fromkeys(("roll", "pitch", "yaw"), 0.0)


def _mounted(folder: Path) -> None:
    place = ORIGIN[0] | ORIGIN[1]
    _say(folder, mounting={"rgb": place, "lidar": place}, K=[[8.0, 0, 7.5], [0, 8.0, 5.5], [0, 0, 1]], rate_hz=20)


def _described(folder: Path) -> None:
    boxes = [{"label": "Car", "box_px": [1, 2, 8, 9], "score": 0.5}]
    dump_writer.document(folder / "detections.json", {str(number): boxes for number in FRAMES})
    poses = {str(n): {"location": ORIGIN[0] | {"x": n}, "rotation": ORIGIN[1]} for n in FRAMES}
    dump_writer.document(folder / "poses.json", poses)
    (folder / "timestamps.txt").write_text("".join(f"{number} {number * 0.05}\n" for number in FRAMES))


def _listed(folder: Path) -> None:
    _each(folder / "label_2", ".txt", b"Car 0 0 0 1 2 8 9 1 1 1 0 0 5 0 0.9\n")
    (folder / "poses.csv").write_text("frame,x,y,z,roll,pitch,yaw\n0,0,0,0,0,0,0\n1,1,0,0,0,0,0\n")
    (folder / "timestamps.csv").write_text("frame,seconds\n0,0.0\n1,0.05\n")


def _scanned(folder: Path) -> None:
    properties = "".join(f"property float32 {name}\n" for name in "xyzI")
    rows = "".join("{:.4f} {:.4f} {:.4f} {:.4f}\n".format(*row) for row in POINTS)
    text = f"ply\nformat ascii 1.0\nelement vertex 8\n{properties}end_header\n{rows}"
    _each(folder / "lidar", ".ply", text.encode())


def _each(folder: Path, suffix: str, data: bytes) -> None:
    folder.mkdir()
    for number in FRAMES:
        (folder / f"{number:06d}{suffix}").write_bytes(data)


def _instead(folder: Path, suffix: str, write: Callable[[Path], object]) -> None:
    """Replace the files of a folder by files with another suffix."""
    for path in list(folder.iterdir()):
        write(path.with_suffix(suffix))
        path.unlink()


def _depth(folder: Path, suffix: str, write: Callable[[Path, np.ndarray], object]) -> None:
    _instead(folder / "depth", suffix, lambda path: write(path, dump_writer.depth_m().astype(np.float32)))


EXTRAS: dict[str, tuple[Callable[[Path], object], ...]] = {
    "plain": (), "pair": (_right, _described), "mounted": (_mounted, _scanned, _described),
    "listed": (_listed, lambda dump: _instead(dump / "rgb", ".jpg", lambda p: dump_writer.jpeg(p, _PIXELS))),
    "arrays": (
        lambda dump: _depth(dump, ".npy", np.save), lambda dump: _each(dump / "velodyne", ".bin", POINTS.tobytes())
    ),
    "csv": (_described, _mounted, lambda dump: _depth(dump, ".csv", lambda p, m: np.savetxt(p, m, delimiter=","))),
}  # fmt: skip
_PIXELS = dump_writer.camera_pixels()


def _chosen(folder: Path, choices: Choices) -> Path:
    names = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    documents = [name for name in names if "/" not in name]
    return folder / choices.of("file", documents if documents and choices.chance("document", 0.4) else names)


def _content(folder: Path, choices: Choices) -> None:
    path = _chosen(folder, choices)
    if path.is_file():  # an earlier step may have renamed it
        path.write_bytes(MUTATORS.get(path.suffix, damage)(path.read_bytes(), choices))


WORDS = ("nan", "inf", "-1", "1e308", "1e400", "9" * 400, "", '"', "x", "\x1b[31m", "99999999999999999999", "\xff\xfe")


def _mutated_text(data: bytes, choices: Choices) -> bytes:
    """A text with a changed word, a repeated line, a long line, no content, or damaged bytes."""
    how = choices.of("how", ("word", "word", "bytes", "line", "empty", "long"))
    if how == "bytes":
        return damage(data, choices)
    lines = [line.replace(b",", b" , ").split() for line in data.splitlines()] or [[]]
    row = lines[choices.index("line", len(lines))]
    if how == "word" and row:
        row[choices.index("word", len(row))] = choices.of("value", WORDS).encode("latin-1")
    elif how == "line":
        lines.append(list(row))
    elif how == "long":
        row.extend([b"1"] * 5000)
    return b"" if how == "empty" else b"\n".join(b" ".join(row).replace(b" , ", b",") for row in lines)


MUTATORS = {
    ".json": mutate_json, ".png": mutate_picture, ".jpg": mutate_picture, ".csv": _mutated_text, ".txt": _mutated_text,
    ".ply": _mutated_text,
}  # fmt: skip


def _rename(folder: Path, choices: Choices) -> None:
    path = _chosen(folder, choices)
    name = choices.of("name", NAMES) + choices.of("suffix", (path.suffix, path.suffix, *SUFFIXES))
    if path.is_file() and name not in ("", ".", ".."):
        path.rename(path.with_name(name))


def _copy(folder: Path, choices: Choices) -> None:
    """Copy a file over one of another kind."""
    source, target = _chosen(folder, choices), _chosen(folder, choices.part("over"))
    if source.is_file():
        target.write_bytes(source.read_bytes())


def _link(folder: Path, choices: Choices) -> None:
    path = _chosen(folder, choices)
    if path.is_file():
        path.unlink()
        path.symlink_to(choices.of("to", ("missing.png", path.name, "/dev/null", ".")))


def _folder(folder: Path, choices: Choices) -> None:
    """Replace a file by a folder."""
    path = _chosen(folder, choices)
    path.unlink(missing_ok=True)
    path.mkdir()


FAULTS: dict[str, Callable[[Path, Choices], None]] = {
    "content": _content, "rename": _rename, "copy": _copy, "link": _link, "folder": _folder,
    "remove": lambda folder, choices: _chosen(folder, choices).unlink(missing_ok=True),
}  # fmt: skip
WEIGHTED = ("content",) * 9 + tuple(FAULTS)
