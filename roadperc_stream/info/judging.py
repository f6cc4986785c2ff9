"""Learns a contract from logs, and prints the limits that other logs break."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import LogError, RegressionError
from roadperc_stream.info.contract import broken, learned, read_contract, record, write_contract
from roadperc_stream.info.listing import print_json
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.system.files import require_free
from roadperc_stream.system.text import listed, number, print_line


def learn_contract(logs: Sequence[Path], topics: Sequence[str], cfg: ReplayConfig, path: Path, *, force: bool) -> None:
    """Write the contract that logs keep; options are as in ``list_logs``.

    Raises:
        LogError: a log cannot be opened, is damaged, or has no message.
        TargetError: the file exists and ``force`` is false, or it cannot be written.
    """
    require_free(path, force=force, suffix=".toml")
    recordings = [record([name], parse_topic_options(topics), cfg) for name in logs]
    for name, one in zip(logs, recordings, strict=True):
        if not one.measures.topics or max(one.log["damages"]):
            fault = next(iter(one.words.values())) if one.measures.topics else "no message"
            raise LogError(f"{name}: {fault}; expected a whole log to learn from")
    contract = learned(recordings)
    write_contract(path, contract, [name.name for name in logs], force=force)
    print_line(f"wrote {path}: {number(len(contract.topics), 'topic')}, learned from {number(len(logs), 'log')}")


def judge_logs(logs: Sequence[Path], topics: Sequence[str], cfg: ReplayConfig, path: Path, *, as_json: bool) -> None:
    """Print the limits that each log breaks; the files of a bag's folder are one log.

    ``as_json`` prints the facts of each file on one line, with the key ``contract``.

    Raises:
        ConfigError: the contract is invalid.
        LogError: a log cannot be opened; the others are printed too.
        RegressionError: a log breaks the contract.
    """
    contract, unread, wrong = read_contract(path), list[str](), 0
    for name in logs:
        try:
            recording = record([name], parse_topic_options(topics), cfg)
        except LogError as error:
            unread.append(str(error))
            if as_json:
                print_json({"log": str(name), "error": str(error)})
            continue
        found, new = broken(recording, contract), recording.new_topics(contract)
        wrong += bool(found)
        if as_json:
            judged = {"file": str(path), "broken": [asdict(one) for one in found], "new_topics": new}
            for facts in recording.measures.files:
                print_json(asdict(facts) | {"contract": judged})
            continue
        print_line(f"{name}: breaks {number(len(found), 'limit')} of {path}" if found else f"{name}: keeps {path}")
        notes = [f"note: topics that the contract does not have: {listed(new)}"] if new else []
        for line in (*found, *notes):
            print_line(f"  {line}")
    if unread:
        raise LogError(listed(unread, len(unread)))
    if wrong:
        raise RegressionError(f"{path}: broken by {wrong} of {number(len(logs), 'log')}")
