"""The pixels of a class, by numpy."""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


def mark_class(tags: Image, of_class: Image, marks: Image) -> None:
    """Write 1 at pixels of a class, 0 at the others.

    Args:
        tags: (H, W).
        of_class: (256,) 1 at the tags of the class, else 0.
        marks: (H, W), written.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    require_belonging(tags.shape, of_class.shape, marks.shape)
    np.take(of_class, tags, out=marks)


def require_belonging(*shapes: tuple[int, ...]) -> None:
    """Check the shapes of the arrays that ``mark_class`` takes, in its order.

    Raises:
        ValueError: sizes that do not belong together.
    """
    tags, of_class, marks = shapes
    if tags != marks or of_class != (256,):
        raise ValueError(f"{tags} tags of {of_class} into {marks}: expected one size")
