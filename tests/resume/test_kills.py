"""A replay that is killed at any moment is resumed, and gives the same files."""

import os
import random
import signal
import time
from dataclasses import replace

import polars as pl
import pytest

from roadperc_stream.config import load_config
from roadperc_stream.errors import StateError, TargetError
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.output.writing import FrameOutput
from roadperc_stream.resume.checkpoint import Checkpoint, CheckpointFolder, checkpoint_folder
from roadperc_stream.resume.state import ReplayState
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.schemas.columns.places import FramePlaces
from tests import logs
from tests.commands import run_forked
from tests.replaying import replay

pytestmark = pytest.mark.long

SETTINGS = ("sync.max_wait_s=0.1",)
CFG = load_config(None, SETTINGS)
ROAD = replace(logs.SMALL, width=96, height=72)
EVERY = ("--checkpoint-every", "0.2")
KILLS = int(os.environ.get("KILLS", "100"))


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return logs.write(tmp_path_factory.mktemp("drive") / "in.mcap", logs.items(24, road=ROAD))


@pytest.fixture(scope="module")
def undisturbed(source):
    replay(source, source.with_name("whole.mcap"), CFG)
    return source.with_name("whole.mcap")


def killed_replay(source, target, *options, kill_before=0, kill_after_s=0.0):
    settings = [part for setting in SETTINGS for part in ("--set", setting)]
    return run_forked(
        "tests.resume.killed", kill_before, kill_after_s, "replay", source, target, *settings, *EVERY, *options
    )


def same(target, expected):
    """Return whether all three files are equal, except for times and file names in the tables."""
    if target.read_bytes() != expected.read_bytes():
        return False
    rows, wanted = (pl.read_parquet(sidecar_path(path, "metrics")) for path in (target, expected))
    times = [name for name in rows.columns if name.endswith("_ms") and name != "sync_skew_ms"]
    objects = (pl.read_parquet(sidecar_path(path, "objects")) for path in (target, expected))
    return rows.drop(times).equals(wanted.drop(times)) and next(objects).equals(next(objects))


def names(folder):
    return sorted(path.name for path in folder.iterdir())


LITTLE = FrameOutput(FrameMetrics("log", 0, 0), (), FramePlaces())
OUTPUTS = ["out.mcap", "out.metrics.parquet", "out.objects.parquet"]


@pytest.mark.parametrize("kill_before", [9, 16, 23])
def test_a_replay_killed_before_a_rename_is_resumed(source, undisturbed, tmp_path, kill_before):
    """While a checkpoint is written, while the outputs are renamed, while checkpoints are removed."""
    target = tmp_path / "out.mcap"
    killed = killed_replay(source, target, kill_before=kill_before)
    assert killed.returncode == -signal.SIGKILL
    replay(source, target, CFG, checkpoint_every_s=0.2, resume=True)
    assert same(target, undisturbed)
    assert names(tmp_path) == OUTPUTS


@pytest.mark.accuracy
def test_a_hundred_kills_at_random_moments(source, undisturbed, tmp_path):
    """``KILLS`` sets the number; ``make kills`` runs it."""
    target, rng, killed, completed = tmp_path / "out.mcap", random.Random(1), 0, 0
    started_s = time.process_time()
    replay(source, target, CFG, checkpoint_every_s=0.2)
    takes_s = time.process_time() - started_s
    while killed < KILLS or completed < KILLS // 3:
        kill_after_s = rng.choice((0.0, *(rng.uniform(0.01, 1.2) * takes_s for _ in range(2))))
        done = killed_replay(source, target, "--resume", "--quiet", kill_after_s=kill_after_s)
        if done.returncode == -signal.SIGPROF:
            killed += 1
            continue
        assert (done.returncode, done.stderr) == (0, "")
        assert same(target, undisturbed)
        assert names(tmp_path) == OUTPUTS
        completed += 1
        for name in OUTPUTS:
            (tmp_path / name).unlink()
    print(f"{killed} kills, {completed} replays completed, each the same files")


class StoppedError(Exception):
    pass


def interrupt(source, target, at, cfg=CFG, **options):
    def stop(done, _):
        if done == at:
            raise StoppedError

    with pytest.raises(StoppedError):
        replay(source, target, cfg, checkpoint_every_s=0.2, progress=stop, **options)


def test_a_resumed_replay_computes_only_the_rest(source, undisturbed, tmp_path, monkeypatch):
    target, computed = tmp_path / "out.mcap", []
    interrupt(source, target, 15)
    assert names(tmp_path) == [".out.mcap.checkpoint"]
    from roadperc_stream import loop  # noqa: PLC0415 - to watch what it runs

    measure = loop.frame_metrics
    monkeypatch.setattr(loop, "frame_metrics", lambda *a: (computed.append(a[2].index), measure(*a))[1])
    summary = replay(source, target, CFG, checkpoint_every_s=0.2, resume=True)
    assert summary.frames == 24
    assert 10 <= computed[0] <= 15
    assert computed == list(range(computed[0], 24))
    assert same(target, undisturbed)
    assert names(tmp_path) == OUTPUTS


@pytest.mark.parametrize("every_s", [0.01, 100.0])
def test_the_files_do_not_depend_on_the_checkpoints(source, undisturbed, tmp_path, every_s):
    replay(source, tmp_path / "out.mcap", CFG, checkpoint_every_s=every_s)
    assert same(tmp_path / "out.mcap", undisturbed)
    assert names(tmp_path) == OUTPUTS


def test_a_checkpoint_is_kept_without_resume_or_force(source, undisturbed, tmp_path):
    target = tmp_path / "out.mcap"
    interrupt(source, target, 15)
    with pytest.raises(StateError, match=r"left by an interrupted replay; pass --resume or --force \(start over\)"):
        replay(source, target, CFG, checkpoint_every_s=0.2)
    replay(source, target, CFG, checkpoint_every_s=0.2, force=True)
    assert same(target, undisturbed)


def test_a_checkpoint_of_another_replay_is_refused(source, tmp_path):
    target = tmp_path / "out.mcap"
    interrupt(source, target, 15)
    other = load_config(None, (*SETTINGS, "lanes.hold_s=0.3"))
    with pytest.raises(StateError, match=r"of another replay \(lanes.hold_s differ\)"):
        replay(source, target, other, checkpoint_every_s=0.2, resume=True)
    shorter = logs.write(tmp_path / "shorter.mcap", logs.items(20, road=ROAD))
    with pytest.raises(StateError, match=r"of another replay \(input differ\)"):
        replay(shorter, target, CFG, checkpoint_every_s=0.2, resume=True)
    replay(shorter, target, CFG, checkpoint_every_s=0.2, resume=True, force=True)
    replay(shorter, tmp_path / "direct.mcap", CFG)
    assert same(target, tmp_path / "direct.mcap")


@pytest.mark.parametrize(
    ("cfg", "options"), [(load_config(), {}), (CFG, {"results_only": True}), (CFG, {"on_request": ("overlay",)})]
)
def test_a_finished_replay_with_other_options_is_not_complete(source, tmp_path, cfg, options):
    target = tmp_path / "out.mcap"
    replay(source, target, CFG)
    with pytest.raises(TargetError, match="--force"):
        replay(source, target, cfg, checkpoint_every_s=9, resume=True, **options)


@pytest.mark.parametrize("named", [1, 2])
def test_a_replay_killed_between_renames_is_resumed(source, undisturbed, tmp_path, named):
    """The tables are renamed before the log."""
    target = tmp_path / "out.mcap"
    replay(source, target, CFG)
    checkpoint_folder(target).mkdir()
    for name in OUTPUTS[: 3 - named]:
        (tmp_path / name).unlink()
    replay(source, target, CFG, checkpoint_every_s=9, resume=True)
    assert same(target, undisturbed)
    assert names(tmp_path) == OUTPUTS


def test_a_resumed_checkpoint_has_the_right_length(tmp_path):
    """Frames after the last checkpoint are computed again, perhaps with fewer bytes."""
    checkpoint = Checkpoint({}, ReplayState())
    with CheckpointFolder(tmp_path / "out.mcap") as folder:
        folder.begin(None)
        folder.append(LITTLE)
        folder.write(replace(checkpoint, samples=1))
        folder.append(LITTLE)
    with CheckpointFolder(tmp_path / "out.mcap") as again:
        again.begin(again.read())
        again.append(LITTLE)
        again.write(replace(checkpoint, samples=2))
    assert len(list(again.outputs(again.read()))) == 2


def test_a_checkpoint_of_other_frames_is_an_error(source, tmp_path):
    target = tmp_path / "out.mcap"
    interrupt(source, target, 15)
    path = checkpoint_folder(target) / "frames"
    data = path.read_bytes()
    length = 8 + int.from_bytes(data[:8], "little")
    path.write_bytes(data[length:] + data[:length])
    with pytest.raises(StateError, match="does not hold frame 0; remove it to start over"):
        replay(source, target, CFG, checkpoint_every_s=0.2, resume=True)


def test_without_checkpoints_an_interrupted_replay_leaves_nothing(source, tmp_path):
    def stop(done, _):
        if done == 15:
            raise StoppedError

    with pytest.raises(StoppedError):
        replay(source, tmp_path / "out.mcap", CFG, progress=stop)
    assert names(tmp_path) == []
    interrupt(source, tmp_path / "out.mcap", 2)
    assert names(tmp_path) == [], "interrupted before its first checkpoint"


def test_pictures_and_counts_are_resumed(source, tmp_path):
    cfg, target = CFG, tmp_path / "out.mcap"
    interrupt(source, target, 15, on_request=("overlay",))
    resumed = replay(source, target, cfg, checkpoint_every_s=0.2, resume=True, on_request=("overlay",))
    direct = replay(source, tmp_path / "direct.mcap", cfg, on_request=("overlay",))
    assert target.read_bytes() == (tmp_path / "direct.mcap").read_bytes()
    assert (resumed.throughout, resumed.notes) == (direct.throughout, direct.notes)
