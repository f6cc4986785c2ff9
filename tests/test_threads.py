"""Replays in several threads: the same files, order and errors as with one thread; no partial files or threads stay."""

import errno
import random
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import polars as pl
import pytest

import roadperc_stream as rp
from roadperc_stream import loop
from roadperc_stream.chain import prepare
from roadperc_stream.cli.replay import main
from roadperc_stream.config import load_config
from roadperc_stream.errors import ConfigError, LogError, TargetError
from roadperc_stream.output import writing
from roadperc_stream.output.encoding import encode_image
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.system.pipeline import Pipeline
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
def test_progress_counts_the_frames_that_are_written(tmp_path, threads):
    source, seen = logs.write(tmp_path / "in.mcap", items_of()), []
    replay(source, tmp_path / "out.mcap", LIGHT, threads=threads, progress=lambda *numbers: seen.append(numbers))
    assert seen == [(k, FRAMES) for k in range(1, FRAMES + 1)]


@pytest.mark.parametrize("threads", [1, *THREADS])
@pytest.mark.parametrize(
    ("items", "words"),
    [
        (
            broken("detections", 4),
            rf"in\.mcap: /camera/front/detections: message at {logs.START_NS + 4 * STEP_NS} ns: ",
        ),
        (LOGS["broken image"](), str(BROKEN_NS)),
    ],
    ids=["no message", "no image"],
)
def test_an_error_in_reading_or_decoding_names_its_message(tmp_path, threads, items, words):
    source = logs.write(tmp_path / "in.mcap", items)
    with pytest.raises(LogError, match=words):
        replay(source, tmp_path / "out.mcap", CFG, strict=True, threads=threads)
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]
    assert threads_left() == []


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


@pytest.mark.parametrize("threads", THREADS)
def test_the_times_of_several_threads_add_up(tmp_path, threads):
    target = tmp_path / "out.mcap"
    replay(logs.write(tmp_path / "in.mcap", items_of()), target, CFG, threads=threads)
    times = pl.read_parquet(sidecar_path(target, "metrics")).select(TIME_COLUMNS)
    assert times.drop("total_ms").sum_horizontal().to_list() == pytest.approx(times["total_ms"].to_list())
    assert times.null_count().sum_horizontal().item() == 0, "each part has its time"
    assert times["decode_ms"].min() > 0


def test_the_command_and_the_api_take_a_number_of_threads(tmp_path, monkeypatch):
    source, seen = logs.write(tmp_path / "in.mcap", items_of(2)), []
    run = Pipeline.run
    monkeypatch.setattr(Pipeline, "run", lambda frames, threads: (seen.append(threads), run(frames, threads))[1])
    monkeypatch.setattr("roadperc_stream.api.usable_cores", lambda: 7)
    monkeypatch.setattr("roadperc_stream.cli.replay_log.usable_cores", lambda: 5)
    options = [str(source), str(tmp_path / "out.mcap"), "--quiet", "--force", "--only", "surface"]
    assert main(options) == 0
    assert main([*options, "--threads", "2"]) == 0
    rp.replay(source, tmp_path / "out.mcap", config=LIGHT, force=True)
    rp.replay(source, tmp_path / "out.mcap", config=LIGHT, force=True, threads=1)
    assert seen == [5, 2, 7, 1]


@pytest.mark.parametrize(
    ("threads", "error", "words"),
    [(wrong, TypeError, "expected a whole number of 1 or more") for wrong in ("x", 1.5, True)]
    + [(few, ConfigError, "expected 1 or more") for few in (0, -1)],
)
def test_threads_are_counted_in_whole_numbers_from_1_on(tmp_path, capsys, threads, error, words):
    with pytest.raises(error, match=f"threads: {threads!r}, {words}"):
        rp.replay(tmp_path / "in.mcap", tmp_path / "out.mcap", threads=threads)
    with pytest.raises(SystemExit) as end:
        main(["in.mcap", str(tmp_path / "out.mcap"), "--threads", str(threads)])
    assert end.value.code == 2
    assert "expected" in capsys.readouterr().err.partition("--threads: ")[2]


@pytest.mark.parametrize("threads", [1, *THREADS])
def test_an_unwritable_folder_is_one_error_with_the_output(tmp_path, monkeypatch, threads):
    """Removing the partial file fails too, without another error."""
    source, target = logs.write(tmp_path / "in.mcap", items_of(1)), tmp_path / "out" / "out.mcap"
    opened, removed = Path.open, Path.unlink

    def refusing(original):
        def refused(path, *arguments, **options):
            if path.parent == target.parent:
                raise OSError(errno.EROFS, "Read-only file system", str(path))
            return original(path, *arguments, **options)

        return refused

    monkeypatch.setattr(Path, "open", refusing(opened))
    monkeypatch.setattr(Path, "unlink", refusing(removed))
    with pytest.raises(TargetError, match=r"/out\.mcap: Read-only file system$"):
        replay(source, target, LIGHT, threads=threads)
