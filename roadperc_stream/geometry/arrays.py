"""Array types of the frozen dataclasses, and the check that makes arrays read-only."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Ids = NDArray[np.uint16]
Kind = TypeVar("Kind", bound=np.generic)


def read_only(array: NDArray[Any], dtype: type[Kind], shape: tuple[int | None, ...], name: str) -> NDArray[Kind]:
    """Check an array's dtype and shape (None: any length), forbid writing to it, and return it.

    Raises:
        ValueError: the dtype or shape differs.
    """
    fits = array.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, array.shape, strict=False))
    if array.dtype != np.dtype(dtype) or not fits:
        raise ValueError(f"{name}: expected {np.dtype(dtype)} {shape}, got {array.dtype} {array.shape}")
    array.setflags(write=False)
    return array
