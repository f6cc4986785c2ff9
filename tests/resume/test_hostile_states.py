"""States from other files: a wrong type, shape or size gives one line."""

import struct
import zlib

import msgspec
import pytest
import zstandard

from roadperc_stream.chain import encoding
from roadperc_stream.chain.encoding import decode, encode
from roadperc_stream.errors import StateError
from roadperc_stream.resume.state import ReplayState, SavedState
from tests.chain.test_chain import drive, run


def packed(state):
    data = zstandard.compress(msgspec.msgpack.encode(state))
    return encoding._MAGIC + bytes([encoding.FORMAT_VERSION]) + struct.pack("<I", zlib.crc32(data)) + data


def grey(rows, columns):
    return {"dtype": "|u1", "shape": [rows, columns], "elements": bytes(rows * columns)}


def odometry(state):
    return state["replay"]["chain"]["odometry"]


@pytest.fixture(scope="module")
def plain():
    """The MessagePack of a state with a keyframe."""
    chain, _ = run(drive(2))
    return encoding._unpacked(encode(SavedState("", {}, ReplayState(chain)))[encoding._HEADER_BYTES :])


CASES = {
    "number for a map": (lambda s: s["replay"].update(chain=1), "Expected `object`, got `int`"),
    "without a field": (lambda s: s.pop("settings"), "missing required field `settings`"),
    "pose of one number": (lambda s: odometry(s).update(odom_T_ego=grey(1, 1)), "expected '<f8'"),
    "shape and bytes": (
        lambda s: odometry(s).update(odom_T_ego=grey(1, 1) | {"dtype": "<f8", "shape": [9, 9]}),
        "array of shape (9, 9)",
    ),
    "trajectory": (
        lambda s: s["replay"]["shown"].update(trajectory=[{"dtype": "<f8", "shape": [1], "elements": bytes(8)}]),
        "expected poses of shape (4, 4)",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_state_of_a_wrong_type_or_shape_gives_one_line(plain, case):
    change, expected = CASES[case]
    state = msgspec.msgpack.decode(plain)
    change(state)
    with pytest.raises(StateError) as caught:
        decode(packed(state), SavedState)
    assert expected in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
