"""Arrays: what they are called in annotations, and those that frozen data may hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]
Floats = NDArray[np.float64]
Shifts = Floats  # [frame 2], (row, col) in LR pixels
Mask = NDArray[np.bool_]


def frozen(values: ArrayLike) -> NDArray[Any]:
    """Return a read-only array that nobody else can write to: a copy unless it is one already.

    A camera fills the same buffer again and again; what was checked must not change afterwards.
    """
    array = np.asarray(values)
    if array.flags.writeable or array.base is not None:
        array = array.copy()
        array.flags.writeable = False
    return array
