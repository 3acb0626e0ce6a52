"""What a rig has been found to do: image shift per stage travel, play, drift, blur."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array, Floats, frozen
from lensshift.core.motion import ShiftField, StageMap
from lensshift.core.types import Burst

# Fields that are two numbers (row, col), and widths that may not be known.
PAIRS = ("rest_mm", "play_mm", "play_sigma_mm", "drift_px_per_s", "drift_sigma_px_per_s")
WIDTHS = ("psf_sigma_px", "psf_sigma_sigma_px")


def _zeros() -> Floats:
    return np.zeros(2)


def turn_rad(matrix: Array) -> float:
    """Return the turn of the rotation nearest to a map [2 2], see `Calibration.rotation_rad`.

    Of [[a, b], [c, d]] that is atan2(c - b, a + d): it makes the trace of (rotation^T map) largest.
    """
    mirrors = bool(np.linalg.det(matrix) < 0)
    (a, b), (c, d) = matrix * (1, -1) if mirrors else matrix
    turn = np.arctan2(c - b, a + d)
    return float((turn + np.pi / 2) % np.pi - np.pi / 2 if mirrors else turn)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """From stage positions to image offsets and back, with what else a scan says of the rig.

        offset_px = px_per_mm (stage_mm - rest_mm)

    Parameters
    ----------
    stage_map : image shift (row, col) over stage travel (row, col), also over the sensor
    rest_mm : [2] where the offset is zero
    source : "nominal" (computed from the optics) or "measured" (by a scan)
    px_per_mm_sigma : [2 2] standard deviation of the map
    play_mm, play_sigma_mm : [2] of each axis: what is lost when it turns round
    psf_sigma_px, psf_sigma_sigma_px : width of the blur in LR pixels, None if not measured
    drift_px_per_s, drift_sigma_px_per_s : [2] of the image while the stage stands still
    notes : text and numbers: date, devices, number of frames; `stray_light`, see `StrayLight`
    """

    stage_map: StageMap
    rest_mm: Floats
    source: Literal["nominal", "measured"] = "nominal"
    px_per_mm_sigma: Floats | None = None
    play_mm: Floats = field(default_factory=_zeros)
    play_sigma_mm: Floats = field(default_factory=_zeros)
    psf_sigma_px: float | None = None
    psf_sigma_sigma_px: float | None = None
    drift_px_per_s: Floats = field(default_factory=_zeros)
    drift_sigma_px_per_s: Floats = field(default_factory=_zeros)
    notes: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in PAIRS:
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != (2,) or not np.all(np.isfinite(value)):
                raise ValueError(f"expected two finite numbers {name} (row, col), got {value}")
            object.__setattr__(self, name, frozen(value))
        for name in WIDTHS:
            width_px = getattr(self, name)
            if width_px is not None and not 0.0 <= width_px < np.inf:
                raise ValueError(f"expected a {name} of at least 0, got {width_px}")
        if self.px_per_mm_sigma is not None:
            object.__setattr__(self, "px_per_mm_sigma", frozen(self.px_per_mm_sigma))
        if abs(np.linalg.det(self.stage_map.px_per_mm)) < 1e-12:
            raise ValueError("expected a px_per_mm whose axes are not parallel")

    @property
    def offset_source(self) -> Literal["planned", "calibrated"]:
        """What offsets by this map are called in a burst."""
        return "calibrated" if self.source == "measured" else "planned"

    @property
    def of_camera(self) -> dict[str, Any]:
        """What bursts keep of the notes, as `Burst.meta`: what was measured beside the map."""
        return {name: self.notes[name] for name in ("stray_light",) if name in self.notes}

    @property
    def rotation_rad(self) -> float:
        """Turn of the stage axes against the image axes: of the rotation nearest to the map.

        Of a map that mirrors it is that without the mirror, within a quarter turn either way.
        """
        return turn_rad(self.stage_map.px_per_mm)

    @property
    def cross_talk(self) -> Floats:
        """[2] shift across over shift along, for a move of the row and of the col axis."""
        m = self.stage_map.px_per_mm
        return np.array([m[1, 0] / m[0, 0], m[0, 1] / m[1, 1]])

    @property
    def rotation_sigma_rad(self) -> float | None:
        """Standard error of the turn, None if that of the map is not known."""
        if self.px_per_mm_sigma is None:
            return None
        (a, b), (c, d) = self.stage_map.px_per_mm
        (da, db), (dc, dd) = self.px_per_mm_sigma
        sign = np.sign(np.linalg.det(self.stage_map.px_per_mm))  # see `turn_rad`
        along, across = a + sign * d, c - sign * b
        error = np.hypot(along * np.hypot(db, dc), across * np.hypot(da, dd))
        return float(error / (along**2 + across**2))

    @property
    def cross_talk_sigma(self) -> Floats | None:
        """[2] standard errors of the cross-talk, None if those of the map are not known."""
        if self.px_per_mm_sigma is None:
            return None
        along, across = np.diagonal(self.px_per_mm_sigma), np.diagonal(self.px_per_mm_sigma[::-1])
        error = np.hypot(across, self.cross_talk * along)
        return np.asarray(error / np.abs(np.diagonal(self.stage_map.px_per_mm)))

    def offset_px(self, stage_mm: ArrayLike) -> Floats:
        """Return image offsets [... 2] in the middle of the sensor for positions [... 2]."""
        away_mm = np.asarray(stage_mm, dtype=np.float64) - self.rest_mm
        return np.asarray(away_mm @ self.stage_map.px_per_mm.T)

    def offset_sigma_px(self, stage_mm: ArrayLike) -> Floats:
        """Return standard errors [... 2] of `offset_px`: of each place, and of the map."""
        away_mm = np.asarray(stage_mm, dtype=np.float64) - self.rest_mm
        of_map = np.zeros((2, 2)) if self.px_per_mm_sigma is None else self.px_per_mm_sigma
        return np.asarray(np.sqrt(self.stage_map.sigma_px**2 + away_mm**2 @ of_map.T**2))

    def stage_mm(self, offset_px: ArrayLike) -> Floats:
        """Return the stage positions [... 2] that make image offsets [... 2]."""
        wanted = np.asarray(offset_px, dtype=np.float64)
        return np.asarray(wanted @ np.linalg.inv(self.stage_map.px_per_mm).T + self.rest_mm)

    def shift_field(self, stage_mm: ArrayLike) -> ShiftField:
        """Return the offset of every pixel for positions [frame 2].

        Raises
        ------
        ValueError
            If the map is one number for the whole sensor.
        """
        per_mm = self.stage_map.field_px_per_mm
        if per_mm is None:
            raise ValueError("expected a calibration over the sensor, this one has a single map")
        away_mm = np.atleast_2d(np.asarray(stage_mm, dtype=np.float64)) - self.rest_mm
        return ShiftField(np.einsum("rcij,fj->frci", per_mm, away_mm))

    def applied_to(self, burst: Burst) -> tuple[Burst, ShiftField | None]:
        """Return the burst with the offsets of its stage positions, and those of every pixel.

        Raises
        ------
        ValueError
            If the burst has no stage positions, or another sensor than the calibration.
        """
        if burst.stage_mm is None:
            raise ValueError("expected a burst with stage positions for a calibration")
        told = replace(
            burst,
            offset_px=self.offset_px(burst.stage_mm),
            offset_sigma_px=self.offset_sigma_px(burst.stage_mm),
            offset_source=self.offset_source,
            meta={**burst.meta, **self.of_camera},
        )
        self.check_sensor(burst.grid.shape)
        one = self.stage_map.field_px_per_mm is None
        return told, None if one else self.shift_field(burst.stage_mm)

    def check_sensor(self, shape: tuple[int, int]) -> None:
        """Refuse a sensor of another shape than the map over the sensor has.

        Raises
        ------
        ValueError
            With both shapes.
        """
        per_mm = self.stage_map.field_px_per_mm
        if per_mm is not None and per_mm.shape[:2] != shape:
            raise ValueError(f"expected a calibration of {shape} pixels, got {per_mm.shape[:2]}")
