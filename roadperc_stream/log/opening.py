"""A log's file while it is read: whatever it, the system or the library throws is one error that names it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from roadperc_stream.core.config import LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log.audit import damage_in, salvaged
from roadperc_stream.log.index import UNREADABLE
from roadperc_stream.log.integrity import damaged, require_whole, unopened
from roadperc_stream.log.limits import LimitError, guarded


@contextmanager
def opened(path: Path, limits: LimitsConfig) -> Iterator[IO[bytes]]:
    """Open a log.

    Raises:
        LogError: the file cannot be read, is no MCAP log, is cut, damaged or beyond the limits.
    """
    try:
        with guarded(path, limits) as stream:
            require_whole(path, stream)
            yield stream
    except OSError as error:
        raise unopened(path, error) from error
    except LimitError as error:
        raise LogError(f"{path}: {error}") from error
    except UNREADABLE as error:
        found = salvaged(path, limits)
        words = f"damaged MCAP: {str(error) or type(error).__name__}"
        raise (damaged(path, words) if found.whole else damage_in(found)) from error
