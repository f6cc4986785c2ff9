"""Logs and tables with damaged bytes and records."""

import io
from dataclasses import fields, replace

from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.stream_reader import StreamReader

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
    """A log with one or two records changed, left out, repeated or moved."""
    stream = io.BytesIO(bases.log_of(bases.drive(), **bases.UNINDEXED))
    records = list(StreamReader(stream).records)
    for _ in range(draw(st.integers(1, 2))):
        at = draw(st.integers(0, len(records) - 1))
        how = draw(st.sampled_from(("field", "field", "field", "remove", "repeat", "move")))
        if how == "field":
            records[at] = _with_a_changed_field(draw, records[at])
        elif how == "repeat":
            records[at:at] = [records[at]] * draw(st.sampled_from((1, 300)))
        else:
            record = records.pop(at)
            records[:0] = [record] * (how == "move")
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return MAGIC + builder.end() + MAGIC


def _with_a_changed_field(draw, record):
    name = draw(st.sampled_from([field.name for field in fields(record)]))
    value = getattr(record, name)
    kinds = {int: integers(WIDTHS.get(name, 64)), str: texts, dict: st.dictionaries(texts, texts, max_size=3)}
    return replace(record, **{name: draw(kinds[type(value)] if type(value) in kinds else damaged(bytes(value)))})


@examples
@given(changed_records(), COMMANDS)
def test_records_of_a_log(data, command):
    with folder_of({"in.mcap": data}) as folder:
        require_clear_end(folder, *command.split())
