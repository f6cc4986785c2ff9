"""Files of MCAP's conformance suite are read exactly, and so is what other writers make of the specification."""

import json
import struct
from zlib import crc32

import pytest

from roadperc_stream import log
from roadperc_stream.cli.info import main as info_main

VARIANTS = {
    "NoData": 8,
    "OneAttachment": 16,
    "OneMessage": 192,
    "OneMetadata": 16,
    "OneSchemalessMessage": 96,
    "TenMessages": 192,
}


def expected(path):
    """What a file holds, from the JSON beside it: header, channels, messages, attachments, metadata, statistics."""
    records = [(r["type"], dict(r["fields"])) for r in json.loads(path.with_suffix(".json").read_text())["records"]]

    def of(kind):
        return [fields for name, fields in records if name == kind]

    def data(fields):
        return bytes(map(int, fields["data"]))

    schemas = {int(s["id"]): (s["name"], s["encoding"], data(s)) for s in of("Schema")}
    channels = {
        int(c["id"]): (
            c["topic"],
            c["message_encoding"],
            c["metadata"],
            schemas.get(int(c["schema_id"]), ("", "", b"")),
        )
        for c in of("Channel")
    }
    messages = [
        (*(int(m[key]) for key in ("log_time", "publish_time", "sequence")), data(m), int(m["channel_id"]))
        for m in of("Message")
    ]
    attachments = [
        (a["name"], a["media_type"], data(a), int(a["log_time"]), int(a["create_time"])) for a in of("Attachment")
    ]
    statistics = of("Statistics")
    header = of("Header")[0]
    return {
        "header": (header["profile"], header["library"]),
        "channels": channels,
        "messages": sorted(messages, key=lambda m: m[0]),
        "attachments": attachments,
        "metadata": [(m["name"], m["metadata"]) for m in of("Metadata")],
        "counts": {int(k): int(v) for s in statistics for k, v in s["channel_message_counts"].items()}
        or ({1: len(messages)} if messages else {}),
        "span": (min(m[0] for m in messages), max(m[0] for m in messages)) if messages else None,
    }


def found(path):
    summary, account = log.summarise(path), log.audited(path)
    return {
        "header": (summary.profile, account.described.library),
        "channels": {c.source_id: (c.topic, c.message_encoding, dict(c.metadata), c.schema) for c in summary.channels},
        "messages": [
            (m.log_time_ns, m.publish_time_ns, m.sequence, m.data, m.channel.source_id) for m in log.read(summary)
        ],
        "attachments": [(a.name, a.media_type, a.data, a.log_time_ns, a.create_time_ns) for a in summary.attachments],
        "metadata": [(record.name, dict(record.values)) for record in summary.metadata],
        "counts": {number: count for number, count in summary.counts.items() if count},
        "span": (summary.first_ns, summary.last_ns) if any(summary.counts.values()) else None,
    }


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_conformance_suite_is_read_exactly(data_dir, variant):
    paths = sorted((data_dir / "mcap_conformance" / variant).glob("*.mcap"))
    assert paths
    for path in paths:
        assert found(path) == expected(path), path.name


def text(value):
    return struct.pack("<I", len(value)) + value


def record(opcode, body, more=b""):
    return bytes([opcode]) + struct.pack("<Q", len(body) + len(more)) + body + more


def statistics(times, counts, start_ns, end_ns):
    fields = len(times), 1, 1, 1, 0, 0, start_ns, end_ns, len(counts)
    return record(11, struct.pack("<QHIIIIQQI", *fields) + counts)


def written(path, times, *, more=b"", before=b"", summary=b""):
    """A log without chunks: ``more`` bytes behind known fields, records ``before`` and in the summary."""
    schema = record(3, struct.pack("<H", 1) + text(b"Ex") + text(b"jsonschema") + text(b"{}"), more)
    channel = record(4, struct.pack("<HH", 1, 1) + text(b"/a") + text(b"json") + struct.pack("<I", 0), more)
    content = b"\x89MCAP0\r\n" + record(1, text(b"") + text(b"t"), more) + before + schema + channel
    for number, time_ns in enumerate(times):
        content += record(5, struct.pack("<HIQQ", 1, number, time_ns, time_ns) + b"{}")
    attached = struct.pack("<QQ", 1, 2) + text(b"a.txt") + text(b"text/plain") + struct.pack("<Q", 2) + b"hi"
    content += record(9, attached + struct.pack("<I", crc32(attached)), more)
    content += record(15, struct.pack("<I", crc32(content)), more)
    start, summary = len(content), summary and schema + channel + summary
    footer = bytes([2]) + struct.pack("<QQQ", 20, start if summary else 0, 0)
    path.write_bytes(content + summary + footer + struct.pack("<I", crc32(summary + footer)) + b"\x89MCAP0\r\n")
    return path


ALLOWED = {
    "more bytes behind known fields": ([1, 2], {"more": b"\0\0\0"}),
    "reserved opcodes": ([1, 2], {"before": record(0x10, b"future") + record(0x7F, b"") + record(0x85, b"own")}),
    "a reserved opcode with the form of a message": (
        [1, 2],
        {"before": record(0x15, struct.pack("<HIQQ", 1, 1, 1, 1))},
    ),
    "statistics without counts": ([1, 2], {"summary": statistics([1, 2], b"", 1, 2)}),
    "statistics that begin behind time 0": ([0, 9], {"summary": statistics([0, 9], struct.pack("<HQ", 1, 2), 9, 9)}),
}


@pytest.mark.parametrize("case", ALLOWED)
def test_what_the_specification_allows_is_no_damage(tmp_path, case, capsys):
    times, options = ALLOWED[case]
    summary = log.summarise(written(tmp_path / "a.mcap", times, **options))
    assert [m.log_time_ns for m in log.read(summary)] == times
    assert (summary.first_ns, summary.last_ns) == (times[0], times[-1])
    assert summary.attachments[0].data == b"hi"
    assert info_main([str(tmp_path / "a.mcap")]) == 0
    assert "whole" in capsys.readouterr().out
