"""What the pixels of a log's images can be, where no name says so."""

from collections.abc import Callable
from typing import Final

import numpy as np

from roadperc_stream import log
from roadperc_stream.core.datatypes import DepthImage, TagImage
from roadperc_stream.core.semantics import CARLA_FROM_0_9_14
from roadperc_stream.errors import DecodeError, LogError
from roadperc_stream.input.decoding import context_of_channel, decode
from roadperc_stream.log import Channel, LogSummary, Message
from roadperc_stream.schemas.roles import Kind

ContentProbe = Callable[[Kind, Channel], bool]
"""Whether what is in a channel is of a kind."""
_MOST_CLASSES: Final = CARLA_FROM_0_9_14
"""The table with most classes: a number beyond is no tag of any version."""


def no_probe(_kind: Kind, _channel: Channel) -> bool:
    """Whether a channel is of a kind, where nothing is read: it is not known to be."""
    return False


def probe_first_message(summary: LogSummary, kind: Kind, channel: Channel) -> bool:
    """Whether the first message of a channel is depth, or tags: by its encoding, and by pixels that are all some class.

    A log, or a message, that cannot be read says nothing.

    Args:
        summary: the log.
        kind: ``depth`` or ``tags``.
        channel: of the log.
    """
    try:
        message = next(log.read(summary, topics=(channel.topic,)), None)
        return message is not None and _is_of_kind(kind, message)
    except (LogError, DecodeError):
        return False


def _is_of_kind(kind: Kind, message: Message) -> bool:
    """Whether a message decodes as the kind.

    Raises:
        DecodeError: it does not.
    """
    channel = message.channel
    context = context_of_channel(channel, _MOST_CLASSES.name)
    schema, encoding = channel.schema_name, channel.message_encoding
    payload = decode(kind, schema, encoding, message.data, message.log_time_ns, context).payload
    if isinstance(payload, TagImage):
        return 0 < int(np.max(payload.tags)) < len(_MOST_CLASSES.names)  # a black image is no tags
    return isinstance(payload, DepthImage) and payload.depth_m.size > 0
