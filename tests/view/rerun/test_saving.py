"""The pipe between Rerun's SDK and a file."""

import pytest
import rerun as rr

from roadperc_stream.view.rerun.viewer import saving
from tests.view.rerun.chunks import recorded


@pytest.fixture
def recording():
    return rr.RecordingStream("test")


def log(recording, values):
    for k in range(values):
        recording.set_time("message_log_time", sequence=k)
        recording.log("value", rr.TextLog(f"{k:04} " * 100))


def test_the_pipe_passes_a_whole_recording(recording, tmp_path):
    target = tmp_path / "out.rrd"
    with saving(recording, target) as check:
        log(recording, 500)
        recording.flush()
        check()
    assert recorded(target)["/value"].column("TextLog:text") == [[f"{k:04} " * 100] for k in range(500)]
    assert b"FOOT" in target.read_bytes()[-16:]  # the index, without which a viewer reads the whole file


def save_and_fail(recording, target):
    with saving(recording, target):
        log(recording, 500)
        raise KeyError(target)


def test_an_error_in_the_block_closes_the_pipe(recording, tmp_path):
    with pytest.raises(KeyError):
        save_and_fail(recording, tmp_path / "out.rrd")


def save_for_ever(recording, target):
    with saving(recording, target) as check:
        while True:
            log(recording, 100)
            recording.flush()
            check()


def test_an_unwritable_file_is_an_error_during_the_export(recording, tmp_path):
    with pytest.raises(IsADirectoryError):
        save_for_ever(recording, tmp_path)


def test_a_pipe_that_the_sdk_cannot_open_is_an_error(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "save", lambda _path: (_ for _ in ()).throw(RuntimeError("no")))
    with pytest.raises(OSError, match="no"), saving(recording, tmp_path / "out.rrd"):
        pytest.fail("nothing can be logged")
