"""What the numbers of options can be: NaN, and values in another unit, are refused by name.

A wavelength in um, or a pitch in um, ends somewhere in a trace with words about rays.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import typer

_OF_ACTUATOR_UM = ("actuator_um", "repeatability_um", "backlash_um", "encoder_um", "drift_um")
_MM = "42.7 mm are 42.7, not 42700 or 0.0427"
_SMALL_MM = "50 um are 0.05"
_SHARE = "a share: 2 % are 0.02"
# Option -> least, most, what is usually mixed up. Wider than anything that has been built; what
# the library itself refuses in better words (a noise of 0) is left to it.
_RANGES = {
    "wavelength_nm": (100.0, 20_000.0, "in nm: 0.85 um are 850"),
    "band_nm": (1e-3, 300.0, "in nm: 0.04 um are 40; for one wavelength leave it out"),
    "temperature_c": (-273.15, 200.0, "in degrees Celsius: 293 K are 20"),
    "temperatures_c": (-273.15, 200.0, "in degrees Celsius: 293 K are 20"),
    "pitch_mm": (3e-4, 10.0, "in mm: 155 um are 0.155"),  # `core.units.MOST_PITCH_MM`
    "field_deg": (-89.9, 89.9, "in degrees"),
    "shift_px": (-100.0, 100.0, "in pixels: a quarter of one is 0.25"),
    "shift_error_px": (0.0, 10.0, "in pixels: a hundredth of one is 0.01"),
    "reach_px": (0.0, 100.0, "in pixels: one is 1"),
    "mtf": (1e-3, 1.0, "a share: 90 % are 0.9"),
    "limit": (0.0, 1.0, "a share: 90 % are 0.9"),
    "noise": (0.0, 1.0, _SHARE),
    "focal_length_mm": (0.1, 10_000.0, f"in mm: {_MM}"),
    "object_mm": (0.1, 1e6, "in mm: 3.5 m are 3500"),
    "stop_mm": (1e-3, 1000.0, "in mm: 20 mm are 20"),
    "stop_at_mm": (-1000.0, 1000.0, "in mm: 20 mm are 20"),
    "back_focal_mm": (0.0, 1000.0, "in mm: 2 mm are 2"),
    "track_mm": (0.1, 10_000.0, "in mm: 25 mm are 25"),
    "glass_mm": (0.0, 500.0, "in mm: 800 um are 0.8"),
    "cover": (0.0, 500.0, "in mm: 500 um are 0.5"),
    "edge_mm": (0.0, 100.0, "in mm: 400 um are 0.4"),
    "air_mm": (0.0, 100.0, f"in mm: {_SMALL_MM}"),
    "decenter_mm": (0.0, 10.0, f"in mm: {_SMALL_MM}"),
    "gap_mm": (0.0, 10.0, f"in mm: {_SMALL_MM}"),
    "tilt_deg": (0.0, 45.0, "in degrees: 6 minutes of arc are 0.1"),
    "focal_share": (0.0, 0.9, "a share: 1 % is 0.01"),
    "index": (0.0, 0.3, "as 0.0005"),
    **dict.fromkeys(_OF_ACTUATOR_UM, (0.0, 999.0, "in um: 1 um is 1, not 1000 nm")),
    "f_number": (0.3, 500.0, "the focal length over the aperture"),
    "distortion": (0.0, 1.0, _SHARE),
    "highest_lpmm": (0.1, 10_000.0, "in line pairs per mm"),
    "gamma": (0.01, 10.0, "light = level^gamma: 2.2"),
    "eye_heights": (0.1, 100.0, "in heights of the picture: 2"),
    "aperture_px": (0.0, 64.0, "in pixels: one is 1"),
    "edge_width_px": (0.0, 50.0, "in pixels: two are 2"),
    "noise_m": (0.0, 1.0, "in m: 5 mm are 0.005"),
    "min_step_m": (0.0, 10.0, "in m: 50 mm are 0.05"),
}
_ENDLESS = ("object_mm", "track_mm", "distortion")  # inf: infinitely far, or no limit


def in_range(name: str, value: float) -> float:
    """Return the value of an option, of the one with this field's name.

    Raises
    ------
    typer.BadParameter
        If it is NaN, infinite though it has to end, or beyond what anybody has built.
    """
    least, most, hint = _RANGES.get(name, (-sys.float_info.max, sys.float_info.max, ""))
    if least <= value <= most or (value == math.inf and name in _ENDLESS):
        return value
    expected = f"a number from {least:g} to {most:g}, {hint}" if hint else "a finite number"
    raise typer.BadParameter(
        f"expected {expected}; got {value:g}", param_hint=f"'--{name.replace('_', '-')}'"
    )


def checked(name: str, value: Any) -> Any:
    """Return what was given for an option, if its numbers can be."""
    for one in value if isinstance(value, list) else (value,):
        if isinstance(one, float):
            in_range(name, one)
    return value
