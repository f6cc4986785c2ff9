"""Reading and writing MCAP files: the only package that imports mcap.

It handles bytes; ``schemas`` and ``input`` decode them.
"""

from roadperc_stream.log.bags import is_log, received, received_file
from roadperc_stream.log.damage import Damage, DamagedLogError, LostSpan, first_damage, number_of
from roadperc_stream.log.files import counted_topics, gone_on_ns
from roadperc_stream.log.growing import GrowingLog
from roadperc_stream.log.index import outline
from roadperc_stream.log.mcap_file import Piece
from roadperc_stream.log.reading import pieces, read, summarise
from roadperc_stream.log.records import (
    DIGEST_ALGORITHM,
    RECOVERY_RECORD,
    Attachment,
    Channel,
    LogSummary,
    Message,
    MessageDigest,
    Metadata,
)
from roadperc_stream.log.recovery import Salvage, audited
from roadperc_stream.log.repair import Recovery, RepairedLog, repaired_copy, write_repaired
from roadperc_stream.log.sorting import in_order_within
from roadperc_stream.log.stored import AnyLog, LogFile
from roadperc_stream.log.writing import LogWriter, MessageCopy
