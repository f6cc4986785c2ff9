"""States as bytes: exact, and of hostile bytes one error."""

import random
import struct
from contextlib import suppress
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import pytest
import zstandard
from numpy.typing import NDArray

from roadperc_stream.core.geometry import Float
from roadperc_stream.errors import StateError
from roadperc_stream.state import encoding
from roadperc_stream.state.encoding import FORMAT_VERSION, decode, encode


@dataclass(frozen=True)
class Thing:
    value: float
    pose: Float | None = None
    many: tuple[Float, ...] = ()
    anything: NDArray[np.uint8] | None = None
    name: str = ""


def bits(value):
    return struct.pack("<d", value)


@pytest.mark.parametrize("value", [0.1, -0.0, 5e-324, float("inf"), struct.unpack("<d", b"\x23\1\0\0\0\0\xf8\x7f")[0]])
def test_floats_keep_all_their_bits(value):
    array = np.array([[value, 1.0], [2.0, value]])
    found = decode(encode(Thing(value, array, (array, array[:1]))), Thing)
    assert bits(found.value) == bits(value)
    assert found.pose.tobytes() == array.tobytes()
    assert [a.shape for a in found.many] == [(2, 2), (1, 2)]
    assert not found.pose.flags.writeable


def test_equal_things_give_equal_bytes_once_and_again():
    data = encode(Thing(1.0, np.eye(4), name="ä"))
    assert encode(decode(data, Thing)) == data


def packed(plain):
    return encoding._MAGIC + bytes([FORMAT_VERSION]) + zstandard.compress(plain)


ARRAY = {"dtype": "<f8", "shape": [1], "data": b"\0" * 8}


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "is no state"),
        (b"PK\3\4 and so on", "is no state"),
        (encoding._MAGIC + b"\2abc", "version 2, expected 1"),
        (encoding._MAGIC + bytes([FORMAT_VERSION]) + b"\x28\xb5\x2f\xfdrubbish", "damaged"),
        (packed(b""), "damaged"),
        (packed(b"\x91" * 100_000), "damaged"),
        (packed(b"\xdd\xff\xff\xff\xff"), "damaged"),
        (packed(msgspec.msgpack.encode({"value": "1"})), "Expected `float`"),
        (packed(msgspec.msgpack.encode({"value": 1.0, "pose": {**ARRAY, "dtype": "|O"}})), "dtype '|O'"),
        (packed(msgspec.msgpack.encode({"value": 1.0, "pose": {**ARRAY, "dtype": "<f4"}})), "expected '<f8'"),
        (packed(msgspec.msgpack.encode({"value": 1.0, "pose": {**ARRAY, "shape": [2**40, 2**40]}})), "in 8 bytes"),
        (packed(msgspec.msgpack.encode({"value": 1.0, "pose": {**ARRAY, "shape": [-1]}})), "shape"),
        (packed(msgspec.msgpack.encode({"value": 1.0, "pose": [1.0]})), "damaged"),
    ],
)
def test_hostile_bytes_give_one_error(data, expected):
    with pytest.raises(StateError) as caught:
        decode(data, Thing)
    assert expected in str(caught.value)


def test_what_unpacks_to_more_than_a_state_may_have_is_refused(monkeypatch):
    monkeypatch.setattr(encoding, "MOST_BYTES", 1000)
    with pytest.raises(StateError, match="more than 1000 bytes"):
        decode(packed(b"\0" * 2000), Thing)
    with pytest.raises(StateError, match="at most 1000"):
        encode(Thing(1.0, name="x" * 2000))


def test_any_changed_byte_gives_a_thing_or_one_error():
    data = bytearray(encode(Thing(1.5, np.eye(4), (np.zeros(3),), np.zeros(4, np.uint8), "name")))
    rng = random.Random(1)
    for _ in range(2000):
        changed = bytearray(data)
        changed[rng.randrange(len(data))] = rng.randrange(256)
        with suppress(StateError):
            assert isinstance(decode(bytes(changed), Thing), Thing)


def test_numbers_of_numpy_are_plain_ones():
    assert decode(encode(replace(Thing(0.0), value=np.float64(0.1))), Thing) == Thing(0.1)
