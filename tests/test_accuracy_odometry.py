"""Errors of odometry in replays of a rendered town, by depth source.

The poses come from the result's topic, the truth from the input. ``make accuracy-long`` runs the long forms at full
size over 20 s; `make test-long` runs a short form.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import polars as pl
import pytest

from roadperc_stream import log
from roadperc_stream.cli import convert, render
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.geometry import inverse
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.log import LogWriter
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.roles import ROLES
from tests.chain.stages.odometry.trajectories import aligned_errors_m, distances_m, relative_errors

pytestmark = pytest.mark.long

STAGES = "stereo,surface,odometry"
"""Odometry and the stages that it needs."""
WITHOUT_DEPTH = ("depth", "truth_depth")
MONO = (*WITHOUT_DEPTH, "right", "right_calibration")


@dataclass(frozen=True)
class Case:
    """The roles missing from the log, a setting of the replay, and the limits of the errors.

    ``road`` is the source of the road plane after the first frame. ``shift`` is a share of the distance,
    ``turn`` in degrees per 100 m, ``shape`` a share of the length after a similarity alignment.
    """

    missing: tuple[str, ...]
    setting: str
    road: str | None
    shift: float = np.inf
    turn: float = np.inf
    shape: float = 0.02


CASES = {
    "depth": Case((), "stereo.method=off", "depth", shift=0.01, turn=0.5),
    "stereo fast": Case(WITHOUT_DEPTH, "stereo.method=fast", "stereo", shift=0.02, turn=0.5),
    "stereo full": Case(WITHOUT_DEPTH, "stereo.method=full", "stereo", shift=0.02, turn=0.5),
    "mono, mounted": Case(MONO, "surface.enabled=true", "estimated", shift=0.03),
    "mono, no scale": Case(MONO, "surface.enabled=false", None),
}


LENGTHS = {
    "short": (("--seconds", "1.2", "--size", "640x480"), (5, 10)),
    "long": (("--seconds", "20"), (25, 50, 100)),
}
"""Options of the drive, and the lengths in metres of the error segments."""


def town(folder, *options):
    """Render the town and convert it to a log."""
    assert render.main([str(folder / "dump"), "--scene", "town", *options]) == 0
    assert convert.main([str(folder / "dump"), str(folder / "in.mcap"), "--quiet"]) == 0
    return folder / "in.mcap"


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """The log of the short or the long drive, rendered once."""
    return cache(lambda length: town(tmp_path_factory.mktemp(length), *LENGTHS[length][0]))


def without(source, target, roles):
    """Write the log without the topics of some roles."""
    topics = {ROLES[role].topic for role in roles}
    with LogWriter(target) as writer:
        for message in log.read(log.summarise(source)):
            if message.channel.topic not in topics:
                writer.write(message)
    return target


def poses(path, topic):
    """(N, 4, 4) poses relative to the first, and the (N,) stamps."""
    decoded = [
        decode("pose", m.channel.schema_name, m.channel.message_encoding, m.data, m.log_time_ns, Context())
        for m in log.read(log.summarise(path), topics=[topic])
    ]
    matrices = np.array([d.payload.parent_T_child for d in decoded])
    return inverse(matrices[0]) @ matrices, [d.stamp_ns for d in decoded]


@pytest.mark.parametrize(("length", "name"), [
    *(("short", name) for name in CASES if name != "stereo full"),
    *(pytest.param("long", name, marks=pytest.mark.accuracy) for name in CASES),
])  # fmt: skip
def test_town(tmp_path, drives, length, name):
    case, source, target = CASES[name], drives(length), tmp_path / "out.mcap"
    seen = without(source, tmp_path / "in.mcap", case.missing)
    options = ("--quiet", "--results-only", "--only", STAGES, "--set", case.setting)
    assert replay_main([str(seen), str(target), *options]) == 0
    metrics = pl.read_parquet(sidecar_path(target, "metrics"))
    assert metrics["odometry_status"].to_list() == ["first"] + ["tracked"] * (metrics.height - 1)
    assert set(metrics["surface_source"][1:]) == {case.road}
    (estimated, stamps), (true, true_stamps) = poses(target, "/perception/odometry"), poses(source, "/truth/pose")
    assert stamps == true_stamps
    shift, turn = relative_errors(estimated, true, LENGTHS[length][1])
    shape = np.sqrt(np.mean(aligned_errors_m(estimated, true) ** 2)) / distances_m(true)[-1]
    print(
        f"\ntown, {name}: {len(true)} frames, {distances_m(true)[-1]:.1f} m: {shift:.3%} of the distance, "
        f"{turn:.3f} deg/100 m; {shape:.3%} of the length after alignment; {metrics['step_m'].count()} steps metric"
    )
    assert shift < case.shift
    assert turn < case.turn
    assert shape < case.shape
