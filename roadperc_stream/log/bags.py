"""Reads the files of ROS bags as MCAP: other formats are copied to MCAP in temporary files.

A copy has the messages, times and definitions of its bag. A bag that can only be read up to some message gives a copy
that is cut there, so that it is reported and recovered as any other damaged log.
"""

import shlex
import sqlite3
from collections.abc import Collection, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path, PurePath
from tempfile import NamedTemporaryFile, TemporaryFile
from types import ModuleType
from typing import IO, Final

import msgspec
import zstandard

from roadperc_stream.config import DEFAULT_LIMITS
from roadperc_stream.errors import LogError, RoadpercError
from roadperc_stream.log.layout import MAGIC
from roadperc_stream.log.records import Channel, Message
from roadperc_stream.log.salvage import Salvage
from roadperc_stream.log.stored import BLOCK_BYTES, Spool, StoredLog, storing
from roadperc_stream.log.writing import StoredLogWriter
from roadperc_stream.system.files import BAG_METADATA, is_bag_folder

_ZSTD: Final = b"\x28\xb5\x2f\xfd"
"""First bytes of a Zstandard frame; no CDR message begins with them."""
_SUFFIX: Final = ".zstd"
_SQLITE, _ROS1 = b"SQLite format 3\0", b"#ROSBAG V"
_TABLES: Final = "SELECT name FROM sqlite_master"
_DEFINITIONS: Final = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
_MESSAGES: Final = "SELECT topic_id, timestamp, data FROM messages ORDER BY id"
_QOS: Final = "offered_qos_profiles"
Contents = Iterator[Channel | Message]
"""The channels of a file, then its messages in file order."""


class _Information(msgspec.Struct):
    """The fields of metadata.yaml that matter here."""

    relative_file_paths: list[str]
    compression_mode: str | None = None
    compression_format: str | None = None


class _Metadata(msgspec.Struct):
    rosbag2_bagfile_information: _Information


@dataclass(frozen=True)
class BagFile:
    """A file, of a bag or not; in some MCAP files of bags each message is compressed."""

    path: Path
    zstd_messages: bool = False


def bag_files(path: Path) -> list[BagFile]:
    """Return the files of a ROS 2 bag's folder; a path to anything else is returned as it is.

    Raises:
        LogError: metadata.yaml cannot be read or names no files, a file is missing, or the compression is unknown.
    """
    described = path / BAG_METADATA
    if not is_bag_folder(path):
        return [BagFile(path)]
    there = list[Path]()
    try:
        there += sorted(file for file in path.iterdir() if {".mcap", ".db3"} & set(file.suffixes))
        found = msgspec.yaml.decode(described.read_bytes(), type=_Metadata).rosbag2_bagfile_information
    except (OSError, ValueError, msgspec.MsgspecError, RecursionError) as error:
        raise LogError(f"{described}: {_line(error)}{_without(there)}") from error
    mode, name = (found.compression_mode or "none").lower(), found.compression_format or "none"
    if mode != "none" and name != "zstd":
        raise LogError(f"{described}: compression {name!r}, expected 'zstd'; decompress the files{_without(there)}")
    files = [_existing(path / PurePath(stated).name, there) for stated in found.relative_file_paths]
    if missing := next((file for file in files if file not in there), None):
        raise LogError(f"{missing}: missing, but {BAG_METADATA} names it{_without(there)}")
    if not files:
        raise LogError(f"{described}: names no files{_without(there)}")
    return [BagFile(file, mode == "message") for file in files]


def _existing(path: Path, there: Collection[Path]) -> Path:
    """Return a file's path, with or without the suffix of compressed files if only that file is there."""
    other = path.parent / (path.stem if path.suffix == _SUFFIX else f"{path.name}{_SUFFIX}")
    return other if path not in there and other in there else path


def _without(there: Iterable[Path]) -> str:
    """Return the command that replays existing files of a bag without its metadata.yaml."""
    files = [str(path) for path in there]
    return f"; replay the existing files with: {shlex.join(('roadperc-replay', *files, 'OUT.mcap'))}" if files else ""


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def as_mcap(file: BagFile) -> Path:
    """Return a bag's file as MCAP; files that are neither MCAP nor of a bag are returned as they are.

    Raises:
        LogError: not one message can be read.
        OSError: the file cannot be read.
        TargetError: there is no space for a copy.
    """
    with file.path.open("rb") as stream:
        if stream.read(len(_ZSTD)) != _ZSTD:
            return _copied(file.path, file.path, zstd_messages=file.zstd_messages)
        stream.seek(0)
        with storing(str(file.path)):
            plain = NamedTemporaryFile()  # noqa: SIM115 - the spool closes it
        spool = Spool(str(file.path), plain)
        fault = _decompress(stream, spool)
    if fault and not spool.size_bytes:
        raise LogError(f"{file.path}: {fault}")
    found = _copied(file.path, Path(plain.name))
    return StoredLog.of(file.path, spool, fault) if found == Path(plain.name) else found


def _decompress(stream: IO[bytes], spool: Spool) -> str:
    """Store the decompressed bytes; return why they end early, if they do."""
    fault = ""
    try:
        with zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True) as reader:
            while block := reader.read(BLOCK_BYTES):
                spool.append(block)
    except zstandard.ZstdError as error:
        fault = f"Zstandard: {_line(error)}"
    spool.finish()
    return fault


def _copied(name: Path, place: Path, *, zstd_messages: bool = False) -> Path:
    """Return a copy in MCAP under a name, or ``place`` if its file needs none."""
    with place.open("rb") as stream:
        start = stream.read(len(_SQLITE))
    if start == _SQLITE:
        unpack, file = ("", name) if place == name else (f"zstd -d {shlex.quote(str(name))} && ", name.with_suffix(""))
        repair = f"{unpack}sqlite3 {shlex.quote(str(file))} .recover | sqlite3 recovered.db3"
        return _copy(name, "rosbag2 (db3)", _of_sqlite(place), repair)
    if start.startswith(_ROS1):
        return _copy(
            name, "rosbag (ROS 1)", _ros1().contents_of_ros1(place), f"rosbag reindex {shlex.quote(str(name))}"
        )
    if start.startswith(MAGIC) and zstd_messages:
        return _copy(name, "rosbag2 (compressed messages)", _of_mcap(place), f"roadperc-info {shlex.quote(str(name))}")
    return place


def _ros1() -> ModuleType:
    return import_module("roadperc_stream.log.ros1")  # on use only, because it imports rosbags


def _copy(name: Path, writer: str, contents: Contents, repair: str) -> StoredLog:
    """Return a copy in MCAP, cut where an error occurs; ``repair`` is a command for an unreadable bag."""
    with storing(str(name)):
        file = TemporaryFile()  # noqa: SIM115 - the spool closes it
    log, fault = StoredLogWriter(name, "ros2", f"{writer}, read as MCAP", file=file), ""
    with suppress(_CutError), log:
        try:
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
            log.end_chunk()
            raise _CutError from error
    return StoredLog.of(name, Spool(str(name), file), fault)


class _CutError(Exception):
    """Ends a copy without an index."""


def _plain(message: Message) -> Message:
    """Return a message decompressed.

    Raises:
        ValueError: it cannot be decompressed, or exceeds the limits.
    """
    if not message.data.startswith(_ZSTD):
        return message
    most, at = DEFAULT_LIMITS.message_bytes, f"{message.channel.topic}: message at {message.log_time_ns} ns"
    if (size := zstandard.frame_content_size(message.data)) > most:
        raise ValueError(f"{at}: {size} bytes, expected {most} at most")
    try:
        return replace(message, data=zstandard.ZstdDecompressor().decompress(message.data, max_output_size=most))
    except zstandard.ZstdError as error:
        raise ValueError(f"{at}: {error}") from error


def _of_mcap(place: Path) -> Contents:
    salvage = Salvage(place)
    yield from salvage.messages()
    if not salvage.whole:
        raise ValueError(salvage.damages[0].words)


def _of_sqlite(place: Path) -> Contents:
    """Yield the contents of a db3 file. Before ROS 2 Iron, they do not define the types of messages."""
    is_open = place.with_name(f"{place.name}-wal").exists()  # with messages that a killed recorder left there
    mode = "ro" if is_open else "ro&immutable=1"
    with closing(sqlite3.connect(f"{place.absolute().as_uri()}?mode={mode}", uri=True)) as database:
        database.row_factory = sqlite3.Row
        database.execute("PRAGMA writable_schema = ON")  # reads a cut file too
        tables = {name for (name,) in database.execute(_TABLES)}
        rows = database.execute(_DEFINITIONS) if "message_definitions" in tables else ()
        definitions = {name: (encoding, text.encode()) for name, encoding, text in rows if text}
        channels = {row["id"]: _channel(row, definitions) for row in database.execute("SELECT * FROM topics")}
        yield from channels.values()
        for topic_id, time_ns, data in database.execute(_MESSAGES):
            if topic_id not in channels or not isinstance(data, bytes) or time_ns < 0:
                topic = channels[topic_id].topic if topic_id in channels else f"topic {topic_id}, not described"
                raise ValueError(f"{topic}: message of {type(data).__name__} at {time_ns} ns")
            yield Message(channels[topic_id], time_ns, time_ns, 0, data)


def _channel(row: sqlite3.Row, definitions: dict[str, tuple[str, bytes]]) -> Channel:
    name = row["type"]
    encoding, text = definitions.get(name) or ("ros2msg", _ros1().definition_of(name))
    qos = ((_QOS, str(row[_QOS])),) if _QOS in row.keys() else ()  # noqa: SIM118 - a row is not a mapping
    return Channel(row["name"], row["serialization_format"], name, encoding, text, qos)
