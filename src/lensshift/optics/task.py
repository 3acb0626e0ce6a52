"""What a lens that is designed has to do, and what it must keep to be made."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lensshift.core.grid import Grid
from lensshift.optics.mtf import Band


@dataclass(frozen=True, slots=True)
class Limits:
    """What a lens must keep to be made.

    Parameters
    ----------
    glass_mm : (least, most) thickness on the axis of elements that are made
    edge_mm : least thickness of their glass at the edge
    air_mm : least air between elements, on the axis and at the edge
    back_focal_mm : least distance from the last vertex, of a cover if there is one, to the sensor
    track_mm : largest distance from the first vertex to the sensor
    distortion : largest share that the corner of the image may be off, to either side

    Raises
    ------
    ValueError
        If a number is negative, or the least glass thicker than the most.
    """

    glass_mm: tuple[float, float] = (0.8, math.inf)
    edge_mm: float = 0.4
    air_mm: float = 0.05
    back_focal_mm: float = 0.3
    track_mm: float = math.inf
    distortion: float = math.inf

    def __post_init__(self) -> None:
        numbers = (*self.glass_mm, self.edge_mm, self.air_mm, self.back_focal_mm, self.track_mm)
        if not all(number >= 0 for number in (*numbers, self.distortion)):
            raise ValueError(f"expected limits of at least 0, got {numbers}, {self.distortion}")
        if self.glass_mm[0] > self.glass_mm[1] or math.isinf(self.glass_mm[0]):
            raise ValueError(f"expected glass_mm (least, most), got {self.glass_mm}")


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What a lens has to do.

    Parameters
    ----------
    grid : of the sensor; fields reach to its corner
    focal_length_mm, f_number : kept; the stop is as wide as they want
    limits : of what can be made
    band : the light; the wavelength of the lens alone if None
    temperatures_c : at which it has to be sharp with one place of the sensor; that of the lens if
        empty
    shares : fields, of the half diagonal of the sensor
    """

    grid: Grid
    focal_length_mm: float
    f_number: float
    limits: Limits = Limits()
    band: Band | None = None
    temperatures_c: tuple[float, ...] = ()
    shares: tuple[float, ...] = (0.0, 0.35, 0.6, 0.8, 1.0)

    def __post_init__(self) -> None:
        kept = (self.focal_length_mm, self.f_number)
        if not (all(0 < one < math.inf for one in kept) and self.shares):
            raise ValueError(
                f"expected positive focal length and f-number, and fields, got "
                f"{self.focal_length_mm} mm, {self.f_number} and {self.shares}"
            )
