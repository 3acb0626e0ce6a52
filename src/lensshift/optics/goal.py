"""What a lens made of stock lenses has to do."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lensshift.core.grid import Grid
from lensshift.optics.glass import REFERENCE_TEMPERATURE_C, refractive_index
from lensshift.optics.lens import WAVELENGTH_NM, Element, Stop
from lensshift.optics.mtf import Band
from lensshift.optics.which import judged_lpmm


@dataclass(frozen=True, slots=True)
class Goal:
    """What a train of stock lenses has to do.

    Parameters
    ----------
    grid : of the sensor
    focal_length_mm : kept exactly, by the last gap between elements
    object_mm : from the object to the first vertex, or infinite
    stop : at or in front of the first vertex, or as far behind the last vertex of element
        `stop_behind` as its position says
    back_focal_mm : least distance from the last vertex of the train to the sensor
    clearance_mm : least room between neighbouring elements, at the axis and at their edges
    frequency_lpmm : of the MTF; by default the Nyquist frequency of twice as many pixels
    shift_px : by which an element moves the image along both axes
    shift_error_px : largest error of that shift over the sensor
    mtf : least MTF at the corner of the sensor, worst azimuth, element centred and moved
    transmission : least share of the light through the stop that reaches every field
    wavelength_nm : of the light
    band : the light; the wavelength alone if None
    temperature_c : of glass and air
    cover : a plate in front of the sensor, as a window or a filter, or None
    cover_mm : air between the plate and the sensor
    stop_behind : how many elements stand in front of the stop

    Raises
    ------
    ValueError
        If a number is out of range or the stop lies where it cannot be.
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
    wavelength_nm: float = WAVELENGTH_NM
    band: Band | None = None
    temperature_c: float = REFERENCE_TEMPERATURE_C
    cover: Element | None = None
    cover_mm: float = 0.0
    stop_behind: int = 0

    def __post_init__(self) -> None:
        positive = (self.focal_length_mm, self.object_mm, self.back_focal_mm, self.shift_px)
        if not all(value > 0 for value in positive) or not math.isfinite(self.focal_length_mm):
            raise ValueError(
                "expected positive focal length, object and back focal distance and shift, got "
                f"{positive}"
            )
        if not self.clearance_mm >= 0:
            raise ValueError(f"expected a clearance of at least 0 mm, got {self.clearance_mm}")
        if not (self.cover_mm >= 0 and self.stop_behind >= 0):
            raise ValueError(
                f"expected cover_mm and stop_behind of at least 0, got {self.cover_mm} and "
                f"{self.stop_behind}"
            )
        if self.stop_behind == 0 and self.stop.position_mm > 0:
            raise ValueError(
                f"expected a stop at or in front of the first vertex, got "
                f"{self.stop.position_mm} mm behind it; stop_behind puts it between elements"
            )
        if self.stop_behind > 0 and not self.stop.position_mm >= 0:
            raise ValueError(
                f"expected the stop behind element {self.stop_behind}, got "
                f"{self.stop.position_mm} mm"
            )

    @property
    def cover_path_mm(self) -> float:
        """Air as long, for paraxial rays, as from the front of the cover to the sensor."""
        if self.cover is None:
            return 0.0
        light = (self.wavelength_nm, self.temperature_c)
        parts = zip(self.cover.thickness_mm, self.cover.glass, strict=True)
        return sum(t / refractive_index(glass, *light) for t, glass in parts) + self.cover_mm

    @property
    def judged_lpmm(self) -> float:
        """The frequency of the MTF."""
        return judged_lpmm(self.grid, self.frequency_lpmm)
