"""The folder a sweep writes: there when complete, and a former one replaced only when asked."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import tomli_w

from roadperc_stream import __version__
from roadperc_stream.core.files import METRICS_SUFFIX, completing_folder, target_errors
from roadperc_stream.errors import TableError
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT

from ..runs import distinct_names
from .settings import Combination

MARK: Final = "sweep.toml"
"""The file that makes a folder a sweep's: what was varied, over which logs."""


@contextmanager
def dataset(target: Path, force: bool) -> Iterator[Path]:
    """A folder to fill, which takes its name when all went well and is removed when not.

    Raises:
        TableError: the name is taken: by a former sweep without ``force``, or by anything else.
    """
    _require_free(target, force)
    with completing_folder(target) as hidden:
        yield hidden


def describe(folder: Path, made: Sequence[Combination], logs: Sequence[Path]) -> None:
    """Write what was varied over which logs, and the whole configuration of each combination.

    Raises:
        TargetError: a file cannot be written.
    """
    vary = {key: list(dict.fromkeys(item.settings[key] for item in made)) for key in made[0].settings}
    facts = {"version": __version__, "logs": [str(log.absolute()) for log in logs], "vary": vary}
    texts = {folder / MARK: tomli_w.dumps(facts)}
    texts |= {folder / item.folder / CONFIG_ATTACHMENT: item.cfg.to_toml() for item in made}
    for path, text in texts.items():
        with target_errors(path):
            path.write_text(text, encoding="utf-8")


def table_names(logs: Sequence[Path]) -> list[str]:
    """A file name for each log's tables: after the log, where two share one with the folders that tell them apart."""
    return [
        f"{name.lstrip('/')}{METRICS_SUFFIX}"
        for name in distinct_names([log.with_suffix(METRICS_SUFFIX) for log in logs])
    ]


def tables(folder: Path) -> list[Path]:
    """All tables of a dataset, in the order of the combinations."""
    return sorted(folder.rglob(f"*{METRICS_SUFFIX}"))


def _require_free(target: Path, force: bool) -> None:
    if not target.exists():
        return
    if not target.is_dir():
        raise TableError(f"{target}: is a file, expected the name of a folder")
    if not any(target.iterdir()):
        return
    if not (target / MARK).is_file():
        raise TableError(f"{target}: is a folder with other things in it; name a new one")
    if not force:
        raise TableError(f"{target}: exists already; --force replaces it")
