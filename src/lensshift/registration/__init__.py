"""Where the frames lie: shifts from the frames themselves, and what a scan says of the rig."""

from lensshift.registration.calibrate import ScanFit, calibrate, fit_scan
from lensshift.registration.gradient import gradient_shifts
from lensshift.registration.likelihood import ShiftFit, likely_shifts
from lensshift.registration.phase import phase_correlation, phase_shifts
from lensshift.registration.register import METHODS, register
from lensshift.registration.scan import calibration_scan_mm

__all__ = [
    "METHODS",
    "ScanFit",
    "ShiftFit",
    "calibrate",
    "calibration_scan_mm",
    "fit_scan",
    "gradient_shifts",
    "likely_shifts",
    "phase_correlation",
    "phase_shifts",
    "register",
]
