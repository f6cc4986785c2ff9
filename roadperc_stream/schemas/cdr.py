"""Reads ROS messages, and writes those of ROS 2 in CDR, by the definition in the log."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Final

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from roadperc_stream.errors import DecodeError
from roadperc_stream.schemas.definitions import brief, types_of
from roadperc_stream.system.time import NS_PER_S

_ZSTD: Final = b"\x28\xb5\x2f\xfd"
"""First bytes of a compressed message; no CDR message begins so."""
_MOST_LAYOUTS: Final = 64
"""Parsed definitions to keep; a log has only a few."""


def read(data: bytes, name: str, definition: bytes, encoding: str = "ros2msg") -> Any:
    """Return a message. Its arrays are views of ``data`` in CDR, or of one copy of a message of ROS 1.

    Args:
        data: CDR with its encapsulation header, of either byte order; or a message of ROS 1.
        name: the message's type, such as ``sensor_msgs/msg/Image``, or ``sensor_msgs/Image`` in ROS 1.
        definition: text of the type and of the types that it contains, as a log stores it.
        encoding: ``ros2msg``, ``ros2idl`` or, for a message of ROS 1, ``ros1msg``.

    Raises:
        DecodeError: the definition does not define the type, or the bytes do not match it.
    """
    if not definition:
        raise DecodeError(f"the log does not define {name}: expected ros2msg, ros2idl or ros1msg")
    name = name if "/msg/" in name else name.replace("/", "/msg/", 1)
    layout = layout_of(name, definition, encoding)
    if data[: len(_ZSTD)] == _ZSTD:
        raise DecodeError("the messages are compressed: replay the folder of the bag with its metadata.yaml")
    with as_defined(f"{len(data)} bytes are not a valid {name}"):
        content = layout.ros1_to_cdr(data, name) if encoding == "ros1msg" else memoryview(data)
        return layout.deserialize_cdr(content, name)


def layout_of(name: str, definition: bytes, encoding: str = "ros2msg") -> Typestore:
    """Return a reader and writer for messages of a type; arguments and errors as in ``read``."""
    layout = _layout(name, definition, encoding)
    if isinstance(layout, str):
        raise DecodeError(layout)
    return layout


@contextmanager
def as_defined(fault: str) -> Iterator[None]:
    """Turn any error into a DecodeError, because a message with the log's own definition may contain anything.

    Raises:
        DecodeError: ``fault``, and the text of the error.
    """
    try:
        yield
    except DecodeError:
        raise
    except Exception as error:  # the log defines the types of fields, so any error is possible
        raise DecodeError(f"{fault}: {brief(error)}") from error


def stamp_ns(stamp: Any) -> int:
    """Return integer nanoseconds of a builtin_interfaces/Time."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


@lru_cache(_MOST_LAYOUTS)
def _layout(name: str, definition: bytes, encoding: str) -> Typestore | str:
    """Return the reader of a type, or the fault of its definition. Both are cached, so each is parsed once."""
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(types_of(name, definition, encoding))
        store.get_msgdef(name)
    except Exception as error:  # runs code that is generated from the text, so any error is possible
        return f"the log's definition of {name} cannot be read: {brief(error)}"
    return store
