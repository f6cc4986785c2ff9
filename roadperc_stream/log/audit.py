"""Checks whether a log is whole, in one pass before it is used and again while it is read."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mcap.exceptions import McapError
from mcap.opcode import Opcode

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log.chunks import INSIDE, streamed
from roadperc_stream.log.damage import DamagedLogError, damaged, nothing_saved, unopened
from roadperc_stream.log.framing import Framing
from roadperc_stream.log.index import Described
from roadperc_stream.log.layout import UNREADABLE, chunk_head, message_head, parse
from roadperc_stream.log.limits import GuardedFile, LimitError
from roadperc_stream.log.records import Message
from roadperc_stream.log.salvage import Salvage
from roadperc_stream.system.time import ns_to_seconds


def damage_in(found: Salvage) -> LogError:
    """Return the error for a log that is not whole."""
    if not found.counts.total():
        return nothing_saved(found.path, found.damages)
    return DamagedLogError(found.path, found.damages, _can_be_saved(found))


def audited(path: Path, limits: LimitsConfig = DEFAULT_LIMITS, *, check_chunks: bool = False) -> Salvage:
    """Return the finished account of a log.

    Chunks are opened only if CRCs do not cover all messages, or message indexes do not count them.

    Args:
        path: the log.
        limits: of its records and chunks.
        check_chunks: also open chunks that only their own CRC covers. Otherwise that CRC is checked when the chunk is
            read, which is too late for a caller that skips chunks or continues behind damage.

    Raises:
        LogError: the file cannot be read, or is not MCAP.
    """
    quick = Salvage(path, inside=False, limits=limits).run()
    is_checked = quick.sealed or not check_chunks
    return quick if quick.whole and quick.conclusive and is_checked else Salvage(path, limits=limits).run()


def _can_be_saved(found: Salvage) -> str:
    saved, written = found.counts.total(), found.written
    of_all = "" if written is None else f" of {sum(written.values())}"
    start_ns, lost_ns = found.first_ns, [gap.first_ns for gap in found.losses.all]
    from_ns = min((ns for ns in lost_ns if ns is not None), default=None)
    before = ""
    if start_ns is not None and from_ns is not None and None not in lost_ns and from_ns > start_ns:
        before = f", all before {ns_to_seconds(from_ns - start_ns):.3f} s"
    return f"{saved}{of_all} messages can be saved{before}: pass --recover to roadperc-replay or roadperc-view"


def in_file_order(path: Path, limits: LimitsConfig) -> Iterator[Message]:
    """Yield the messages of a checked file in its order, one message of a chunk in memory at a time.

    Every chunk's CRC is checked.

    Raises:
        LogError: as ``opened``.
    """
    described = Described()
    with opened(path, limits) as stream:
        framing = Framing(stream.size_bytes)
        for record in framing.records(stream):
            for item in streamed(chunk_head(record.body)) if record.opcode == Opcode.CHUNK else (record,):
                if item.opcode == Opcode.MESSAGE:
                    head = message_head(item.body)
                    if head.channel_id not in described.channels:
                        raise McapError(f"no channel record found with id {head.channel_id}")
                    yield head.of(described.channels[head.channel_id], item.body)
                elif item.opcode in INSIDE:
                    described.add(parse(item.opcode, bytes(item.body)), in_data=True)
        if framing.damages:
            raise McapError(framing.damages[0].words)


@contextmanager
def opened(path: Path, limits: LimitsConfig) -> Iterator[GuardedFile]:
    """Open a log.

    Raises:
        LogError: the file cannot be read, is not MCAP, is cut, damaged or beyond the limits.
    """
    try:
        with GuardedFile(path, limits) as stream:
            yield stream
    except OSError as error:
        raise unopened(path, error) from error
    except LimitError as error:
        raise LogError(f"{path}: {error}") from error
    except UNREADABLE as error:
        found = Salvage(path, limits=limits).run()
        fault = f"damaged MCAP: {str(error) or type(error).__name__}"
        raise (damaged(path, fault) if found.whole else damage_in(found)) from error
