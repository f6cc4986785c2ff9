"""Reads which replay wrote a result, from its metadata record, its configuration and the tables beside it."""

import hashlib
from collections.abc import Collection, Iterable
from pathlib import Path

from roadperc_stream.config import ReplayConfig
from roadperc_stream.config.settings import NOT_SET, as_typed, is_about_log, settings_in
from roadperc_stream.errors import ConfigError, TableError
from roadperc_stream.info.facts import Provenance, ResolvedSetting, SidecarTable
from roadperc_stream.input.earlier_replay import replay_record
from roadperc_stream.log import Attachment, Metadata
from roadperc_stream.model.finding import decoded_findings
from roadperc_stream.output.tables import read_footer, sidecar_path
from roadperc_stream.schemas import record
from roadperc_stream.system.text import whole_number


def provenance_of(
    path: Path, metadata: Collection[Metadata], attachments: Iterable[Attachment], digest_found: str | None
) -> Provenance:
    """The provenance from a result's metadata record, its configuration and the tables beside it."""
    facts = replay_record(metadata)
    toml = next((item.data for item in attachments if item.name == record.CONFIG_ATTACHMENT), None)
    config_digest = None if toml is None else hashlib.sha256(toml).hexdigest()
    settings, fault = _settings(toml)
    digest = facts.get(record.DIGEST_KEY, "")
    return Provenance(
        version=facts.get(record.VERSION_KEY, ""),
        seed=facts.get(record.SEED_KEY, ""),
        digest=digest,
        digest_found=digest_found,
        frames=whole_number(facts.get(record.FRAMES_KEY, "")),
        continues=facts.get(record.CONTINUES_KEY),
        dropped={
            name.removeprefix(record.DROPPED_KEY): whole_number(value) or 0
            for name, value in facts.items()
            if name.startswith(record.DROPPED_KEY)
        },
        config_digest=config_digest,
        settings=settings,
        config_fault=fault,
        tables=tuple(_table(sidecar_path(path, name), digest, config_digest) for name in ("metrics", "objects")),
        findings=decoded_findings(facts.get(record.FINDINGS_KEY, "")),
    )


def _settings(toml: bytes | None) -> tuple[tuple[ResolvedSetting, ...], str]:
    """The settings that differ from this version's defaults, or why they are unknown."""
    if toml is None:
        return (), f"no attachment {record.CONFIG_ATTACHMENT}"
    try:
        found = settings_in(toml)
    except ConfigError as error:
        return (), f"attachment {record.CONFIG_ATTACHMENT} is {error}"
    defaults = settings_in(ReplayConfig().to_toml().encode())
    differing = [key for key, value in found.items() if key not in defaults or defaults[key] != value]
    known = {key: as_typed(value) for key, value in defaults.items()}
    known |= {key: NOT_SET for key in differing if is_about_log(key)}
    return tuple(ResolvedSetting(key, as_typed(found[key]), known.get(key)) for key in differing), ""


def _table(path: Path, digest: str, config_digest: str | None) -> SidecarTable:
    if not path.exists():
        return SidecarTable(str(path), None, "missing")
    try:
        footer = read_footer(path)
    except TableError as error:
        return SidecarTable(str(path), None, str(error).removeprefix(f"{path}: "))
    log_id = footer.facts.get(record.LOG_ID_KEY)
    if log_id != record.log_id_of(digest):
        return SidecarTable(str(path), footer.rows, f"belongs to log {log_id}")
    if footer.facts.get("config_digest") != config_digest:
        return SidecarTable(str(path), footer.rows, "belongs to another configuration")
    return SidecarTable(str(path), footer.rows)
