"""Encoded states keep all bits; hostile bytes give one error."""

import struct
import zlib
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import pytest
import zstandard
from numpy.typing import NDArray

from roadperc_stream.chain import encoding
from roadperc_stream.chain.encoding import FORMAT_VERSION, decode, encode
from roadperc_stream.errors import StateError
from roadperc_stream.geometry import Float


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


def test_equal_values_give_equal_bytes():
    data = encode(Thing(1.0, np.eye(4), name="ä"))
    assert encode(decode(data, Thing)) == data


def checked(data):
    """Bytes with a correct header."""
    return encoding._MAGIC + bytes([FORMAT_VERSION]) + struct.pack("<I", zlib.crc32(data)) + data


def packed(plain):
    return checked(zstandard.compress(plain))


ARRAY = {"dtype": "<f8", "shape": [1], "elements": b"\0" * 8}


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "not the state"),
        (b"PK\3\4 and so on", "not the state"),
        (encoding._MAGIC + b"\1abc", f"version 1, expected {FORMAT_VERSION}"),
        (encoding._MAGIC + bytes([FORMAT_VERSION]) + b"abc", "CRC is wrong"),
        (checked(b"\x28\xb5\x2f\xfdrubbish"), "damaged"),
        (packed(b""), "damaged"),
        (packed(b"\x91" * 100_000), "damaged"),
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


def test_an_oversized_unpacked_state_is_refused(monkeypatch):
    monkeypatch.setattr(encoding, "MOST_BYTES", 1000)
    with pytest.raises(StateError, match="more than 1000 bytes"):
        decode(packed(b"\0" * 2000), Thing)
    with pytest.raises(StateError, match="2046 bytes: expected 1000 at most"):
        encode(Thing(1.0, name="x" * 2000))


def test_any_flipped_bit_is_one_error():
    data = encode(Thing(1.5, np.eye(4), (np.zeros(3),), np.zeros(4, np.uint8), "name"))
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        with pytest.raises(StateError):
            decode(bytes(changed), Thing)


def test_numpy_scalars_become_numbers():
    assert decode(encode(replace(Thing(0.0), value=np.float64(0.1))), Thing) == Thing(0.1)
