"""What the error of a shift consists of after calibration, and which part to begin with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.pipeline.calibrate import RigCalibration
from lensshift.registration.robust_fit import BUDGET_PX

_BURST_FRAMES, _AWAY_PX = 4, 0.25  # of a square plan, along each axis
_CURES = {
    "registration": "more frames at each position, more light, more texture in the scene",
    "encoder": "look at the cable; a stage with a better encoder",
    "map": "a chart with edges in several directions, more light; does the stage repeat?",
    "model": "does the stage repeat, did anything in the scene move, is the mount loose?",
    "drift": "let camera and bench warm up; clamp both; fewer frames at each position",
}


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Parts of the error of a shift along one axis, in LR pixels rms."""

    registration: float  # of one position of the scan, by what its frames tell
    encoder: float  # noise of the position that is read back, as image shift
    map: float  # of the map, as far as a burst takes the lens from rest
    model: float  # what else the scan leaves unexplained
    drift: float  # of the image during a burst of four positions

    @property
    def parts(self) -> dict[str, float]:
        """Name -> LR pixels rms."""
        return {name: float(getattr(self, name)) for name in _CURES}

    @property
    def shift_px(self) -> float:
        """Error of the shift of a frame of a burst, in LR px rms: without registration."""
        return float(np.sqrt(self.encoder**2 + self.map**2 + self.model**2 + self.drift**2))

    @property
    def good(self) -> bool:
        """Whether it is within what a calibration is wanted to leave."""
        return self.shift_px <= BUDGET_PX and self.registration <= BUDGET_PX

    @property
    def cure(self) -> str:
        """What to do about the largest part."""
        return _CURES[max(self.parts, key=self.parts.__getitem__)]


def error_budget(done: RigCalibration, reading_mm: Floats) -> ErrorBudget:
    """Return the budget of a calibrated rig whose positions [2] are read back with that noise."""
    fit, found = done.fit, done.calibration
    told = fit.burst.offset_sigma_px
    registration = 0.0 if told is None else float(np.sqrt(np.mean(np.square(told))))
    per_mm = found.stage_map.px_per_mm
    encoder = float(np.sqrt(np.mean((per_mm**2) @ reading_mm**2)))
    of_map = np.zeros((2, 2)) if found.px_per_mm_sigma is None else found.px_per_mm_sigma
    away_px = of_map * _AWAY_PX / np.linalg.norm(per_mm, axis=0)
    rest2 = found.stage_map.sigma_px**2 - registration**2 - encoder**2
    drift = 0.0
    if fit.burst.time_s is not None:
        step_s = float(np.median(np.diff(np.sort(fit.burst.time_s))))
        speed = float(np.sqrt(np.mean(found.drift_px_per_s**2)))
        # A steady drift over a time T, about its mean, is v T / sqrt(12) rms.
        drift = speed * _BURST_FRAMES * step_s / np.sqrt(12.0)
    worse = float(np.linalg.norm(away_px, axis=1).max())  # a scene may tell one direction only
    model = float(np.sqrt(max(rest2, 0.0)))
    return ErrorBudget(registration, encoder, worse, model, float(drift))
