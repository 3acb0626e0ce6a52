"""Where the frames lie: shifts from the frames themselves, and what a scan says of the rig."""

from lensshift.registration.gradient import gradient_shifts
from lensshift.registration.likelihood import ShiftFit, likely_shifts
from lensshift.registration.phase import phase_correlation, phase_shifts
from lensshift.registration.register import METHODS, register

__all__ = [
    "METHODS",
    "ShiftFit",
    "gradient_shifts",
    "likely_shifts",
    "phase_correlation",
    "phase_shifts",
    "register",
]
