"""What a replay is of, by which a checkpoint or a finished output is known to be the same replay's."""

import hashlib
import json
from collections.abc import Mapping

from roadperc_stream import __version__, log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.errors import TableError
from roadperc_stream.input.earlier_replay import is_result, replay_record
from roadperc_stream.log import LogSummary
from roadperc_stream.output.tables import read_footer
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.schemas.record import (
    BEGIN_ATTACHMENT,
    CONFIG_ATTACHMENT,
    DIGEST_KEY,
    FRAMES_KEY,
    LOG_ID_KEY,
    TOPIC_KEY,
    VERSION_KEY,
)
from roadperc_stream.schemas.topics import result_schemas
from roadperc_stream.state.encoding import encode
from roadperc_stream.state.opening import OpenedLog
from roadperc_stream.state.replay_state import settings_of


def run_of(cfg: ReplayConfig, opened: OpenedLog, target: ReplayTarget) -> dict[str, str]:
    """Everything that decides what a replay writes, by name: two that are equal in it write the same."""
    plan, begin = opened.input.plan, opened.state_for(cfg)
    return {
        **settings_of(cfg),
        "version": __version__,
        "input": plan.first_pass.digest,
        "topics": json.dumps(dict(plan.roles.topics)),
        "frames at most": str(plan.most_frames),
        "pictures": json.dumps(sorted(target.on_request)),
        "results only": str(target.results_only),
        "strict": str(opened.strict),
        "state at the beginning": "" if begin is None else hashlib.sha256(encode(begin)).hexdigest(),
    }


def differences(run: Mapping[str, str], other: Mapping[str, str]) -> tuple[str, ...]:
    """Names of what differs between two replays."""
    return tuple(name for name in {**run, **other} if run.get(name) != other.get(name))


def finished(target: ReplayTarget, cfg: ReplayConfig, opened: OpenedLog) -> LogSummary | None:
    """The output that is there already, where it is that of this replay; None where it is not, or not all is there."""
    if not target.is_complete:
        return None
    summary = log.summarise(target.path)
    attached = {item.name: item.data for item in summary.attachments}
    record, begin = replay_record(summary.metadata), opened.state_for(cfg)
    is_same = (
        record.get(DIGEST_KEY) == opened.input.plan.first_pass.digest
        and record.get(VERSION_KEY) == __version__
        and {key: topic for key, topic in record.items() if key.startswith(TOPIC_KEY)} == opened.input.chosen_topics
        and attached.get(CONFIG_ATTACHMENT) == cfg.to_toml().encode()
        and attached.get(BEGIN_ATTACHMENT) == (None if begin is None else encode(begin))
        and {(channel.topic, is_result(channel)) for channel in summary.channels} == _topics(target, opened)
    )
    return summary if is_same and _are_its_tables(target, record, opened) else None


def _are_its_tables(target: ReplayTarget, record: Mapping[str, str], opened: OpenedLog) -> bool:
    """Whether both tables can be read, and are of the same input and frames as the log."""
    try:
        frames, objects = read_footer(target.metrics), read_footer(target.objects)
    except TableError:
        return False
    log_ids = {frames.facts.get(LOG_ID_KEY), objects.facts.get(LOG_ID_KEY)}
    return log_ids == {opened.input.log_id} and str(frames.rows) == record.get(FRAMES_KEY)


def _topics(target: ReplayTarget, opened: OpenedLog) -> set[tuple[str, bool]]:
    """The topics of what a replay writes, and whether they are its results."""
    copied = () if target.results_only else opened.input.channels
    return {(topic, True) for topic in result_schemas(target.on_request)} | {(c.topic, False) for c in copied}
