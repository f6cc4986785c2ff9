"""Where a result comes from: version, seed and settings of the replay that wrote it, and the tables beside it."""

import hashlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.config.settings import as_typed, settings_in
from roadperc_stream.errors import ConfigError, TableError
from roadperc_stream.input.earlier_replay import digest_algorithm, replay_record
from roadperc_stream.log import Attachment, Metadata
from roadperc_stream.output.tables import read_footer, sidecar_path
from roadperc_stream.schemas.record import (
    CONFIG_ATTACHMENT,
    CONTINUES_KEY,
    DIGEST_KEY,
    DROPPED_KEY,
    FRAMES_KEY,
    SEED_KEY,
    VERSION_KEY,
    log_id_of,
)


@dataclass(frozen=True)
class ResolvedSetting:
    """A setting that is not at its default."""

    key: str
    value: str
    default: str | None
    """None where this version knows no such setting."""


@dataclass(frozen=True)
class SidecarTable:
    """A table beside the log."""

    path: str
    rows: int | None
    fault: str = ""
    """Why it is none of this log's; empty where it is."""


@dataclass(frozen=True)
class Provenance:
    """What a result says of the replay that wrote it."""

    version: str
    seed: str
    digest: str
    digest_algorithm: str
    digest_found: str | None
    """Digest of the input's messages as they are in the file now; None where they are not there or not all readable."""
    frames: int | None
    continues: str | None
    """Name of the log that it goes on from, as ``log_id``; None where it begins by itself."""
    dropped: Mapping[str, int]
    """Messages by role that belonged to no frame."""
    config_digest: str | None
    settings: tuple[ResolvedSetting, ...]
    config_fault: str
    tables: tuple[SidecarTable, ...]

    @property
    def changed(self) -> bool:
        """Whether the input's messages are not those that were replayed."""
        return self.digest_found is not None and self.digest_found != self.digest


def provenance_of(
    path: Path, metadata: Collection[Metadata], attachments: Iterable[Attachment], digest_found: str | None
) -> Provenance:
    """What the log's metadata record and its configuration say, and whether the tables beside it belong to it."""
    facts = replay_record(metadata)
    toml = next((item.data for item in attachments if item.name == CONFIG_ATTACHMENT), None)
    config_digest = None if toml is None else hashlib.sha256(toml).hexdigest()
    settings, fault = _settings(toml)
    digest = facts.get(DIGEST_KEY, "")
    return Provenance(
        version=facts.get(VERSION_KEY, ""),
        seed=facts.get(SEED_KEY, ""),
        digest=digest,
        digest_algorithm=digest_algorithm(metadata),
        digest_found=digest_found,
        frames=_number(facts.get(FRAMES_KEY, "")),
        continues=facts.get(CONTINUES_KEY),
        dropped={
            name.removeprefix(DROPPED_KEY): _number(value) or 0
            for name, value in facts.items()
            if name.startswith(DROPPED_KEY)
        },
        config_digest=config_digest,
        settings=settings,
        config_fault=fault,
        tables=tuple(_table(sidecar_path(path, name), digest, config_digest) for name in ("metrics", "objects")),
    )


def _settings(toml: bytes | None) -> tuple[tuple[ResolvedSetting, ...], str]:
    """The settings that differ from this version's defaults, or why there is no knowing."""
    if toml is None:
        return (), f"no attachment {CONFIG_ATTACHMENT}"
    try:
        found = settings_in(toml)
    except ConfigError as error:
        return (), f"attachment {CONFIG_ATTACHMENT} is {error}"
    defaults = settings_in(ReplayConfig().to_toml().encode())
    differing = [key for key, value in found.items() if key not in defaults or defaults[key] != value]
    return tuple(ResolvedSetting(key, as_typed(found[key]), _default(defaults, key)) for key in differing), ""


def _default(defaults: Mapping[str, Any], key: str) -> str | None:
    return as_typed(defaults[key]) if key in defaults else None


def _number(text: str) -> int | None:
    return int(text) if text.isdecimal() else None


def _table(path: Path, digest: str, config_digest: str | None) -> SidecarTable:
    if not path.exists():
        return SidecarTable(str(path), None, "is not there")
    try:
        footer = read_footer(path)
    except TableError as error:
        return SidecarTable(str(path), None, str(error).removeprefix(f"{path}: "))
    if footer.log_id not in (None, log_id_of(digest)):
        return SidecarTable(str(path), footer.rows, f"is of log {footer.log_id}")
    if footer.facts.get("config_digest") != config_digest:
        return SidecarTable(str(path), footer.rows, "is of another configuration")
    return SidecarTable(str(path), footer.rows)
