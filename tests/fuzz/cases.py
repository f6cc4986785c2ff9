"""Cases: input files made from a recipe, and the command that reads them."""

import base64
import json
import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from roadperc_stream.config import ReplayConfig
from tests.fuzz import contents, dumps, tables
from tests.fuzz.choices import Choices, damage, wild_integer
from tests.fuzz.messages import mutate_content
from tests.fuzz.records import WEIGHTED_FIXES, mutate_records, put_together, taken_apart
from tests.fuzz.trees import mutate_json, mutate_toml, wild_setting

CORPUS = Path(__file__).parent / "corpus"
LOG, OUT = "in.mcap", "out.mcap"
METRICS = "out.metrics.parquet"


@dataclass(frozen=True)
class Case:
    """A name and a recipe; without a recipe the choices follow from the name SEED:NUMBER."""

    name: str
    recipe: dict[str, Any] | None = None


def recorded() -> dict[str, Case]:
    """The corpus, by name."""
    found = {path.stem: json.loads(path.read_text("utf-8")) for path in sorted(CORPUS.glob("*.json"))}
    return {name: Case(name, recipe) for name, recipe in found.items()}


def named(name: str) -> Case:
    """The case named SEED:NUMBER, or in the corpus, or in a recipe file.

    Raises:
        ValueError: no such case.
    """
    if re.fullmatch(r"\d+:\d+", name):
        return Case(name)
    if name in recorded():
        return recorded()[name]
    if Path(name).is_file():
        return Case(name, json.loads(Path(name).read_text("utf-8")))
    raise ValueError(f"{name}: expected SEED:NUMBER, a name in the corpus, or a file with a recipe")


def prepared(case: Case, folder: Path) -> tuple[list[str], dict[str, Any]]:
    """Write a case's input files into a folder.

    Returns:
        The command to run in that folder, and the whole recipe.
    """
    choices = Choices(case.recipe, random.Random(case.name))
    words = FAMILIES[choices.of("family", WEIGHTED)](folder, choices)
    return list(choices.of("command", (words,))), choices.made


def _log(folder: Path, choices: Choices) -> list[str]:
    """A log with changes in its content, its records or its bytes, rarely in all of them."""
    base = choices.of("base", tuple(contents.BASES))
    level = choices.of("level", ("content", "content", "content", "records", "records", "bytes", "all"))
    content = contents.BASES[base]().copied()
    for part in choices.parts("content", 3 if level in ("content", "all") else 0):
        mutate_content(content, part)
    data = contents.encoded(content, choices.of("writer", tuple(contents.WRITERS)))
    changes = choices.parts("records", 2 if level in ("records", "all") else 0)
    if changes:
        records = taken_apart(data)
        for part in changes:
            mutate_records(records, part)
        data = put_together(records, choices.of("fix", WEIGHTED_FIXES))
    data = _damaged(data, choices, 2 if level in ("bytes", "all") else 0)
    name = OUT if base == "result" else LOG
    (folder / name).write_bytes(data)
    if base == "result":
        _write_tables(folder)
    words = [part.replace("LOG", name) for part in choices.of("of_log", LOG_COMMANDS).split()]
    return words + (_replay_options(choices) if words[0] == "replay" else [])


def _write_tables(folder: Path) -> None:
    for kind in ("metrics", "objects"):
        (folder / f"out.{kind}.parquet").write_bytes(_table_bytes(kind))


@cache
def _table_bytes(kind: str) -> bytes:
    return tables.written(tables.table(kind))


LOG_COMMANDS = ("replay LOG result.mcap",) * 8 + (
    "info LOG", "info LOG --json", "view LOG --save view.rrd", "view LOG --save view.rrd",
    "view LOG --foxglove-layout view.json", "view LOG --video view.mp4", "lanes LOG --tusimple lanes.json",
    "sweep LOG --vary lanes.hold_s=0.2,0.5 --out sweep --jobs 1",
    "batch dataset LOG", "batch dataset LOG --recover --logs",
)  # fmt: skip


def _replay_options(choices: Choices) -> list[str]:
    options = choices.of("options", REPLAY_OPTIONS).split()
    if choices.chance("setting", 0.1):
        options += ["--set", wild_setting(choices.part("set"))]
    return options


REPLAY_OPTIONS = ("",) * 6 + (
    "--overlay", "--overlay --debug", "--start 0.04", "--start -1 --end 0.01", "--end 0", "--frames 1",
    "--results-only", "--only surface", "--only odometry,lanes",
    "--set stereo.method=full", "--set surface.model=spline",
    "--topic image=/camera/right/image", "--topic depth=/nowhere", "--set odometry.features=orb",
    "--set tag_table=0.9.15", "--start 1e9", "--set sync.max_wait_s=0", "--quiet", "--set occupancy.enabled=false",
)  # fmt: skip


def _table(folder: Path, choices: Choices) -> list[str]:
    """The tables of a replay, one of them changed, beside its log and the unchanged tables."""
    (folder / "a").mkdir()
    _write_tables(folder)
    _write_tables(folder / "a")
    (folder / OUT).write_bytes(contents.results()[OUT])
    kind = choices.of("table", ("metrics", "metrics", "metrics", "objects"))
    changed = tables.table(kind)
    for part in choices.parts("values", 3):
        changed = tables.mutate_table(changed, part)
    data = _damaged(tables.written(changed), choices, choices.of("damaged", (0, 0, 1, 3)))
    (folder / f"out.{kind}.parquet").write_bytes(data)
    return str(choices.of("of_table", TABLE_COMMANDS)).split()


def _damaged(data: bytes, choices: Choices, most: int) -> bytes:
    for part in choices.parts("bytes", most):
        data = damage(data, part)
    return data


TABLE_COMMANDS = (
    f"report {METRICS}", "report out.mcap", f"report . a/{METRICS} --worst 2", f"report {METRICS} --html page.html",
    f"compare a/{METRICS} {METRICS}", f"compare {METRICS} a/{METRICS} --exact",
    f"compare a/{METRICS} {METRICS} --other-log",
    "compare a . --allow 5% --tolerance *=0.1", f"trajectory {METRICS}", f"trajectory {METRICS} --align sim3",
    f"trajectory {METRICS} --export-tum tum --export-kitti kitti --align none", f"info {OUT}",
    f"trajectory {METRICS} --delta 1 --delta-unit metres", f"lanes {OUT} --tusimple lanes.json",
    f"replay {OUT} result.mcap", f"view {OUT} --foxglove-layout view.json",
    f"check {METRICS}", f"check . a/{METRICS}", f"check {METRICS} --init limits.toml",
)  # fmt: skip


def _config(folder: Path, choices: Choices) -> list[str]:
    """A configuration file and settings for a replay."""
    text = ReplayConfig().to_toml().encode()
    for part in choices.parts("text", 2):
        text = mutate_toml(text, part)
    (folder / "mine.toml").write_bytes(text)
    (folder / LOG).write_bytes(contents.encoded(contents.BASES["drive"](), "zstd"))
    words = str(choices.of("of_config", CONFIG_COMMANDS)).split()
    for part in choices.parts("settings", 2):
        words += ["--set", wild_setting(part)]
    return words


CONFIG_COMMANDS = (
    "replay --print-config --config mine.toml", "replay --print-config --config mine.toml",
    "replay in.mcap result.mcap --config mine.toml --frames 1",
)  # fmt: skip


def _criteria(folder: Path, choices: Choices) -> list[str]:
    """A criteria file for a result, with its effects for compare."""
    _write_tables(folder)
    text = CRITERIA.encode()
    for part in choices.parts("text", 3):
        text = mutate_toml(text, part)
    (folder / "mine.toml").write_bytes(text)
    return str(choices.of("of_criteria", CRITERIA_COMMANDS)).split()


CRITERIA = """
metrics.lane_left_error_m = { relevant = 0.1, limit = 1.0 }
criterion = [
  { metric = "lane_left_error_m", statistic = "p95", most = 0.1, least_coverage = 0.9, filter = "frame > 0" },
  { name = "losses", statistic = "rate", event = "lane_left_status = 'lost'", most = 2, per_log = true },
  { column = "total_ms", statistic = "share", within = 100.0, least = 0.5, least_frames = 1 },
]
"""
CRITERIA_COMMANDS = (f"check {METRICS} --criteria mine.toml",) * 3 + (
    f"compare {METRICS} {METRICS} --criteria mine.toml",
)  # fmt: skip


def _lanes(folder: Path, choices: Choices) -> list[str]:
    """True lanes in TuSimple's format, to score a result."""
    (folder / OUT).write_bytes(contents.results()[OUT])
    _write_tables(folder)
    lines = [json.dumps(line).encode() for line in TRUE_LANES]
    for part in choices.parts("lines", 2):
        at = part.index("line", len(lines))
        lines[at] = mutate_json(lines[at], part)
    data = _damaged(b"\n".join(lines), choices, choices.of("damaged", (0, 0, 0, 2)))
    (folder / "true.json").write_bytes(data)
    return str(choices.of("of_lanes", LANES_COMMANDS)).split()


TRUE_LANES = [
    {"raw_file": f"out/{stamp_ns}", "lanes": [[3, 4, 5], [20, -2, 25]], "h_samples": [12, 16, 20], "run_time": 1}
    for stamp_ns in (contents.START_NS, contents.START_NS + contents.STEP_NS)
]
LANES_COMMANDS = (
    "lanes out.mcap --truth true.json", "lanes out.mcap --truth true.json --pair order",
    "lanes out.mcap --truth true.json --size 1280x720", "lanes out.mcap --truth true.json --tusimple lanes.json",
)  # fmt: skip


def _dump(folder: Path, choices: Choices) -> list[str]:
    """A folder of frames."""
    dump = folder / "dump"
    dumps.write_dump(dump, choices)
    for part in choices.parts("files", 2):
        dumps.mutate_dump(dump, part)
    words = ["convert", "dump", "in.mcap", *str(choices.of("options", CONVERT_OPTIONS)).split()]
    return words + (["--rate", str(wild_integer(choices, "rate"))] if choices.chance("odd_rate", 0.05) else [])


CONVERT_OPTIONS = ("",) * 4 + (
    "--depth float", "--rate 0.5", "--carla 0.9.10", "--fov 60 --quiet", "--role image=segmentation",
    "--allow-lossy-tags",
)  # fmt: skip


def _files(folder: Path, choices: Choices) -> list[str]:
    """The files in a recipe of the corpus; random cases have none."""
    for name, data in choices.of("files", ({},)).items():
        (folder / name).write_bytes(base64.b64decode(data))
    return []


FAMILIES: dict[str, Callable[[Path, Choices], list[str]]] = {
    "log": _log, "table": _table, "config": _config, "criteria": _criteria, "lanes": _lanes, "dump": _dump,
    "files": _files,
}  # fmt: skip
WEIGHTED = ("log",) * 10 + ("table",) * 4 + ("dump",) * 4 + ("config", "criteria", "lanes")
