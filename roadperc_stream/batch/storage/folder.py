"""Files on this machine or in a store: a folder of results, the files that a text stands for, and copies."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from roadperc_stream.batch.storage.addresses import Parts, is_address, joined, matches, natural, split_pattern, whole
from roadperc_stream.batch.storage.disk import Disk, StoredFile
from roadperc_stream.batch.storage.stores import Store
from roadperc_stream.errors import StorageError
from roadperc_stream.system.files import completing


def place_of(address: str) -> Disk | Store:
    """The file or the folder under an absolute path or an address.

    Raises:
        StorageError: nothing that is installed knows the scheme.
    """
    return Store.of(address) if is_address(address) else Disk(address)


def fetch(address: str, target: Path) -> None:
    """Copy a file here, whole or not at all.

    Args:
        address: of the file.
        target: is replaced where it exists.

    Raises:
        StorageError: the file cannot be read, or changed while it was.
        TargetError: the target cannot be written.
    """
    with completing(target, mark=uuid4().hex) as hidden, hidden.open("wb") as stream:
        place_of(whole(address)).copy_to(stream)


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
    place, found = place_of(base), list[StoredFile]()
    if not is_address(address) or not parts:  # the listing of a store has a file that is named like a pattern as well
        exact = place_of(address).file()
        found = [] if exact is None else [exact]
    if not found:
        listed = list(place.files_below(parts))
        found = [stored for _, stored in listed if stored.address == address] or _selected(listed, parts, suffix)
    if not found:
        kind = f"file that ends in {suffix}" if suffix else "file"
        here = f"no {kind} below this folder" if not parts and place.is_folder() else "no such file or folder"
        raise StorageError(f"{address}: {f'no {kind} has such a name' if parts else here}")
    return found


def _selected(listed: Iterable[tuple[Parts, StoredFile]], parts: Parts, suffix: str) -> list[StoredFile]:
    """Those with a suffix that a pattern stands for, in natural order."""
    ending = suffix.lower()
    found = (stored for names, stored in listed if names[-1].lower().endswith(ending) and matches(parts, names))
    return sorted(found, key=lambda stored: natural(stored.address))


@dataclass(frozen=True)
class Folder:
    """A folder that need not exist; it can be handed to other processes and machines.

    Names of files are relative to it, with slashes. Methods raise a StorageError where a name leads out of the folder,
    where a file cannot be read, and where a store does not take it; a TargetError where a disk does not.

    Attributes:
        address: the absolute path or the address; a relative path is taken from the current folder.
    """

    address: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "address", whole(self.address))

    @property
    def is_local(self) -> bool:
        """Whether it is on this machine, or mounted here."""
        return not is_address(self.address)

    def path(self, name: str) -> Path:
        """The path of a file; for a folder on this machine only.

        Raises:
            StorageError: it is in a store.
        """
        if not self.is_local:
            raise StorageError(f"{self.address}: expected a folder on this machine")
        return Path(joined(self.address, name))

    def read(self, name: str) -> bytes | None:
        """All of a file, None where there is none."""
        return self._place(name).read()

    def write(self, name: str, data: bytes) -> None:
        """Write a file, which appears, or replaces another one, whole or not at all."""
        self._place(name).write(data)

    def put(self, source: Path, name: str) -> None:
        """Move a file of this machine into the folder, where it appears whole or not at all."""
        self._place(name).put(source)

    def remove(self, name: str) -> None:
        """Remove a file; it need not exist."""
        self._place(name).remove()

    def files(self, below: str = "", suffix: str = "") -> list[StoredFile]:
        """Its files, in natural order, hidden ones and hidden folders left out; none where there is no folder.

        Args:
            below: only those of this folder within it.
            suffix: how their names end.
        """
        place = self._place(below) if below else place_of(self.address)
        return _selected(place.files_below(()), (), suffix)

    def name_of(self, stored: StoredFile) -> str:
        """The name, relative to the folder, of a file that ``files`` found.

        Raises:
            StorageError: it is not below the folder.
        """
        name = stored.address.removeprefix(f"{self.address.rstrip('/')}/")
        if name == stored.address:
            raise StorageError(f"{stored.address}: is not below {self.address}")
        return name

    def _place(self, name: str) -> Disk | Store:
        return place_of(joined(self.address, name))
