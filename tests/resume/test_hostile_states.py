"""States from untrusted files: a wrong type, shape or size gives one line and is not allocated."""

import math
import struct
import subprocess
import sys
import time
import zlib
from dataclasses import replace

import msgspec
import pytest
import zstandard

from roadperc_stream import log
from roadperc_stream.chain import encoding
from roadperc_stream.config import load_config
from roadperc_stream.errors import StateError
from roadperc_stream.resume.state import state_at_end
from roadperc_stream.schemas.record import BEGIN_ATTACHMENT, STATE_ATTACHMENT
from tests import logs
from tests.replaying import replay
from tests.resume.parts import cut, inputs, replayed, with_attachments, write

CFG = load_config(None, ("sync.max_wait_s=0.2",))
ROAD = replace(logs.SMALL, width=96, height=72)
MOST_GROWTH_MB, SLOWEST_S = 430, 6.0


MEASURED = """
import sys
from pathlib import Path
from roadperc_stream.config import load_config
from roadperc_stream.errors import StateError
from roadperc_stream.resume.state import state_at_end
def peak():  # ru_maxrss counts the parent too
    return int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
before = peak()
try:
    state_at_end(Path(sys.argv[1]), load_config(None, ("sync.max_wait_s=0.2",)))
except StateError as error:
    print(error)
print(before, peak())
"""


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    whole = logs.write(folder / "whole.mcap", logs.items(16, road=ROAD))
    messages = inputs(whole)
    return replayed(folder, cut(messages, [messages[0].log_time_ns + 500_000_000]), CFG)


def packed(state):
    data = zstandard.compress(msgspec.msgpack.encode(state))
    return encoding._MAGIC + bytes([encoding.FORMAT_VERSION]) + struct.pack("<I", zlib.crc32(data)) + data


def unpacked(path, name):
    (data,) = (item.data for item in log.summarise(path).attachments if item.name == name)
    return msgspec.msgpack.decode(encoding._unpacked(data[encoding._HEADER_BYTES :]))


def changed(source, target, name, change):
    """A copy of a result whose decoded state is changed by ``change``."""
    state = unpacked(source, name)
    change(state)
    return with_attachments(source, target, **{name: packed(state)})


def grey(rows, columns):
    return {"dtype": "|u1", "shape": [rows, columns], "elements": bytes(rows * columns)}


def edges(tree, number):
    edge = next(iter(tree["edges"].values()))
    for k in range(number):
        tree["edges"][f"f{k}"] = {**edge, "parent": f"f{k - 1}" if k else "ego", "child": f"f{k}"}


def odometry(state):
    return state["replay"]["chain"]["odometry"]


def keyframe(state):
    return odometry(state)["keyframe"]


def landmarks(state):
    return keyframe(state)["landmarks"]


def floats(*shape):
    return {"dtype": "<f8", "shape": list(shape), "elements": bytes(8 * math.prod(shape))}


def long_tree(state):
    edges(state["input"]["arrived"], 3000)


def looped(state):
    tree = state["input"]["pairing"]["latched"]["tree"]
    edge = next(iter(tree["edges"].values()))
    tree["edges"] |= {"a": {**edge, "parent": "b", "child": "a"}, "b": {**edge, "parent": "a", "child": "b"}}


def large_camera(state):
    for camera in state["input"]["pairing"]["latched"]["cameras"].values():
        camera.update(width=40_000, height=40_000)


def wrong_transform(state):
    next(iter(state["input"]["arrived"]["edges"].values())).update(parent_T_child=floats(1, 1))


CASES = {
    "text for a number": (lambda s: s["input"]["numbers"].update(next="1"), "Expected `int`, got `str`"),
    "number for an array": (lambda s: keyframe(s).update(grey=1), "Expected `object`, got `int`"),
    "array of another type": (
        lambda s: landmarks(s)["features"].update(px=grey(1, 2)),
        "array of dtype '|u1', expected '<f4'",
    ),
    "without a field": (lambda s: s.pop("input"), "missing required field `input`"),
    "image of another size": (lambda s: keyframe(s).update(grey=grey(1, 1)), "grey: expected uint8 (72, 96)"),
    "fewer points": (lambda s: landmarks(s).update(points_m=floats(1, 3)), "points_m: expected float64 ("),
    "fewer pixels": (lambda s: odometry(s)["last"].update(influence=floats(1, 6)), "influence: expected float64 ("),
    "pose of one number": (
        lambda s: odometry(s).update(odom_T_ego=floats(1, 1)),
        "odom_T_ego: expected float64 (4, 4",
    ),
    "trajectory": (lambda s: s["replay"]["shown"].update(trajectory=[floats(4)]), "expected poses of shape (4, 4)"),
    "camera": (large_camera, "of 40000x40000, 1600 megapixels: expected limits.image_megapixels 40"),
    "3000 transforms": (long_tree, "transforms: expected a tree of at most 2000"),
    "loop": (looped, "transforms: expected a tree of at most 2000"),
    "role": (lambda s: s["input"]["topics"].update({"nothing": "/a"}), "unknown roles nothing"),
    "transform": (wrong_transform, "parent_T_child: expected float64 (4, 4)"),
}


@pytest.mark.promise("States", "A state with a wrong type or shape, or above `limits`, gives a one-line error")
@pytest.mark.parametrize("case", CASES)
def test_a_state_of_a_wrong_type_shape_or_size_gives_one_line(parts, tmp_path, case):
    change, expected = CASES[case]
    before = changed(parts[0], tmp_path / "before.mcap", STATE_ATTACHMENT, change)
    started_s = time.process_time()
    with pytest.raises(StateError) as caught:
        state_at_end(before, CFG)
    assert time.process_time() - started_s < SLOWEST_S
    assert expected in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.promise("States", "A replay without `--continue` also refuses a damaged state")
def test_a_plain_replay_refuses_an_invalid_state(parts, tmp_path):
    source = changed(
        parts[1], tmp_path / "in.mcap", BEGIN_ATTACHMENT, lambda state: keyframe(state).update(grey=grey(1, 1))
    )
    with pytest.raises(StateError, match=r"roadperc\.state\.begin: damaged: grey: .*; replay its input again"):
        replay(source, tmp_path / "out.mcap", CFG)
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


@pytest.mark.promise("States", "A state whose frame numbers would overflow is refused before the first frame")
@pytest.mark.parametrize("part", [0, 1])
def test_overflowing_frame_numbers_are_refused(parts, tmp_path, part):
    """In a continued replay, and in a replay of the result."""
    name = (STATE_ATTACHMENT, BEGIN_ATTACHMENT)[part]
    hostile = changed(parts[part], tmp_path / "in.mcap", name, lambda s: s["input"]["numbers"].update(next=2**32 - 3))
    source, continued = (parts[1], hostile) if part == 0 else (hostile, None)
    with pytest.raises(StateError, match=r"frame 4294967293 and \d+ more: a log numbers 4294967296 at most"):
        replay(source, tmp_path / "out.mcap", CFG, continued=continued)


@pytest.mark.promise("States", "Nothing is allocated beyond the limits")
def test_declared_sizes_are_not_allocated(parts, tmp_path):
    """An array of 400 MB must not be decoded."""
    path = changed(
        parts[0], tmp_path / "before.mcap", STATE_ATTACHMENT, lambda s: keyframe(s).update(grey=grey(20_000, 20_000))
    )
    words = [sys.executable, "-c", MEASURED, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60)
    said, before_kb, peak_kb = done.stdout.rsplit(maxsplit=2)
    assert "at most" in said
    assert int(peak_kb) - int(before_kb) < MOST_GROWTH_MB * 1024, (before_kb, peak_kb)


def test_a_result_is_continued_with_its_own_limits(tmp_path, parts):
    """A state within the limits of a replay is read with the same limits."""
    cfg = load_config(None, ("sync.max_wait_s=0.2", "limits.image_megapixels=0.01"))
    source = inputs(parts[0])
    made = replayed(tmp_path, cut(source, [source[0].log_time_ns + 300_000_000]), cfg)
    assert len(made) == 2
    with pytest.raises(StateError, match=r"limits\.image_megapixels was 0\.01, is 40"):
        replay(write(tmp_path / "x.mcap", source[-5:]), tmp_path / "y.mcap", CFG, continued=made[0])
