"""Opens a log that was checked, and reads its messages in file order."""

from collections.abc import Iterator
from contextlib import contextmanager

from mcap.exceptions import McapError
from mcap.opcode import Opcode

from roadperc_stream.config import LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log.chunks import INSIDE, streamed
from roadperc_stream.log.damage import damaged, unopened
from roadperc_stream.log.index import Described
from roadperc_stream.log.layout import MAGIC, RECORD, UNREADABLE, Record, chunk_head, message_head, parse
from roadperc_stream.log.limits import GuardedFile, LimitError
from roadperc_stream.log.records import Message
from roadperc_stream.log.recovery import Salvage, damage_in
from roadperc_stream.log.stored import LogFile


def in_file_order(file: LogFile, limits: LimitsConfig) -> Iterator[Message]:
    """Yield the messages of a checked file in its order, one message of a chunk in memory at a time.

    Every chunk's CRC is checked.

    Raises:
        LogError: as ``opened``.
    """
    described = Described()
    with opened(file, limits) as stream:
        for record in _records(stream):
            for item in streamed(chunk_head(record.body)) if record.opcode == Opcode.CHUNK else (record,):
                if item.opcode == Opcode.MESSAGE:
                    head = message_head(item.body)
                    if head.channel_id not in described.channels:
                        raise McapError(f"no channel record found with id {head.channel_id}")
                    yield head.of(described.channels[head.channel_id], item.body)
                elif item.opcode in INSIDE:
                    described.add(parse(item.opcode, bytes(item.body)), in_data=True)


def _records(stream: GuardedFile) -> Iterator[Record]:
    """Yield the records of the data section, outside chunks."""
    start, opcode = stream.seek(len(MAGIC)), 0
    while opcode != Opcode.DATA_END:
        opcode, length = RECORD.unpack(stream.exactly(RECORD.size))
        record = Record(start, opcode, stream.exactly(length))
        yield record
        start = record.end


@contextmanager
def opened(file: LogFile, limits: LimitsConfig) -> Iterator[GuardedFile]:
    """Open a log.

    Raises:
        LogError: the file cannot be read, is not MCAP, is cut, damaged or beyond the limits.
    """
    try:
        with GuardedFile(file, limits) as stream:
            yield stream
    except OSError as error:
        raise unopened(file.name, error) from error
    except LimitError as error:
        raise LogError(f"{file}: {error}") from error
    except UNREADABLE as error:
        found = Salvage(file, limits=limits).run()
        fault = f"damaged MCAP: {str(error) or type(error).__name__}"
        raise (damaged(file.name, fault) if found.whole else damage_in(found)) from error
