"""ROS 2 messages out of CDR, laid out as the definition in the log says, and into it."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Final

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from roadperc_stream.errors import DecodeError
from roadperc_stream.schemas.definitions import brief, types_of
from roadperc_stream.system.time import NS_PER_S

_MOST_LAYOUTS: Final = 64
"""Definitions that are kept parsed: a log has a handful."""


def read(data: bytes, name: str, definition: bytes, encoding: str = "ros2msg") -> Any:
    """The message, with its arrays as views of ``data``.

    Args:
        data: CDR with its encapsulation header, of either byte order.
        name: the message's type, such as ``sensor_msgs/msg/Image``.
        definition: text of the type and of those it is made of, as a log stores it.
        encoding: ``ros2msg`` or ``ros2idl``.

    Raises:
        DecodeError: the definition does not define the type, or the bytes are not as it says.
    """
    if not definition:
        raise DecodeError(f"the log does not define {name}: expected ros2msg or ros2idl")
    layout = layout_of(name, definition, encoding)
    with as_defined(f"{len(data)} bytes are no {name}"):
        return layout.deserialize_cdr(memoryview(data), name)


def layout_of(name: str, definition: bytes, encoding: str = "ros2msg") -> Typestore:
    """Reads and writes messages of a type, and has the classes of its parts; arguments and errors as for ``read``."""
    layout = _layout(name, definition, encoding)
    if isinstance(layout, str):
        raise DecodeError(layout)
    return layout


@contextmanager
def as_defined(otherwise: str) -> Iterator[None]:
    """What is done with a message of the log's own definition, under which it may hold anything, or nothing.

    Raises:
        DecodeError: ``otherwise``, and what went wrong.
    """
    try:
        yield
    except DecodeError:
        raise
    except Exception as error:  # What the fields hold is the log's word: there is no telling what meets it.
        raise DecodeError(f"{otherwise}: {brief(error)}") from error


def stamp_ns(stamp: Any) -> int:
    """Integer nanoseconds of a builtin_interfaces/Time."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


@lru_cache(_MOST_LAYOUTS)
def _layout(name: str, definition: bytes, encoding: str) -> Typestore | str:
    """The reader of a type; of a bad definition its fault, so that it is looked at once and not for every message."""
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(types_of(name, definition, encoding))
        store.get_msgdef(name)
    except Exception as error:  # Code is generated from the log's text, and run: there is no telling what that raises.
        return f"the log's definition of {name} cannot be read: {brief(error)}"
    return store
