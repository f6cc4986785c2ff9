"""Replays in several threads: the same files, order and errors as with one thread; no partial files or threads stay."""

import random
import signal
import subprocess
import sys
import threading
import time
from functools import partial

import polars as pl
import pytest

from roadperc_stream import loop
from roadperc_stream.chain import prepare
from roadperc_stream.config import load_config
from roadperc_stream.output import writing
from roadperc_stream.output.encoding import encode_image
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.columns import TIME_COLUMNS
from tests import logs
from tests.analytic import STEP_NS, Road
from tests.replaying import replay

CFG = load_config(None, ("sync.max_wait_s=0.1",))
FEW_STAGES = ("stereo.method=off", "odometry.enabled=false", "lanes.enabled=false", "objects.enabled=false")
LIGHT = load_config(None, ("sync.max_wait_s=0.1", *FEW_STAGES))
TINY = Road(width=160, height=120)
THREADS = (2, 3, 5)
CHAIN = ("prepare", "step")
FRAMES = 5


def items_of(frames=FRAMES):
    return logs.items(frames, road=TINY)


def broken(role, frame, data=b"\xff\xff\xff"):
    """The items with an unreadable message."""
    stamp = logs.START_NS + frame * STEP_NS
    return [logs.Item(i.role, i.stamp_ns, data) if (i.role, i.stamp_ns) == (role, stamp) else i for i in items_of()]


def without(role):
    return [item for item in items_of() if item.role != role]


def twice():
    """The same items twice: the stamps step back."""
    return [*items_of(3), *items_of(3)]


BROKEN_NS = logs.START_NS + 3 * STEP_NS
NO_IMAGE = encode_image(BROKEN_NS, "camera", "png", b"no")
LOGS = {
    "whole": items_of,
    "without depth": partial(without, "depth"),
    "without tags": partial(without, "segmentation"),
    "without detections": partial(without, "detections"),
    "stamps step back": twice,
    "broken detections": partial(broken, "detections", 2),
    "broken image": partial(broken, "image", 3, NO_IMAGE),
    "one frame": partial(items_of, 1),
}


def jittered(monkeypatch, seed):
    """Delay every step of every frame at random."""
    rng = random.Random(seed)

    def slow(function):
        def slowed(*arguments):
            time.sleep(rng.random() * 0.005)
            return function(*arguments)

        return slowed

    for step in CHAIN:
        monkeypatch.setattr(loop, step, slow(getattr(loop, step)))
    monkeypatch.setattr(loop, "frame_metrics", slow(loop.frame_metrics))


def tables(target):
    """Both tables without times."""
    kinds = {kind: pl.read_parquet(sidecar_path(target, kind)) for kind in ("metrics", "objects")}
    return kinds["metrics"].drop(TIME_COLUMNS), kinds["objects"]


def threads_left():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("roadperc")]


@pytest.mark.parametrize("kind", LOGS)
def test_the_files_are_those_of_one_thread(tmp_path, monkeypatch, kind):
    source = logs.write(tmp_path / "in.mcap", LOGS[kind](), [logs.foreign()])
    one = replay(source, tmp_path / "one.mcap", CFG)
    for threads in THREADS:
        jittered(monkeypatch, threads)
        target = tmp_path / f"{threads}.mcap"
        summary = replay(source, target, CFG, threads=threads)
        assert target.read_bytes() == (tmp_path / "one.mcap").read_bytes()
        for found, expected in zip(tables(target), tables(tmp_path / "one.mcap"), strict=True):
            assert found.equals(expected)
        for said in ("log_id", "frames", "messages_out", "notes", "dropped", "problems", "throughout"):
            assert getattr(summary, said) == getattr(one, said), said


@pytest.mark.parametrize("threads", THREADS)
def test_a_resumed_replay_has_the_files_of_an_uninterrupted_one(tmp_path, threads):
    source, target = logs.write(tmp_path / "in.mcap", items_of(14)), tmp_path / "out.mcap"
    replay(source, tmp_path / "whole.mcap", LIGHT)

    def stop(done, _):
        if done == 11:
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        replay(source, target, LIGHT, checkpoint_every_s=0.2, progress=stop, threads=threads)
    assert threads_left() == []
    summary = replay(source, target, LIGHT, checkpoint_every_s=0.2, resume=True, threads=threads)
    assert 5 <= summary.frames_before <= 11
    assert target.read_bytes() == (tmp_path / "whole.mcap").read_bytes()


@pytest.mark.parametrize("threads", [1, *THREADS])
@pytest.mark.parametrize("step", [*CHAIN, "write"])
def test_an_error_in_any_step_ends_the_replay_and_leaves_nothing(tmp_path, monkeypatch, threads, step):
    source, calls = logs.write(tmp_path / "in.mcap", items_of()), []

    def failing(function):
        def called(*arguments):
            calls.append(step)
            if len(calls) == 4:
                raise MemoryError(step)
            return function(*arguments)

        return called

    if step == "write":
        monkeypatch.setattr(writing.Outputs, "write", failing(writing.Outputs.write))
    else:
        monkeypatch.setattr(loop, step, failing(getattr(loop, step)))
    with pytest.raises(MemoryError, match=step):
        replay(source, tmp_path / "out.mcap", LIGHT, threads=threads)
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]
    assert threads_left() == []


@pytest.mark.parametrize(("number", "threads"), [(signal.SIGTERM, 2), (signal.SIGINT, 3), (signal.SIGTERM, 1)])
def test_a_signal_leaves_only_the_checkpoint_and_prints_how_to_continue(tmp_path, number, threads):
    source, target = logs.write(tmp_path / "in.mcap", items_of(50)), tmp_path / "out.mcap"
    command = [sys.executable, "-c", "import sys; from roadperc_stream.cli.launch import replay; sys.exit(replay())"]
    options = ["--threads", str(threads), "--checkpoint-every", "0.2", "--set", "sync.max_wait_s=0.1"]
    process = subprocess.Popen(
        [*command, str(source), str(target), *options, "--only", "surface"], stderr=subprocess.PIPE, text=True
    )
    state = tmp_path / ".out.mcap.checkpoint" / "state"
    while process.poll() is None and not state.exists():  # some frames are done then, and many are to come
        time.sleep(0.01)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    expected = "error: interrupted; run the same command with --resume to continue from the last checkpoint\n"
    assert (process.returncode, err) == (1, expected)
    assert {path.name for path in tmp_path.iterdir()} == {"in.mcap", ".out.mcap.checkpoint"}


def test_the_times_of_one_thread_add_up(tmp_path, monkeypatch):
    """With a clock that only the steps move, each by another time."""
    now_s = [0.0]

    def taking(milliseconds, function):
        def worked(*arguments, **options):
            now_s[0] += milliseconds / 1000
            return function(*arguments, **options)

        return worked

    monkeypatch.setattr(loop, "perf_counter", lambda: now_s[0])
    monkeypatch.setattr(prepare, "_with_depth", taking(3, prepare._with_depth))
    monkeypatch.setattr(loop, "frame_metrics", taking(5, loop.frame_metrics))
    monkeypatch.setattr(writing.MessageCopy, "through", taking(7, writing.MessageCopy.through))
    monkeypatch.setattr(writing.Outputs, "_messages", taking(11, writing.Outputs._messages))
    monkeypatch.setattr(writing.Outputs, "_write_messages", taking(13, writing.Outputs._write_messages))
    target = tmp_path / "out.mcap"
    replay(logs.write(tmp_path / "in.mcap", items_of()), target, LIGHT)

    times = pl.read_parquet(sidecar_path(target, "metrics")).select(TIME_COLUMNS)
    expected = {"decode_ms": 3, "metrics_ms": 5, "copy_ms": 7, "encode_ms": 11, "write_ms": 13, "total_ms": 39}
    for column, milliseconds in expected.items():
        assert times[column].to_list() == pytest.approx([milliseconds] * FRAMES), column
    parts = times.drop("total_ms").sum_horizontal()
    assert parts.to_list() == pytest.approx(times["total_ms"].to_list())
