"""What a lens made of stock lenses has to do."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lensshift.core.grid import Grid
from lensshift.optics.lens import Stop


@dataclass(frozen=True, slots=True)
class Goal:
    """What a train of stock lenses has to do.

    Parameters
    ----------
    grid : of the sensor
    focal_length_mm : kept exactly, by the last gap between elements
    object_mm : from the object to the first vertex, or infinite
    stop : at or in front of the first vertex
    back_focal_mm : least distance from the last vertex to the sensor
    clearance_mm : least room between neighbouring elements, at the axis and at their edges
    frequency_lpmm : of the MTF; by default the Nyquist frequency of twice as many pixels
    shift_px : by which an element moves the image along both axes
    shift_error_px : largest error of that shift over the sensor
    mtf : least MTF at the corner of the sensor, worst azimuth, element centred and moved
    transmission : least share of the light through the stop that reaches every field
    wavelength_nm : of the light

    Raises
    ------
    ValueError
        If a number is out of range or the stop lies behind the first vertex.
    """

    grid: Grid
    focal_length_mm: float
    object_mm: float = math.inf
    stop: Stop = field(default_factory=lambda: Stop(20.0))
    back_focal_mm: float = 2.0
    clearance_mm: float = 0.1
    frequency_lpmm: float | None = None
    shift_px: float = 0.25
    shift_error_px: float = 0.01
    mtf: float = 0.9
    transmission: float = 0.9
    wavelength_nm: float = 850.0

    def __post_init__(self) -> None:
        positive = (self.focal_length_mm, self.object_mm, self.back_focal_mm, self.shift_px)
        if not all(value > 0 for value in positive) or not math.isfinite(self.focal_length_mm):
            raise ValueError(
                "expected positive focal length, object and back focal distance and shift, got "
                f"{positive}"
            )
        if not self.clearance_mm >= 0:
            raise ValueError(f"expected a clearance of at least 0 mm, got {self.clearance_mm}")
        if self.stop.position_mm > 0:
            raise ValueError(
                f"expected a stop at or in front of the first vertex, got "
                f"{self.stop.position_mm} mm behind it"
            )

    @property
    def judged_lpmm(self) -> float:
        """The frequency of the MTF."""
        if self.frequency_lpmm is None:
            return 1.0 / max(self.grid.pitch_mm)
        return self.frequency_lpmm
