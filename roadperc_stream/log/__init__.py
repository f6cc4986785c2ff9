"""Reading and writing MCAP files: the only package that imports mcap.

Bytes in, bytes out; what they mean is the business of ``schemas`` and ``input``.
"""

from roadperc_stream.log.copying import MessageCopy
from roadperc_stream.log.framing import Damage
from roadperc_stream.log.growing import GrowingLog
from roadperc_stream.log.pipes import received
from roadperc_stream.log.reading import read, summarise
from roadperc_stream.log.records import Attachment, Channel, LogSummary, Message, MessageDigest, Metadata
from roadperc_stream.log.salvage import Salvage
from roadperc_stream.log.writing import LogWriter

__all__ = [
    "Attachment",
    "Channel",
    "Damage",
    "GrowingLog",
    "LogSummary",
    "LogWriter",
    "Message",
    "MessageCopy",
    "MessageDigest",
    "Metadata",
    "Salvage",
    "read",
    "received",
    "summarise",
]
