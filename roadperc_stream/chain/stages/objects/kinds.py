"""Which labels may stand for one object."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.semantics import classes_of_label


def kinds(*lists: Sequence[str]) -> tuple[NDArray[np.int64], ...]:
    """For each list of labels their kinds as numbers, the same in all lists.

    Labels of one kind may stand for one object: detectors waver between car, van and truck.
    """
    of_label = [[classes_of_label(label) or (label,) for label in labels] for labels in lists]
    numbers = {kind: number for number, kind in enumerate(dict.fromkeys(k for kinds in of_label for k in kinds))}
    return tuple(np.array([numbers[kind] for kind in kinds], np.int64) for kinds in of_label)
