"""Rendered drives of several kinds, and the tables of their replays."""

import shutil
from typing import NamedTuple

from roadperc_stream.cli import convert
from roadperc_stream.cli.replay import main as replay
from roadperc_stream.system.files import METRICS_SUFFIX
from roadperc_stream.tools.scene.job import render_dump
from roadperc_stream.tools.scene.options import RenderOptions

_SCENES = ("bend", "town")
KINDS = {
    "tags 2 %, depth 1 %": {"tag_noise": 0.02, "depth_noise": 0.01},
    "tags 5 %, depth 2 %": {"tag_noise": 0.05, "depth_noise": 0.02},
    "tags 10 %, depth 5 %": {"tag_noise": 0.10, "depth_noise": 0.05},
    "tags 20 %, depth 5 %": {"tag_noise": 0.20, "depth_noise": 0.05},
    "one camera, tags 5 %": {"tag_noise": 0.05, "without": ("depth",)},
    "lane change, tags 5 %": {"tag_noise": 0.05, "depth_noise": 0.02, "change_lane": "left"},
    "braking car, tags 5 %": {"tag_noise": 0.05, "depth_noise": 0.02, "lead_brakes": True},
}
"""Options of the renderer by the name in the table."""
SECONDS = 7.0


class Drive(NamedTuple):
    """A drive of a kind."""

    kind: str
    scene: str
    seed: int


def drives(kind, seeds):
    """The drives of a kind."""
    return [Drive(kind, scene, seed) for scene in _SCENES for seed in seeds]


def tables_of(folder, drive, settings=()):
    """The metrics table of a drive under some settings; it is made if it does not exist."""
    name = re_named(f"{drive.kind}_{drive.scene}_{drive.seed}")
    log = folder / f"{name}.mcap"
    if not log.exists():
        _render(folder / f"{name}_dump", log, drive)
    target = folder / (re_named(",".join(settings)) or "default") / f"{name}.mcap"
    table = target.with_name(f"{name}{METRICS_SUFFIX}")
    if not table.exists():
        target.parent.mkdir(exist_ok=True)
        sets = [text for item in settings for text in ("--set", item)]
        options = ["--threads", "1", "--results-only", "--quiet", "--force"]
        _require(replay([str(log), str(target), *options, *sets]), log)
        target.unlink()
    return table


def re_named(text):
    """A text as a file name."""
    return "".join(character if character.isalnum() or character in "_." else "_" for character in text)


def _render(dump, log, drive):
    asked = dict(KINDS[drive.kind])
    without = (*asked.pop("without", ()), "right")
    options = RenderOptions(
        width=640, height=360, scene=drive.scene, seed=drive.seed, seconds=SECONDS, rate_hz=10.0,
        path_truth=True, without=without, **asked,
    )  # fmt: skip
    render_dump(dump, options, force=True)
    _require(convert.main([str(dump), str(log), "--quiet", "--force"]), log)
    shutil.rmtree(dump)


def _require(code, log):
    if code != 0:
        raise RuntimeError(f"{log}: cannot be made")
