"""Reads the files of ROS bags as MCAP: other formats are copied to MCAP in temporary files.

A copy has the messages, times and definitions of its bag. A bag that is damaged behind its first messages gives a copy
that is cut there, so that it is reported and recovered as any other damaged log.
"""

import re
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path, PurePath
from shlex import join, quote
from tempfile import NamedTemporaryFile, TemporaryFile
from typing import Final

import msgspec
import zstandard

from roadperc_stream.config import DEFAULT_LIMITS
from roadperc_stream.errors import LogError, RoadpercError
from roadperc_stream.log.damage import BAGS, ZSTD, unopened
from roadperc_stream.log.layout import MAGIC
from roadperc_stream.log.records import Channel, Message
from roadperc_stream.log.recovery import Salvage
from roadperc_stream.log.stored import LogFile, fill, received_files, storing
from roadperc_stream.log.writing import LogWriter
from roadperc_stream.system.files import BAG_METADATA, is_bag_folder, read_file

_SQLITE, _ROS1 = BAGS
_PACKED: Final = re.compile(rb"compression_mode:\s*['\"]?message", re.IGNORECASE)
_DEFINITIONS: Final = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
_QOS: Final = "offered_qos_profiles"
_MOST_METADATA_BYTES: Final = 10_000_000
Contents = Iterator[Channel | Message]
"""The channels of a file, then its messages in file order."""


class _Bag(msgspec.Struct):
    """The facts of metadata.yaml that matter here."""

    relative_file_paths: list[str]
    compression_format: str | None = None


def is_log(path: Path) -> bool:
    """Whether a path is a log or a ROS bag, by its name or its first bytes; false if it cannot be read."""
    if path.suffix in (".mcap", ".db3", ".bag") or is_bag_folder(path):
        return True
    with suppress(OSError):
        if path.is_file():
            with path.open("rb") as stream:
                return stream.read(len(MAGIC)).startswith((MAGIC, ZSTD, *BAGS))
    return False


def received(paths: Sequence[Path]) -> tuple[LogFile, ...]:
    """Return logs as ``received_files``; a bag's folder gives all its files, and other formats are copied to MCAP.

    Raises:
        LogError: a bag cannot be read; else as ``received_files``.
        TargetError: there is no space for a copy.
    """
    return tuple(map(_as_mcap, received_files([file for path in paths for file in _files_of(path)])))


def received_file(path: Path) -> LogFile:
    """Return a log in one file; arguments and errors as in ``received``."""
    files = received([path])
    if len(files) > 1:
        raise LogError(f"{path}: a bag of {len(files)} files, expected one; pass one of them, such as {files[0]}")
    return files[0]


def _files_of(path: Path) -> list[Path]:
    """Return the files of a bag's folder; any other path is returned as it is."""
    if not is_bag_folder(path):
        return [path]
    described, there = path / BAG_METADATA, sorted([*path.glob("*.mcap*"), *path.glob("*.db3*")])
    replay = join(("roadperc-replay", *map(str, there), "OUT.mcap"))
    command = f"; replay the existing files with: {replay}" if there else "; copy the whole folder of the bag again"
    try:
        text = read_file(described, _MOST_METADATA_BYTES)
        bag = msgspec.yaml.decode(text, type=dict[str, _Bag])["rosbag2_bagfile_information"]
    except (OSError, ValueError, KeyError, msgspec.MsgspecError, RecursionError) as error:
        raise LogError(f"{described}: cannot be read: {_line(error)}{command}") from error
    if bag.compression_format not in (None, "", "zstd"):
        raise LogError(f"{described}: compression {bag.compression_format!r}, expected 'zstd'; decompress it{command}")
    files = [path / PurePath(name).name for name in bag.relative_file_paths]
    if missing := next((file for file in files if file not in there), None):
        raise LogError(f"{missing}: missing, but {BAG_METADATA} names it{command}")
    if not files:
        raise LogError(f"{described}: names no files{command}")
    return files


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _as_mcap(file: LogFile) -> LogFile:
    """Return a bag's file as MCAP; files that are neither MCAP nor of a bag are returned as they are."""
    name = file.name
    try:
        if file.path != name or not name.is_file():
            return file
        with name.open("rb") as stream:
            if stream.read(len(ZSTD)) != ZSTD:
                return _copied(file)
            stream.seek(0)
            with storing(str(name)):
                plain = NamedTemporaryFile()  # noqa: SIM115 - the log owns it
            fill(plain, name, zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True))
        return _copied(LogFile.temporary(name, plain, Path(plain.name)))  # SQLite needs a file with a name
    except OSError as error:
        raise unopened(name, error) from error
    except zstandard.ZstdError as error:
        raise LogError(f"{name}: {error}; find the damage with: zstd --test {quote(str(name))}") from error


def _copied(file: LogFile) -> LogFile:
    """Return a copy of a bag's file in MCAP, or the file itself if it needs none."""
    name, place = file.name, file.path
    with place.open("rb") as stream:
        start = stream.read(len(MAGIC))
    described = name.parent / BAG_METADATA
    if start == _SQLITE:
        called = quote(str(name))
        repair = f"sqlite3 {called} .recover | sqlite3 recovered.db3" if place == name else f"zstd -d {called}"
        return _copy(name, "rosbag2 (db3)", _of_sqlite(place), repair)
    if start.startswith(_ROS1):
        contents = import_module("roadperc_stream.log.ros1").contents_of_ros1(place)  # on use: it imports rosbags
        return _copy(name, "rosbag (ROS 1)", contents, f"rosbag reindex {quote(str(name))}")
    if start.startswith(MAGIC) and described.is_file() and _PACKED.search(read_file(described, _MOST_METADATA_BYTES)):
        return _copy(name, "rosbag2 (compressed messages)", _of_mcap(file), f"roadperc-info {quote(str(name))}")
    return file


def _copy(name: Path, writer: str, contents: Contents, repair: str) -> LogFile:
    """Return a copy in MCAP, cut where an error occurs; ``repair`` is a command for an unreadable bag."""
    with storing(str(name)):
        file = TemporaryFile()  # noqa: SIM115 - the log owns it
    log, fault = LogWriter(name, "ros2", f"{writer}, read as MCAP", file=file), ""
    try:
        with log, ExitStack() as ending:
            ending.callback(log.end_chunk)
            for item in contents:
                if isinstance(item, Channel):
                    log.register(item)
                else:
                    log.write(_plain(item))
    except RoadpercError:
        raise
    except Exception as error:  # SQLite and rosbags read bytes of any kind, so any error is possible
        fault = _line(error)
        if not log.messages:
            file.close()
            raise LogError(f"{name}: {fault}; repair it with: {repair}") from error
    return LogFile.temporary(name, file, fault=fault)


def _plain(message: Message) -> Message:
    """Return a message decompressed; one beyond the limits stays as it is, and cannot be decoded."""
    data, most = message.data, DEFAULT_LIMITS.message_bytes
    try:
        is_plain = not data.startswith(ZSTD) or zstandard.frame_content_size(data) > most
        return message if is_plain else replace(message, data=zstandard.ZstdDecompressor().decompress(data, most))
    except zstandard.ZstdError as error:
        raise ValueError(f"{message.channel.topic}: message at {message.log_time_ns} ns: {error}") from error


def _of_mcap(file: LogFile) -> Contents:
    salvage = Salvage(file)
    yield from salvage.messages()
    if not salvage.whole:
        raise ValueError(salvage.damages[0].words)


def _of_sqlite(place: Path) -> Contents:
    """Yield the contents of a db3 file; the stdlib reads it, because rosbags reads no damaged one."""
    is_open = place.with_name(f"{place.name}-wal").exists()  # with messages that a killed recorder left there
    uri = f"{place.absolute().as_uri()}?mode=ro{'' if is_open else '&immutable=1'}"
    with closing(sqlite3.connect(uri, uri=True)) as database:
        database.row_factory = sqlite3.Row
        database.execute("PRAGMA writable_schema = ON")  # reads a cut file too
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master")}
        rows = database.execute(_DEFINITIONS) if "message_definitions" in tables else ()  # from ROS 2 Iron on
        definitions = {name: (encoding, text.encode()) for name, encoding, text in rows if text}
        channels = {row["id"]: _channel(row, definitions) for row in database.execute("SELECT * FROM topics")}
        yield from channels.values()
        for topic_id, time_ns, data in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
            channel = channels.get(topic_id)
            if channel is None or not isinstance(data, bytes) or time_ns < 0:
                topic = channel.topic if channel else f"topic {topic_id} without a name"
                raise ValueError(f"{topic}: invalid message at {time_ns} ns")
            yield Message(channel, time_ns, time_ns, 0, data)


def _channel(row: sqlite3.Row, definitions: dict[str, tuple[str, bytes]]) -> Channel:
    name, qos = row["type"], ((_QOS, str(row[_QOS])),) if _QOS in row.keys() else ()  # noqa: SIM118 - no mapping
    if name not in definitions:
        definitions[name] = "ros2msg", import_module("roadperc_stream.log.ros1").definition_of(name)
    return Channel(row["name"], row["serialization_format"], name, *definitions[name], metadata=qos)
