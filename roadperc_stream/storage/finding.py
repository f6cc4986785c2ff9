"""The files that a path, an address, a folder or a pattern stands for."""

from collections.abc import Iterable, Iterator

from roadperc_stream.errors import StorageError
from roadperc_stream.storage import disk
from roadperc_stream.storage.addresses import is_address, whole
from roadperc_stream.storage.patterns import Parts, matches, natural, split_pattern
from roadperc_stream.storage.stored import StoredFile
from roadperc_stream.storage.stores import store_of


def find_files(pattern: str, suffix: str = ".mcap") -> list[StoredFile]:
    """The files that a text stands for, drive2 before drive10.

    Args:
        pattern: a file, whatever its name ends in; a folder: all files below it; or a glob with ``*``, ``?``,
            ``[..]`` and ``**``. Hidden files and folders are left out where no part names them with its dot.
        suffix: how names end in folders and behind globs, in either case of letters.

    Raises:
        StorageError: nothing was found, or the place cannot be read.
    """
    address = whole(pattern)
    base, parts = split_pattern(address)
    found = list(_found(address, base, parts, suffix))
    if not found:
        raise StorageError(f"{address}: {_nothing(base, parts, suffix)}")
    return sorted(found, key=lambda stored: natural(stored.address))


def files_below(folder: str, suffix: str) -> list[StoredFile]:
    """The files of a folder whose names end so, hidden ones and hidden folders left out; none without the folder."""
    found = _selected(_listed(folder, (), suffix), (), suffix)
    return sorted(found, key=lambda stored: natural(stored.address))


def _found(address: str, base: str, parts: Parts, suffix: str) -> Iterable[StoredFile]:
    """A listing of a store has a file that is named like a pattern as well: no request of its own."""
    if not is_address(address) or not parts:
        exact = store_of(address).file() if is_address(address) else disk.stored_file(address)
        if exact is not None:
            return [exact]
    listed = list(_listed(base, parts, suffix))
    exactly = [stored for _, stored in listed if stored.address == address]
    return exactly or _selected(listed, parts, suffix)


def _listed(base: str, parts: Parts, suffix: str) -> Iterator[tuple[Parts, StoredFile]]:
    if not is_address(base):
        return disk.files_below(base, parts)
    files_alone = len(parts) == 1 and parts[0].lower().endswith(suffix.lower() or "/")
    return store_of(base).files_below(deep=not files_alone)


def _selected(listed: Iterable[tuple[Parts, StoredFile]], parts: Parts, suffix: str) -> Iterator[StoredFile]:
    ending = suffix.lower()
    return (stored for names, stored in listed if names[-1].lower().endswith(ending) and matches(parts, names))


def _nothing(base: str, parts: Parts, suffix: str) -> str:
    """Why nothing was found."""
    kind = f"file that ends in {suffix}" if suffix else "file"
    if parts:
        return f"no {kind} has such a name"
    is_there = any(True for _ in _listed(base, (), "")) if is_address(base) else disk.is_folder(base)
    return f"no {kind} below this folder" if is_there else "no such file or folder"
