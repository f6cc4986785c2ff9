"""Names that would command a terminal, and a log and a table full of them."""

import dataclasses

import polars as pl

from roadperc_stream.log import Metadata
from tests import logs
from tests.analytic import box

EVIL = "x\x1b[31m\r\n\x07\x9b2J\u202ez[bold]"
"""Colours, a new line, the bell, C1's way to clear the screen, text from right to left, and rich's own markup."""
SHOWN = r"x\x1b[31m\r\n\x07\x9b2J\u202ez[bold]"
"""The same as it is to be printed."""
COMMANDS = frozenset("\x1b\r\x07\x9b\u202e")


def write_log(path, name=EVIL):
    """A log whose topics, schemas, frames, labels, attachments and metadata are called so."""
    items = [dataclasses.replace(item, topic=f"/{item.role}/{name}") for item in logs.items(roles=logs.ALL[:-1])]
    stamp = items[-1].stamp_ns
    boxes = logs.encoding.encode_detections(stamp, name, [box(name, 20, 60, 60, 90)])
    items.append(logs.Item("detections", stamp, boxes, f"/detections/{name}"))
    items.append(logs.Item("image", stamp + 1, b"no image", f"/image/{name}"))
    with logs.LogWriter(path) as writer:
        for sequence, item in enumerate(items):
            channel = logs.channel(item.role, item.topic, **{name: name})
            writer.write(logs.Message(channel, item.stamp_ns, item.stamp_ns, sequence, item.data))
        odd = dataclasses.replace(logs.foreign().channel, topic=f"/odd/{name}", schema_name=name, message_encoding=name)
        writer.write(dataclasses.replace(logs.foreign(), channel=odd, log_time_ns=stamp, publish_time_ns=stamp))
        writer.describe(Metadata(name, ((name, name),)))
    return path


def topic_options(name=EVIL):
    return [word for role in logs.ALL for word in ("--topic", f"{role}=/{role}/{name}")]


def taint(path, name=EVIL):
    """Put the name into every text of a metrics table but the log's, and into its footer."""
    table = pl.read_parquet(path)
    texts = [c for c, t in table.schema.items() if t == pl.String and c != "log_id"]
    lists = [c for c, t in table.schema.items() if t == pl.List(pl.String)]
    table = table.with_columns(
        *(pl.lit(name).alias(c) for c in texts), *(pl.lit([name], pl.List(pl.String)).alias(c) for c in lists)
    )
    facts = pl.read_parquet_metadata(path) | {"roadperc.version": name, "roadperc.source": name, "roadperc.log": name}
    table.write_parquet(path, metadata={k: v for k, v in facts.items() if not k.startswith("ARROW")})
    return path
