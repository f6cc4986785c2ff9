"""Cuts logs into parts, replays each part as a continuation, and joins the results."""

from dataclasses import replace
from itertools import pairwise

import polars as pl

from roadperc_stream import log
from roadperc_stream.config import load_config
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.output.results import decode_metrics, encode_metrics
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.topics import METRICS_TOPIC
from roadperc_stream.system.time import NS_PER_S
from tests.replaying import replay

CFG = load_config()
WAIT_NS = NS_PER_S
NAMELESS = "0" * 16


def write(path, messages):
    """A log of messages in the order of their log times."""
    with log.LogWriter(path) as writer:
        for message in sorted(messages, key=lambda m: m.log_time_ns):
            writer.write(message)
    return path


def inputs(path):
    return [message for message in log.read(log.summarise(path)) if not is_result(message.channel)]


def with_attachments(source, target, **changed):
    """A copy of a log with other attachments; None removes one."""
    with log.LogWriter(target) as writer:
        for message in log.read(log.summarise(source)):
            writer.write(message)
        for item in log.summarise(source).attachments:
            data = changed.get(item.name, item.data)
            if data is not None:
                writer.attach(replace(item, data=data))
    return target


def cut(messages, times_ns):
    """Messages cut at the times, by log time."""
    edges = [0, *sorted(times_ns), 2**63]
    return [[m for m in messages if first <= m.log_time_ns < end] for first, end in pairwise(edges)]


def replayed(folder, parts, cfg=CFG, **options):
    """Replay each part as a continuation of the previous one; return the results' paths. Empty parts are skipped."""
    made = []
    for k, messages in enumerate(part for part in parts if part):
        source, target = write(folder / f"in_{k}.mcap", messages), folder / f"out_{k}.mcap"
        replay(source, target, cfg, continued=made[-1] if made else None, **options)
        made.append(target)
    return made


def results(paths):
    """All result messages without the log's name, by frame; of a repeated frame the last version."""
    found = {}
    for path in paths:
        found |= _by_frame(path)
    return found


def _by_frame(path):
    frames = {}
    for message in log.read(log.summarise(path)):
        if is_result(message.channel):
            frames.setdefault(message.sequence, []).append(_nameless(message))
    return frames


def _nameless(message):
    data = message.data
    if message.channel.topic == METRICS_TOPIC:
        data = encode_metrics("", replace(decode_metrics(data), log_id=NAMELESS))
    return message.channel.topic, message.log_time_ns, message.publish_time_ns, data


def rows(paths, table):
    """A table's rows without the log's name and without times; of a repeated frame the last version."""
    tables = [pl.read_parquet(sidecar_path(path, table)) for path in paths]
    kept = []
    for k, frame in enumerate(tables):
        later = [pl.read_parquet(sidecar_path(path, "metrics"))["frame"].min() for path in paths[k + 1 :]]
        first_later = min((number for number in later if number is not None), default=None)
        kept.append(frame if first_later is None else frame.filter(pl.col("frame") < first_later))
    whole = pl.concat(kept)
    return whole.drop(
        [name for name in whole.columns if name == "log_id" or (name.endswith("_ms") and name != "sync_skew_ms")]
    )


def assert_same_rows(found, expected):
    """Parts have the rows of the whole; of the columns by hindsight only what the next part finds may be unknown."""
    later = pl.selectors.contains("hindsight")
    assert found.select(~later).equals(expected.select(~later))
    known = found.select(later).select(pl.all().is_not_null())
    kept = expected.select(pl.when(known[name]).then(name).alias(name) for name in known.columns)
    assert found.select(later).equals(kept)
