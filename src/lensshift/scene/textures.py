"""Reflectance in the near infrared as a function of the place on a surface, in metres.

A texture takes (x_m, y_m), x to the right and y down as one looks at the front of the surface,
and returns the share of the light, 0 to 1, that the surface scatters. Textures are sharp.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Texture = Callable[[Array, Array], NDArray[Any]]


def check_reflectance(**values: float) -> None:
    """Raise ValueError unless every value is a share from 0 to 1."""
    for name, value in values.items():
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"expected {name} from 0 to 1, got {value}")


@dataclass(frozen=True, slots=True)
class Constant:
    """The same reflectance everywhere."""

    value: float

    def __post_init__(self) -> None:
        check_reflectance(reflectance=self.value)

    def __call__(self, x_m: Array, y_m: Array) -> Array:
        """Return the reflectance at (x, y)."""
        return np.full(np.broadcast(x_m, y_m).shape, float(self.value))
