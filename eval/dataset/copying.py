"""A dataset at an address as one in a folder, for who reads its tables one by one and more than once."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from roadperc_stream.core.files import TABLE_SUFFIX
from roadperc_stream.errors import TableError
from roadperc_stream.storage.fetching import fetch
from roadperc_stream.storage.folder import Folder

from .place import RUNS, Dataset

_AT_ONCE: Final = 16
"""Files are small: most of the time is waiting for the store."""


@contextmanager
def in_a_folder(dataset: Dataset) -> Iterator[Dataset]:
    """The dataset itself, or for the time being a copy of its lists of runs and its metrics tables.

    Raises:
        TableError: it has no tables.
        StorageError: the store cannot be read.
    """
    if dataset.folder is not None:
        yield dataset
        return
    store = Folder(dataset.address)
    files = [*store.files("metrics", TABLE_SUFFIX), *store.files("runs", TABLE_SUFFIX)]
    if not files:
        raise TableError(f"{dataset.address}: no tables in metrics/date=.../, so there is nothing to compare")
    with TemporaryDirectory(prefix="roadperc-compare-") as folder, ThreadPoolExecutor(_AT_ONCE) as threads:
        copies = {file.address: Path(folder, store.name_of(file)) for file in files}
        for target in copies.values():
            target.parent.mkdir(parents=True, exist_ok=True)
        list(threads.map(fetch, copies, copies.values()))
        if (runs := store.read(RUNS)) is not None:
            Path(folder, RUNS).write_bytes(runs)
        yield Dataset(folder)
