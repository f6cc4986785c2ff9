"""Reading and writing MCAP files: the only room that imports mcap.

Bytes in, bytes out; what they mean is the business of ``channels``.
"""

from roadperc_stream.log.reading import read, summarise
from roadperc_stream.log.records import Attachment, Channel, LogSummary, Message, MessageDigest, Metadata
from roadperc_stream.log.writing import LogWriter

__all__ = [
    "Attachment",
    "Channel",
    "LogSummary",
    "LogWriter",
    "Message",
    "MessageDigest",
    "Metadata",
    "read",
    "summarise",
]
