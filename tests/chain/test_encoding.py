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
from roadperc_stream.chain.bounds import StateBounds, require_bounded
from roadperc_stream.chain.encoding import FORMAT_VERSION, decode, encode
from roadperc_stream.config import LimitsConfig
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


def test_the_depth_of_the_largest_image_is_within_the_bounds():
    limits = LimitsConfig(image_megapixels=1)
    depth = Thing(1.0, anything=np.zeros(4_000_000, np.uint8))
    assert decode(encode(depth), Thing, StateBounds.of(limits)).anything.size == 4_000_000


def checked(data):
    """Bytes with a correct header."""
    return encoding._MAGIC + bytes([FORMAT_VERSION]) + struct.pack("<I", zlib.crc32(data)) + data


def packed(plain):
    return checked(zstandard.compress(plain))


ARRAY = {"dtype": "<f8", "shape": [1], "elements": b"\0" * 8}
MANY = struct.pack(">I", 10_000_000)


@pytest.mark.promise("States", "A damaged or foreign state gives one error")
@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "not the state"),
        (b"PK\3\4 and so on", "not the state"),
        (encoding._MAGIC + b"\1abc", f"version 1, expected {FORMAT_VERSION}"),
        (encoding._MAGIC + bytes([FORMAT_VERSION]) + b"abc", "CRC is wrong"),
        (checked(b"\x28\xb5\x2f\xfdrubbish"), "damaged"),
        (packed(b""), "damaged"),
        (packed(b"\x91" * 100_000), "nested more than 64"),
        (packed(b"\xdd\xff\xff\xff\xff"), "items: expected"),
        (packed(b"\xdd" + MANY + b"\0" * 10_000_000), "items: expected"),
        (packed(b"\xdf" + MANY), "items: expected"),
        (packed(msgspec.msgpack.encode({**ARRAY, "elements": b"\0" * 200_000_000})), "array of 200000000 bytes: exp"),
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


@pytest.mark.promise("States", "Any flipped bit in a state gives one error")
def test_any_flipped_bit_is_one_error():
    data = encode(Thing(1.5, np.eye(4), (np.zeros(3),), np.zeros(4, np.uint8), "name"))
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        with pytest.raises(StateError):
            decode(bytes(changed), Thing)


def test_every_kind_of_item_is_counted():
    """The allowed number of items is read, one more is refused."""
    things = [None, True, 5, -5, 300, -300, 2**17, -(2**17), 2**40, -(2**40), 0.5, "a", "a" * 40, "a" * 300, b"a"]
    things += [b"a" * 300, "a" * 70_000, b"a" * 70_000, [], [1, 2], {}, {"a": 1}, [0] * 20, [0] * 70_000]
    things += [{str(k): k for k in range(20)}, msgspec.msgpack.Ext(1, b"abcd"), msgspec.msgpack.Ext(1, b"abc")]

    def count(item):
        if isinstance(item, dict):
            return 1 + sum(1 + count(value) for value in item.values())
        return 1 + sum(map(count, item)) if isinstance(item, list) else 1

    plain, items = msgspec.msgpack.encode(things), count(things)
    require_bounded(plain, StateBounds(items, 100))
    with pytest.raises(StateError, match=f"more than {items - 1} items"):
        require_bounded(plain, StateBounds(items - 1, 100))


def test_numpy_scalars_become_numbers():
    assert decode(encode(replace(Thing(0.0), value=np.float64(0.1))), Thing) == Thing(0.1)
