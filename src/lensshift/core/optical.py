"""What a lens or a pixel does to contrast: MTF curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import frozen
from lensshift.core.showing import AsTable, Shown


def gaussian_width(mtf50: float) -> float:
    """Return the width of the Gaussian that has its MTF50 there: exp(-2 (pi sigma f)^2) = 1/2."""
    return float(np.sqrt(np.log(2.0) / 2.0) / (np.pi * mtf50))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MtfCurve(Shown, AsTable):
    """Contrast over spatial frequency on the sensor.

    Parameters
    ----------
    frequency_lpmm : [n] rising, line pairs per millimetre
    modulation : [n] contrast, 1 at frequency 0
    std : [n] standard deviation of the modulation, or None
    label : what was measured or computed
    """

    frequency_lpmm: NDArray[np.float64]
    modulation: NDArray[np.float64]
    std: NDArray[np.float64] | None = None
    label: str = ""

    def __post_init__(self) -> None:
        shape = self.frequency_lpmm.shape
        if len(shape) != 1 or np.any(np.diff(self.frequency_lpmm) <= 0):
            raise ValueError(f"expected rising frequencies [n], got shape {shape}")
        if self.modulation.shape != shape or (self.std is not None and self.std.shape != shape):
            raise ValueError(f"expected modulation and std of shape {shape}")
        for name in ("frequency_lpmm", "modulation", "std"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen(getattr(self, name)))
