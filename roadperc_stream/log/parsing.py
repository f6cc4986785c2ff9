"""The fields of a record that is no message, by the library's readers, within the record's own bytes."""

from io import BytesIO
from typing import Any, Final

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

PARSED: Final[dict[int, Any]] = {
    Opcode.HEADER: records.Header,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.ATTACHMENT: records.Attachment,
    Opcode.METADATA: records.Metadata,
    Opcode.STATISTICS: records.Statistics,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.FOOTER: records.Footer,
}
"""The library's reader of each kind of record that describes messages or the log."""


def parse(opcode: int, body: bytes, *, spare_allowed: bool) -> Any:
    """A record's fields.

    Args:
        opcode: one of ``PARSED``.
        body: the record behind its length.
        spare_allowed: whether more bytes than the fields have are no fault: the library skips them inside a chunk, but
            reads on at the wrong byte of a file.

    Raises:
        EndOfFile: the fields want more bytes than there are.
        ValueError: they leave some over, and that is a fault; or make no sense.
    """
    stream = _Bounded(BytesIO(body))
    item = PARSED[opcode].read(stream)
    if not spare_allowed and stream.count < len(body):
        raise ValueError(f"a record of {len(body)} bytes whose fields have {stream.count}")
    return item


class _Bounded(ReadDataStream):
    """A record's bytes, and an error where its fields want more."""

    def read(self, length: int) -> bytes:
        """The next bytes, all of them."""
        data = super().read(length)
        if len(data) < length:
            raise EndOfFile
        return data
