"""Faults in the tables of a replay: columns, values, metadata and bytes."""

import io
import math
from collections.abc import Callable
from functools import cache
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from roadperc_stream.schemas.columns import TIME_COLUMNS
from tests.fuzz import contents
from tests.fuzz.choices import FLOATS, TEXTS, Choices, damage, wild_integer, wild_text
from tests.fuzz.trees import mutate_toml

TYPES: dict[str, tuple[pa.DataType, Any]] = {
    "null": (pa.null(), None), "text": (pa.string(), "x"), "float": (pa.float64(), 1.5), "half": (pa.float32(), 1.5),
    "integer": (pa.int64(), 7), "unsigned": (pa.uint64(), 2**64 - 1), "truth": (pa.bool_(), True),
    "list": (pa.list_(pa.string()), ["a"]), "numbers": (pa.list_(pa.float64()), [math.nan]),
    "struct": (pa.struct([("a", pa.int64())]), {"a": 1}), "time": (pa.timestamp("ns"), 1),
    "bytes": (pa.binary(), b"\xff"), "days": (pa.date32(), 1), "decimal": (pa.decimal128(38, 10), 1),
    "span": (pa.duration("ns"), 1), "words": (pa.dictionary(pa.int32(), pa.string()), "x"),
}  # fmt: skip
"""Column types, and a value of each."""
FACTS = (
    "roadperc.config", "roadperc.config_digest", "roadperc.version", "roadperc.log", "roadperc.source", "ARROW:schema",
)  # fmt: skip
POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


@cache
def table(name: str) -> pa.Table:
    """A table of the replayed log with fixed times and paths, so that it is reproducible."""
    found = pq.read_table(io.BytesIO(contents.results()[f"out.{name}.parquet"]))
    if name == "metrics":
        fixed = {column: [10.0] * found.num_rows for column in TIME_COLUMNS}
        # Odometry finds no features in such small images, but a trajectory needs poses.
        poses = {f"odom_{part}": found[f"true_{part}"].to_pylist() for part in POSE}
        for column, values in {**fixed, **poses, "odometry_status": ["tracked"] * found.num_rows}.items():
            at = found.column_names.index(column)
            found = found.set_column(at, found.field(at), pa.array(values, found.field(at).type))
    facts = {**found.schema.metadata, b"roadperc.log": b"/runs/out.mcap", b"roadperc.source": b"/runs/in.mcap"}
    free = pa.schema([field.with_nullable(True) for field in found.schema], facts)
    return found.replace_schema_metadata(facts).cast(free)


def written(changed: pa.Table) -> bytes:
    """The bytes of a Parquet file."""
    stream = io.BytesIO()
    pq.write_table(changed, stream)
    return stream.getvalue()


def mutate_table(found: pa.Table, choices: Choices) -> pa.Table:
    """The table with one fault; unchanged if the fault does not apply to it."""
    try:
        changed = FAULTS[choices.of("do", WEIGHTED)](found, choices)
        written(changed)
    except (pa.ArrowException, ValueError, TypeError, OverflowError, IndexError, KeyError):
        return found
    return changed


def _column(found: pa.Table, choices: Choices) -> int:
    return found.column_names.index(choices.of("column", found.column_names))


def _value(found: pa.Table, choices: Choices) -> pa.Table:
    """Change one cell or the whole column."""
    at = _column(found, choices)
    kind = found.field(at).type
    values = found.column(at).to_pylist()
    if pa.types.is_floating(kind):
        value: Any = choices.of("float", FLOATS)
    elif pa.types.is_integer(kind):
        value = wild_integer(choices, "integer")
    elif pa.types.is_list(kind):
        value = [choices.of("text", TEXTS)] * choices.of("copies", (0, 1, 100))
    else:
        value = choices.of("text", TEXTS) if pa.types.is_string(kind) else None
    row = choices.index("row", max(len(values), 1))
    everywhere = choices.chance("everywhere", 0.4)
    value = None if choices.chance("missing", 0.1) else value
    changed = [value if everywhere or k == row else before for k, before in enumerate(values)]
    return found.set_column(at, found.field(at), pa.array(changed, kind))


def _retype(found: pa.Table, choices: Choices) -> pa.Table:
    at = _column(found, choices)
    kind, value = TYPES[choices.of("type", tuple(TYPES))]
    value = None if choices.chance("empty", 0.2) else value
    return found.set_column(at, found.column_names[at], pa.array([value] * found.num_rows, kind))


def _rename(found: pa.Table, choices: Choices) -> pa.Table:
    at = _column(found, choices)
    name = choices.of("to", found.column_names) if choices.chance("twice", 0.2) else wild_text(choices)
    names = found.column_names
    names[at] = name
    return found.rename_columns(names)


def _rows(found: pa.Table, choices: Choices) -> pa.Table:
    rows = list(range(found.num_rows))
    how = choices.of("how", ("none", "one", "many", "reverse", "again"))
    return found.take({"none": [], "one": rows[:1], "many": rows[:9] * 300, "reverse": rows[::-1]}.get(how, rows * 2))


def _facts(found: pa.Table, choices: Choices) -> pa.Table:
    facts = dict(found.schema.metadata or {})
    key = choices.of("key", FACTS).encode()
    how = choices.of("how", ("text", "remove", "bytes", "toml"))
    before = facts.pop(key, b"")
    if how == "text":
        facts[key] = wild_text(choices).encode()
    elif how == "bytes":
        facts[key] = damage(before, choices)
    elif how == "toml":
        facts[b"roadperc.config"] = mutate_toml(facts.get(b"roadperc.config", before), choices.part("toml"))
    return found.replace_schema_metadata(facts)


FAULTS: dict[str, Callable[[pa.Table, Choices], pa.Table]] = {
    "value": _value, "retype": _retype, "rename": _rename, "rows": _rows, "facts": _facts,
    "remove": lambda found, choices: found.remove_column(_column(found, choices)),
}  # fmt: skip
WEIGHTED = ("value",) * 5 + ("retype",) * 3 + tuple(FAULTS)
