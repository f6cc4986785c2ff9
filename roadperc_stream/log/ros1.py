"""Reads ROS 1 bags as ROS 2 messages, and defines the message types of ROS 2, by the rosbags library."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Final

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

from roadperc_stream.log.records import Channel, Message
from roadperc_stream.schemas.definitions import types_of

_RENAMED: Final = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


def contents_of_ros1(path: Path) -> Iterator[Channel | Message]:
    """Yield the channels of a ROS 1 bag, then its messages.

    Raises:
        Exception: it is damaged or has no index; any error of the library.
    """
    with Reader(path) as reader:
        known = {connection.id: _as_ros2(connection) for connection in reader.connections}
        yield from (channel for channel, _ in known.values())
        for connection, time_ns, data in reader.messages():
            channel, convert = known[connection.id]
            try:
                yield Message(channel, time_ns, time_ns, 0, bytes(convert(data)))
            except Exception as error:
                raise ValueError(f"{channel.topic}: message at {time_ns} ns: {error}") from error


def _as_ros2(connection: Connection) -> tuple[Channel, Callable[[bytes], memoryview | bytes]]:
    """Return the channel of a connection, and the conversion of its messages.

    A type whose definition cannot be read stays in the encoding of ROS 1.
    """
    name, text = _RENAMED.get(connection.msgtype, connection.msgtype), connection.msgdef.data
    try:
        types = types_of(connection.msgtype, text.encode(), "ros1msg")
        types[name] = types.pop(connection.msgtype)
        store = get_typestore(Stores.EMPTY)
        store.register(types)
        definition = store.generate_msgdef(name, ros_version=2)[0].encode()
    except Exception:  # the bag defines the type, so any error is possible
        return Channel(connection.topic, "ros1", name, "ros1msg", text.encode()), bytes
    return Channel(connection.topic, "cdr", name, "ros2msg", definition), partial(store.ros1_to_cdr, typename=name)


def definition_of(name: str) -> bytes:
    """Return ROS 2's definition of a message type; empty if rosbags does not know the type."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    return store.generate_msgdef(name, ros_version=2)[0].encode() if name in store.fielddefs else b""
