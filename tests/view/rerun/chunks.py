"""Reads Rerun recordings for tests."""

from collections import defaultdict
from dataclasses import dataclass, field

import pyarrow as pa
from rerun.chunk import RrdReader


@dataclass
class Entity:
    """Rows of an entity as dicts by column, and its archetypes."""

    rows: list = field(default_factory=list)
    static: list = field(default_factory=list)
    archetypes: set = field(default_factory=set)

    def column(self, name):
        """Non-empty cells in log-time order."""
        ordered = sorted((row for row in self.rows if row.get(name) is not None), key=lambda r: r["message_log_time"])
        return [row[name] for row in ordered]


def recorded(path):
    """Entities of a .rrd file."""
    return _entities(RrdReader(path).stream())


def _in_nanoseconds(batch):
    """The batch with times in nanoseconds, since Python's datetime has microseconds only."""
    columns = [c.cast("int64") if pa.types.is_timestamp(c.type) else c for c in batch.columns]
    return pa.RecordBatch.from_arrays(columns, batch.schema.names)


def _entities(chunks):
    entities = defaultdict(Entity)
    for chunk in chunks:
        batch = chunk.to_record_batch()
        entity = entities[chunk.entity_path]
        (entity.static if chunk.is_static else entity.rows).extend(_in_nanoseconds(batch).to_pylist())
        entity.archetypes |= {name.partition(":")[0] for name in batch.schema.names if ":" in name}
    return dict(entities)
