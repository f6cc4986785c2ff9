"""What a chunk holds: its records as far as they can be read, and why not all of them can.

Decompression is streamed, so that of a chunk that is cut, or damaged in the middle, everything before is read, and
never more than the chunk says that it holds. Layout: https://mcap.dev/spec.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from typing import Final

import lz4.frame
from deflate import crc32
from mcap.opcode import Opcode
from zstandard import ZstdDecompressor, ZstdError

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.log.layout import TOO_SHORT, ChunkHead, Item, records_in

INSIDE: Final = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_PIECE_BYTES: Final = 1024 * 1024
_LZ4_PIECE_BYTES: Final = 16 * 1024
"""What is given at once: behind each frame the rest of it is copied."""


@dataclass(frozen=True)
class Contents:
    """A chunk's records up to the first fault, which is empty where there is none."""

    items: tuple[Item, ...]
    fault: str = ""


@dataclass
class Workspace:
    """Memory that chunks are decompressed to, one after the other: new memory costs more than decompressing."""

    memory: bytearray = field(default_factory=lambda: bytearray(_PIECE_BYTES))

    def free(self, used: int) -> memoryview:
        """What lies behind the bytes that are used; more memory where that is nothing."""
        if used == len(self.memory):
            self.memory = self.memory + bytes(used)
        return memoryview(self.memory)[used:]


def contents_of(head: ChunkHead, workspace: Workspace, limits: LimitsConfig = DEFAULT_LIMITS) -> Contents:
    """A chunk's records, which hold until the workspace is used again.

    Where the bytes make no sense, or end, those before are given: they were read as they were written. Where they do
    but their CRC is wrong, nobody knows which of them is, and none is given.
    """
    data, broken = _DECOMPRESSED[head.compression](head, workspace)
    found = split(data, limits.chunk_messages)
    if head.stored_bytes > len(head.stored):
        return Contents(found.items, TOO_SHORT)
    if broken or found.fault:
        return Contents(found.items, broken or found.fault)
    if head.crc and (crc := crc32(data)) != head.crc:
        return Contents((), wrong_crc(crc, head.crc))
    if len(data) != head.size_bytes:
        return Contents(found.items, f"holds {len(data)} bytes, expected {head.size_bytes}")
    return found


@dataclass(frozen=True)
class Unpacked:
    """A chunk's decompressed data, in memory of its own."""

    data: memoryview
    is_plain: bool
    """Whether they are as many bytes as the chunk says, in one frame: many readers see no other than the first."""


def unpacked(head: ChunkHead, *, check_crc: bool) -> Unpacked:
    """A chunk's data, decompressed at once where that can be; of a chunk that was held against the limits before.

    Raises:
        ValueError: the bytes make no sense, or the CRC is to be checked, and is wrong.
    """
    at_once = _at_once(head)
    data, fault = (at_once, "") if at_once is not None else _DECOMPRESSED[head.compression](head, Workspace())
    if fault:
        raise ValueError(fault)
    if check_crc and head.crc and (crc := crc32(data)) != head.crc:
        raise ValueError(wrong_crc(crc, head.crc))
    return Unpacked(data, at_once is not None)


def _at_once(head: ChunkHead) -> memoryview | None:
    """A chunk's data where they are a single frame of the size that it says."""
    try:
        data = memoryview(_UNPACKED[head.compression](head))
    except (ZstdError, RuntimeError):
        return None
    return data if len(data) == head.size_bytes else None


def wrong_crc(found: int, expected: int) -> str:
    """What is said of a chunk whose CRC is not that of its data."""
    return f"crc is {found:#010x}, expected {expected:#010x}"


def split(data: memoryview, most: int) -> Contents:
    """The records that stand in the decompressed data of a chunk, so many at most, and why they end early."""
    items: list[Item] = []
    try:
        for item in records_in(data):
            if len(items) == most:
                return Contents(tuple(items), too_many(most))
            if item.opcode not in INSIDE:
                kind = f"a record of type {item.opcode:#04x} at its byte {item.offset}"
                return Contents(tuple(items), f"{kind}, expected schema, channel or message")
            items.append(item)
    except ValueError as error:
        return Contents(tuple(items), str(error))
    return Contents(tuple(items))


def too_many(most: int) -> str:
    """What is said of a chunk with more messages than may be."""
    return f"more messages in a chunk than limits.chunk_messages, which is {most}"


_Data = tuple[memoryview, str]
"""What was decompressed, and why that is not all; empty where it is."""


def _stored(head: ChunkHead, _: Workspace) -> _Data:
    return head.stored, ""


def _zstd(head: ChunkHead, workspace: Workspace) -> _Data:
    used, fault = 0, ""
    with ZstdDecompressor().stream_reader(head.stored, read_across_frames=True) as reader:
        try:
            while used <= head.size_bytes and (number := reader.readinto(workspace.free(used))):
                used += number
        except ZstdError as error:
            fault = str(error)
    return _as_promised(memoryview(workspace.memory)[:used], head, fault)


def _lz4(head: ChunkHead, _: Workspace) -> _Data:
    decompressor, stored, data, fault = lz4.frame.LZ4FrameDecompressor(), BytesIO(head.stored), bytearray(), ""
    is_open, given = True, b""
    try:
        while len(data) <= head.size_bytes:
            given = given or (stored.read(_LZ4_PIECE_BYTES) if decompressor.needs_input else b"")
            if not given and decompressor.needs_input:
                fault = TOO_SHORT if is_open else ""
                break
            data += decompressor.decompress(given, max_length=_PIECE_BYTES)
            is_open, given = not decompressor.eof, b""
            if decompressor.eof:  # another frame may follow
                given = decompressor.unused_data or b""
                decompressor.reset()
    except RuntimeError as error:
        fault = str(error)
    return _as_promised(memoryview(data), head, fault)


def _as_promised(data: memoryview, head: ChunkHead, fault: str) -> _Data:
    """No more than the chunk says that it holds."""
    if len(data) > head.size_bytes:
        return data[: head.size_bytes], f"holds more than the {head.size_bytes} bytes it promises"
    return data, " ".join(fault.split())


_DECOMPRESSED: Final[dict[str, Callable[[ChunkHead, Workspace], _Data]]] = {"": _stored, "zstd": _zstd, "lz4": _lz4}
_UNPACKED: Final[dict[str, Callable[[ChunkHead], bytes | memoryview]]] = {
    "": lambda head: head.stored,
    "zstd": lambda head: ZstdDecompressor().decompress(head.stored, max_output_size=head.size_bytes),
    "lz4": lambda head: lz4.frame.decompress(head.stored),
}
