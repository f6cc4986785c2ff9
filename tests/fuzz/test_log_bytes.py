"""Logs and tables with damaged bytes and records."""

import io
import struct
from dataclasses import fields, replace

from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.stream_reader import StreamReader

from roadperc_stream.log import summarise
from tests.fuzz import bases
from tests.fuzz.running import examples, folder_of, require_clear_end
from tests.fuzz.values import damaged, integers, texts

MAGIC = b"\x89MCAP0\r\n"
COMMANDS = st.sampled_from((
    "replay in.mcap result.mcap", "replay in.mcap result.mcap --recover", "replay in.mcap result.mcap --threads 1",
    "info in.mcap", "info in.mcap --recover saved.mcap", "view in.mcap --save view.rrd", "batch dataset in.mcap",
))  # fmt: skip
WIDTHS = {"id": 16, "schema_id": 16, "channel_id": 16, "sequence": 32, "data_section_crc": 32, "summary_crc": 32}
"""Bits of the integers in records; the others have 64."""


@examples
@given(st.data(), COMMANDS)
def test_bytes_of_a_log(data, command):
    intact = data.draw(st.sampled_from((bases.log_of(bases.drive()), bases.results()["out.mcap"])))
    with folder_of({"in.mcap": data.draw(damaged(intact))}) as folder:
        require_clear_end(folder, *command.split())


@examples
@given(st.data(), st.sampled_from(("report", "check", "trajectory", "compare out.metrics.parquet")))
def test_bytes_of_a_table(data, command):
    intact = bases.results()["out.metrics.parquet"]
    with folder_of({"a.metrics.parquet": data.draw(damaged(intact)), "out.metrics.parquet": intact}) as folder:
        require_clear_end(folder, *command.split(), "a.metrics.parquet")


@st.composite
def changed_records(draw):
    """A log with one or two records changed, left out, repeated or moved, or with a wrong length."""
    stream = io.BytesIO(bases.log_of(bases.drive(), **bases.UNINDEXED))
    records = list(StreamReader(stream).records)
    lengths = {}
    for _ in range(draw(st.integers(1, 2))):
        at = draw(st.integers(0, len(records) - 1))
        how = draw(st.sampled_from(("field", "field", "field", "remove", "repeat", "move", "length")))
        if how == "field":
            records[at] = _with_a_changed_field(draw, records[at])
        elif how == "length":
            lengths[id(records[at])] = draw(integers(64))
        elif how == "repeat":
            records[at:at] = [records[at]] * draw(st.sampled_from((1, 300)))
        else:
            record = records.pop(at)
            records[:0] = [record] * (how == "move")
    return MAGIC + b"".join(_packed(record, lengths.get(id(record))) for record in records) + MAGIC


def _with_a_changed_field(draw, record):
    known = fields(record)
    name = known[draw(st.integers(0, len(known) - 1))].name
    value = getattr(record, name)
    kinds = {int: integers(WIDTHS.get(name, 64)), str: texts, dict: st.dictionaries(texts, texts, max_size=3)}
    return replace(record, **{name: draw(kinds[type(value)] if type(value) in kinds else damaged(bytes(value)))})


def _packed(record, length):
    builder = RecordBuilder()
    record.write(builder)
    data = builder.end()
    return data if length is None else data[:1] + struct.pack("<Q", length) + data[9:]


@examples
@given(changed_records(), COMMANDS)
def test_records_of_a_log(data, command):
    with folder_of({"in.mcap": data}) as folder:
        require_clear_end(folder, *command.split())


def test_the_records_of_an_unchanged_log_are_the_log(tmp_path):
    stream = io.BytesIO(bases.log_of(bases.drive(), **bases.UNINDEXED))
    path = tmp_path / "in.mcap"
    path.write_bytes(MAGIC + b"".join(_packed(record, None) for record in StreamReader(stream).records) + MAGIC)
    assert path.read_bytes() == stream.getvalue()
    assert sum(summarise(path).counts.values()) == len(bases.drive())
