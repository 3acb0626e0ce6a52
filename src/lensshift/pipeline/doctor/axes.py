"""Nudge each axis and look where the image goes: which one it is, sign, gain, turn, play."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lensshift.capture.acquire import Acquisition, at_position, check_travel, returning, run_up_mm
from lensshift.capture.rig import Camera, Stage
from lensshift.core.arrays import Floats
from lensshift.core.calibration import Calibration, turn_rad
from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst
from lensshift.io.capture_file import FrameRecord
from lensshift.pipeline.doctor.findings import Finding, Level
from lensshift.registration.likelihood import UNKNOWN_PX
from lensshift.registration.register import register

NUDGE_MM = 0.05  # about a quarter pixel, several times the play
_UNSEEN_PX, _UNSEEN_SIGMAS = 0.03, 3.0  # an axis that moves the image by less is taken to be stuck
_READINGS = 25  # of the position of a lens at rest
_NAMES = ("row", "col")
_PARALLEL = 0.5  # sine of the angle between the ways of the image: 30 degrees
# What is worth a word about a map that calibration puts right anyway.
_OTHER_SCALE, _OTHER_TURN_RAD = 0.05, np.deg2rad(1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Axes:
    """Where the image goes when the axes move."""

    px_per_mm: Floats  # [2 2] image shift (row, col) over travel of stage (row, col)
    sigma_px_per_mm: Floats
    play_mm: Floats  # [2] what is lost when an axis turns round

    @classmethod
    def calibrated(cls, found: Calibration) -> Axes:
        """Return what a calibration says of them."""
        sigma = found.px_per_mm_sigma
        known = np.zeros((2, 2)) if sigma is None else sigma
        return cls(found.stage_map.px_per_mm, known, found.play_mm)

    @property
    def swapped(self) -> bool:
        """Whether stage row moves the image sideways, and col up and down."""
        size = np.abs(self.px_per_mm)
        return bool(size[0, 1] + size[1, 0] > size[0, 0] + size[1, 1])

    @property
    def mirrored(self) -> bool:
        """Whether the image moves along one axis with the stage, along the other against it."""
        return bool(np.linalg.det(self._unswapped) < 0)

    @property
    def turn_rad(self) -> float:
        """Turn of the stage against the image, of the rotation nearest to the map."""
        return turn_rad(self._unswapped * np.sign(np.diagonal(self._unswapped)))

    @property
    def gain_px_per_mm(self) -> Floats:
        """[2] how far the image goes per travel of each axis."""
        return np.asarray(np.linalg.norm(self.px_per_mm, axis=0))

    @property
    def _unswapped(self) -> Floats:
        return self.px_per_mm[:, ::-1] if self.swapped else self.px_per_mm

    @property
    def numbers(self) -> dict[str, Any]:
        """What a page or a program is told."""
        return {
            "px_per_mm": self.px_per_mm,
            "px_per_mm_sigma": self.sigma_px_per_mm,
            "swapped": self.swapped,
            "mirrored": self.mirrored,
            "turn_deg": float(np.rad2deg(self.turn_rad)),
            "play_mm": self.play_mm,
        }


def reading_noise_mm(stage: Stage) -> Floats:
    """Return the noise [2] of the position that is read back while the lens stands."""
    return np.asarray(np.std([stage.position_mm() for _ in range(_READINGS)], axis=0, ddof=1))


def nudge(stage: Stage, camera: Camera, calibration: Calibration, settings: Acquisition) -> Axes:
    """Move each axis by 50 um and back, and register what the camera sees.

        px_per_mm[:, axis] = (o(there) - o(rest)) / (s(there) - s(rest))
        play[axis] along px_per_mm[:, axis] = o(came back) - o(came as ever)

    Every nudge begins at rest, reached in the one direction of the stage, and goes on in it, so
    that no play lies between; the way straight back shows the play. The lens is brought back to
    rest however this ends. ValueError if rest is too near to the end of the travel. DeviceError if
    stage or camera fail.
    """
    rest_mm = np.asarray(calibration.rest_mm)
    way_mm = np.where(np.broadcast_to(run_up_mm(stage, settings), (2,)) < 0, -NUDGE_MM, NUDGE_MM)
    places, direct = [rest_mm], [False]
    for axis in (0, 1):
        places += [rest_mm + way_mm * np.eye(2)[axis], rest_mm, rest_mm]
        direct += [True, True, False]
    check_travel(stage, np.stack(places))
    shots: list[FrameRecord] = []
    with returning(stage, rest_mm) as ending:
        for place, straight in zip(places, direct, strict=True):
            shots += at_position(stage, camera, place, calibration, settings, 1, direct=straight)
            ending.check()
    frames, valid = [one.amplitude for one in shots], [one.valid for one in shots]
    burst = Burst.from_arrays(frames, pitch_mm=camera.grid.pitch_mm, valid=valid)
    # a poor one shows in its standard errors
    with warnings.catch_warnings(action="ignore", category=QualityWarning):
        seen = register(burst, motion="shift")
    read_mm = np.array([one.stage_mm for one in shots])
    return _axes(np.asarray(seen.offset_px), np.asarray(seen.offset_sigma_px), read_mm)


def _axes(offset_px: Floats, sigma_px: Floats, read_mm: Floats) -> Axes:
    per_mm, sigma = np.zeros((2, 2)), np.zeros((2, 2))
    slack_px = np.zeros((2, 2))
    for axis in (0, 1):
        rest, there, back, again = 3 * axis + np.arange(4)
        way_mm = read_mm[there, axis] - read_mm[rest, axis]
        per_mm[:, axis] = (offset_px[there] - offset_px[rest]) / way_mm
        sigma[:, axis] = np.hypot(sigma_px[there], sigma_px[rest]) / abs(way_mm)
        slack_px[axis] = offset_px[back] - offset_px[again]
        slack_px[axis] -= per_mm[:, axis] * (read_mm[back, axis] - read_mm[again, axis])
        slack_px[axis] *= np.sign(way_mm)
    size2 = np.maximum(np.sum(per_mm**2, axis=0), 1e-300)
    play_mm = np.einsum("ai,ia->a", slack_px, per_mm) / size2
    return Axes(per_mm, sigma, play_mm)


def nudge_findings(axes: Axes, noise_px: Floats) -> Iterator[Finding]:
    """Yield what is wrong with a stage that was nudged, by the noise [2] of a position's frames."""
    told_px = axes.sigma_px_per_mm.max(axis=1) * NUDGE_MM
    if told_px.max() > UNKNOWN_PX:
        name, most_px = _NAMES[int(np.argmax(told_px))], told_px.max()
        said = f"shifts along {name} are known to {most_px:.1f} px only: edges in one direction"
        cure = "put a chart with edges in several directions into the view"
        yield Finding(Level.FAULT, "no texture", said, cure)
        return
    size_px = axes.gain_px_per_mm * NUDGE_MM
    error_px = float(np.sqrt(2.0) * np.linalg.norm(noise_px))
    stuck = size_px < max(_UNSEEN_PX, _UNSEEN_SIGMAS * error_px)
    for axis in np.flatnonzero(stuck):
        said = (
            f"axis {_NAMES[axis]} says that it went {1e3 * NUDGE_MM:.0f} um, the image went "
            f"{size_px[axis]:.3f} +- {error_px:.3f} px"
        )
        cure = "look whether the screw touches the mount, for a clamp, for play above 50 um"
        yield Finding(Level.FAULT, "stage blocked", said, cure)
    if not stuck.any() and abs(np.linalg.det(axes.px_per_mm / axes.gain_px_per_mm)) < _PARALLEL:
        said = "both axes move the image the same way"
        yield Finding(Level.FAULT, "axes parallel", said, "is one port given twice?")


def map_findings(axes: Axes, nominal: Calibration) -> Iterator[Finding]:
    """Yield how a measured map differs from that of the rig file; the calibration knows it all."""
    if axes.swapped:
        said = "stage row moves the image sideways, col up and down; the calibration knows"
        yield Finding(Level.NOTE, "axes swapped", said, "exchange row and col in [stage]")
    if axes.mirrored:
        said = "one axis moves the image with it, the other against it; the calibration knows"
        yield Finding(Level.NOTE, "axis mirrored", said)
    if abs(axes.turn_rad) > _OTHER_TURN_RAD:
        said = f"the stage is turned by {np.rad2deg(axes.turn_rad):.1f} degrees against the image"
        yield Finding(Level.NOTE, "stage turned", f"{said}; the calibration knows")
    told = np.linalg.norm(nominal.stage_map.px_per_mm, axis=0)
    other = np.abs(axes.gain_px_per_mm / told - 1.0) > _OTHER_SCALE
    if nominal.source == "nominal" and other.any():
        row, col = axes.gain_px_per_mm
        said = f"the image goes {row:.2f} and {col:.2f} px per mm, the rig file says {told[0]:.2f}"
        yield Finding(Level.NOTE, "other scale", said, "another lens or pitch_mm than written?")
