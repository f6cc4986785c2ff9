"""Which name somebody may have meant."""

import difflib
from collections.abc import Iterable


def nearest(name: str, known: Iterable[str], likeness: float = 0.6) -> str | None:
    """The known name that is most nearly so, None where none is; capitals count as small letters.

    Args:
        name: as it was written.
        known: the names there are.
        likeness: 0 to 1, the ratio of ``difflib`` from which a name is near.
    """
    folded = {candidate.casefold(): candidate for candidate in known}
    close = difflib.get_close_matches(name.casefold(), folded, n=1, cutoff=likeness)
    return folded[close[0]] if close else None
