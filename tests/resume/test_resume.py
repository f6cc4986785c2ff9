"""Checkpoints that are damaged, locked by another replay, or not a folder; and notes on them."""

import signal
import subprocess
import time
from random import Random

import pytest

from roadperc_stream.cli.replay import main
from roadperc_stream.config import load_config
from roadperc_stream.errors import StateError, TargetError
from roadperc_stream.resume.checkpoint import CheckpointFolder, checkpoint_folder
from tests import commands, logs
from tests.replaying import replay
from tests.resume.test_kills import CFG, EVERY, OUTPUTS, ROAD, SETTINGS, interrupt, names, same

RESUMED = {"checkpoint_every_s": 0.2, "resume": True}


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return logs.write(tmp_path_factory.mktemp("drive") / "in.mcap", logs.items(16, road=ROAD))


@pytest.fixture
def stopped(source, tmp_path):
    """An output whose replay was interrupted after a checkpoint."""
    target = tmp_path / "out.mcap"
    interrupt(source, target, 14)
    return target


@pytest.mark.parametrize("name", ["state", "frames"])
def test_a_flipped_bit_in_a_checkpoint_gives_one_error(source, stopped, name):
    path, rng = checkpoint_folder(stopped) / name, Random(1)
    data, written = path.read_bytes(), CheckpointFolder(stopped).read().length
    for bit in (rng.randrange(8 * (written if name == "frames" else len(data))) for _ in range(6)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        with pytest.raises(StateError, match="remove it to start over"):
            replay(source, stopped, CFG, **RESUMED)
        assert not stopped.exists()
    path.write_bytes(data[:100])
    with pytest.raises(StateError, match=r"\.out\.mcap\.checkpoint: .*remove it to start over"):
        replay(source, stopped, CFG, **RESUMED)


def test_a_second_replay_of_the_same_output_is_refused(source, tmp_path):
    target = tmp_path / "out.mcap"
    first = subprocess.Popen(commands.words("roadperc-replay", *words(source, target, "--resume", "--quiet")))
    while not (checkpoint_folder(target) / "state").exists():
        assert first.poll() is None
        time.sleep(0.001)
    first.send_signal(signal.SIGSTOP)
    try:
        for options in (RESUMED, {**RESUMED, "force": True}, {}):
            with pytest.raises(StateError, match=r"another replay writes the same output; wait until"):
                replay(source, target, CFG, **options)
    finally:
        first.kill()
        first.wait()
    replay(source, target, CFG, **RESUMED)
    replay(source, tmp_path / "direct.mcap", CFG)
    assert same(target, tmp_path / "direct.mcap"), "the lock ends with its process"
    assert not checkpoint_folder(target).exists()


@pytest.mark.parametrize("options", [RESUMED, {}])
def test_a_link_in_place_of_the_folder_is_one_error(source, tmp_path, options):
    (tmp_path / "victim").mkdir()
    (tmp_path / "victim" / "frames").write_bytes(b"theirs")
    checkpoint_folder(tmp_path / "out.mcap").symlink_to(tmp_path / "victim")
    with pytest.raises(StateError, match="checkpoint: not a folder; remove it to start over"):
        replay(source, tmp_path / "out.mcap", CFG, **options)
    assert (tmp_path / "victim" / "frames").read_bytes() == b"theirs"


def test_a_link_in_place_of_the_frames_is_not_written_through(source, stopped, tmp_path):
    path = checkpoint_folder(stopped) / "frames"
    path.rename(tmp_path / "victim")
    path.symlink_to(tmp_path / "victim")
    before = (tmp_path / "victim").read_bytes()
    with pytest.raises(TargetError, match="checkpoint: "):
        replay(source, stopped, CFG, **RESUMED)
    assert (tmp_path / "victim").read_bytes() == before


def test_a_plain_replay_removes_old_checkpoints_with_a_note(source, stopped):
    summary = replay(source, stopped, CFG)
    assert any("checkpoint: left by an interrupted replay; removed" in note for note in summary.notes)
    assert names(stopped.parent) == OUTPUTS


@pytest.mark.parametrize("table", OUTPUTS[1:2])
def test_an_output_with_another_table_is_not_complete(source, tmp_path, table):
    target = tmp_path / "out.mcap"
    replay(source, target, CFG)
    (tmp_path / table).write_bytes(b"junk")
    with pytest.raises(TargetError, match="exists; pass --force"):
        replay(source, target, CFG, **RESUMED)
    replay(source, target, CFG, **RESUMED, force=True)
    assert "nothing to do" in replay(source, target, CFG, **RESUMED).notes[0]


def words(source, target, *options):
    settings = [part for setting in SETTINGS for part in ("--set", setting)]
    return [str(source), str(target), *settings, *EVERY, *options]


def test_a_resumed_replay_reports_its_start(source, stopped, capsys):
    assert main(words(source, stopped, "--resume")) == 0
    said = capsys.readouterr().out.splitlines()
    (resumed,) = (line for line in said if line.startswith("resumed: "))
    before = int(resumed.split()[1])
    assert resumed == f"resumed: {before} of 16 frames were complete, up to {0.05 * (before - 1):.3f} s of the log"
    assert said[-2].startswith(f"{16 - before} frames in ")
    assert main(words(source, stopped, "--resume")) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[-2].endswith("out.mcap: already complete; nothing to do")
    assert said[-1].startswith("16 frames, log ")


def test_resume_with_force_replaces_an_older_output(source, tmp_path):
    """``--force`` does not discard the checkpoint of the same command."""
    target = tmp_path / "out.mcap"
    replay(source, target, load_config())
    interrupt(source, target, 14, force=True)
    resumed = replay(source, target, CFG, **RESUMED, force=True)
    assert resumed.frames_before > 0
