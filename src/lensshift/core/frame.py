"""One exposure of the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import frozen
from lensshift.core.errors import DataError


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One exposure of the camera.

    Parameters
    ----------
    amplitude : [row col] normalised
    distance_m : [row col] radial, or None
    valid : [row col] False where a pixel must not be used
    time_s : when it was taken
    """

    amplitude: NDArray[Any]
    distance_m: NDArray[Any] | None
    valid: NDArray[np.bool_]
    time_s: float

    def __post_init__(self) -> None:
        for name in ("amplitude", "distance_m", "valid"):
            values = getattr(self, name)
            if values is not None and (values.ndim != 2 or values.shape != self.amplitude.shape):
                problem = f"expected [row col] like amplitude, got {values.shape}"
                raise DataError(problem, field=name)
            if values is not None:
                object.__setattr__(self, name, frozen(values))
