"""What a scan says of a rig: image shift per stage travel, play, drift, shift over the sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.calibration import Calibration
from lensshift.core.defects import still_pixels, stuck_pixels
from lensshift.core.errors import warn_quality
from lensshift.core.lens_field import LensField
from lensshift.core.motion import StageMap
from lensshift.core.types import Burst
from lensshift.registration.blocks import filled
from lensshift.registration.field import fit_field
from lensshift.registration.light import light_allowed_for
from lensshift.registration.likelihood import likely_shifts, with_given
from lensshift.registration.phase import phase_shifts, unlike_frames
from lensshift.registration.picture import alternate, prediction_error
from lensshift.registration.register import UNLIKE, frames_of, say_left_out
from lensshift.registration.robust_fit import BUDGET_PX, jump_in, robust_fit

_PLAY_PASSES = 4  # of play, and where in it the axes stand
_LEAST_MOTION = 1e-3  # of the scan: less is none
_LEAST_FRAMES = 9  # map, play, drift and constant, and some over
_BLIND_SHARE = 0.05  # of the map: 0.02 px of a move by half a pixel, with two standard errors


@dataclass(frozen=True, slots=True, eq=False)
class ScanFit:
    """A calibration and what it leaves unexplained.

    Parameters
    ----------
    calibration : the result
    burst : the scan with its registered offsets, without frames before the axes first moved or of
        another scene
    residual_px : [frame 2] registered offset less what the calibration says
    direction : [frame 2] of the last motion of each axis, +1, -1, or 0 if not known
    field_order : degree of the polynomial over the sensor, 0: the same everywhere; with a lens
        field that of what the scan adds to it
    lens_field : the one that was told, with what the scan adds to it, or None
    jump : in words, after which frame the image lies elsewhere; then the drift is not known
    """

    calibration: Calibration
    burst: Burst
    residual_px: Floats
    direction: Floats
    field_order: int
    lens_field: LensField | None = None
    jump: str = ""


def calibrate(burst: Burst, **options: Any) -> Calibration:
    """Return the calibration of a scan; see `fit_scan`, which returns more."""
    return fit_scan(burst, **options).calibration


def fit_scan(
    burst: Burst,
    *,
    rest_mm: Floats | None = None,
    photometric: bool | None = None,
    registered: bool = False,
    over_sensor: bool = True,
    lens_field: LensField | None = None,
) -> ScanFit:
    """Find how a rig moves the image from a scan over the range of its stage.

        offset_k = M (stage_k - play / 2 direction_k - rest) + v (t_k - t_0) + c

    The shifts of all frames are registered together; the linear model is fitted by robust least
    squares (Huber). Where the scan moves by less than the play, direction is the part of it that
    the axis has gone through. What varies over the sensor comes from all pixels of all frames
    afterwards.

    Parameters
    ----------
    burst : frames at the positions of `calibration_scan_mm`, with `stage_mm` as read back;
        `stage_commanded_mm` tells the direction of approach (else `stage_mm`), `time_s` the drift
        (else none is fitted)
    rest_mm : where the offset is to be 0, by default the middle of the scan
    photometric : whether frames may differ by a factor and a constant; None: if they show it
    registered : whether the offsets of the burst are registered already
    over_sensor : whether the shift may vary over the sensor
    lens_field : what the optics say of how it varies; the scan says what is different

    Raises
    ------
    ValueError
        If the burst has no stage positions, has fewer than 9 frames, or does not span both axes.
    DataError
        If the lens field is of another sensor or lens, or does not reach as far as the scan.

    Warns
    -----
    QualityWarning
        If what is left is more than 0.02 px rms, or frames of another scene are left out.
    """
    stage_mm = _stage(burst)
    if lens_field is not None:
        lens_field.check_camera(burst)
    rest = stage_mm.mean(axis=0) if rest_mm is None else np.asarray(rest_mm, dtype=np.float64)
    direction = _directions(_commanded(burst))
    known_px2: Floats = np.zeros((2 * burst.frame_count, 2 * burst.frame_count))
    if not registered:
        burst, kept, known_px2 = _registered(burst, photometric=photometric)
        direction = direction[kept]
    # Nobody knows on which side of its play an axis stood before it moved.
    known = np.all((direction != 0) | ~_turns(direction), axis=1)
    away_mm, commanded_mm = _stage(burst)[known] - rest, _commanded(burst)[known]
    burst, direction = burst.select(list(np.flatnonzero(known))), direction[known]
    known_px2 = known_px2[np.ix_(np.repeat(known, 2), np.repeat(known, 2))]
    time_s = None if burst.time_s is None else burst.time_s - burst.time_s.mean()
    turns = _turns(direction)
    held = _held(commanded_mm, direction, away_mm, time_s, burst.offset_px, known_px2)
    design = _design(away_mm, held, time_s)
    found, covariance, residual = robust_fit(design, burst.offset_px, known_px2)
    bent, order = None, 0
    if over_sensor:
        effective_mm = away_mm - 0.5 * _play(found, covariance, turns)[0] * held
        known_px = _slip_px(lens_field, effective_mm @ found[:2])
        bent, order, texture_px, doubt_px2 = fit_field(
            burst, design @ found, effective_mm, known_px
        )
        burst = replace(burst, offset_px=burst.offset_px - texture_px)
        known_px2 = known_px2 + (doubt_px2 if lens_field is None else 0.0)
        found, covariance, residual = robust_fit(design, burst.offset_px, known_px2)
    matrix, sigma = found[:2].T, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)).T
    play, play_sigma = _play(found, covariance, turns)
    drift, drift_sigma = 2 * [np.zeros(2)] if time_s is None else (found[-2], sigma[-2])
    scale = len(residual) / max(len(residual) - design.shape[1], 1)
    sigma_px = float(np.sqrt(np.mean(residual**2) * scale))
    told_px2 = np.diagonal(known_px2).reshape(-1, 2).mean(axis=0)
    blind = told_px2 > 0.5 * np.mean(residual**2, axis=0)
    if jump := "" if blind.all() else jump_in(design, burst.offset_px[:, ~blind]):
        warn_quality(jump, 2)
    _warn(sigma_px, matrix, sigma[:2].T, blind=blind)
    if lens_field is not None and bent is not None:
        lens_field, matrix = _refined(lens_field, bent, matrix)
        bent = None
    calibration = Calibration(
        stage_map=StageMap(matrix, None if bent is None else matrix + bent, sigma_px), rest_mm=rest,
        source="measured", px_per_mm_sigma=sigma[:2].T, play_mm=play, play_sigma_mm=play_sigma,
        drift_px_per_s=drift, drift_sigma_px_per_s=drift_sigma,
        notes=_notes(burst, order, lens_field),
    )  # fmt: skip
    return ScanFit(calibration, burst, residual, direction, order, lens_field, jump)


def _notes(burst: Burst, order: int, lens_field: LensField | None) -> dict[str, Any]:
    told: dict[str, Any] = {"frames": burst.frame_count, "shape": list(burst.grid.shape)}
    told |= {"pitch_mm": list(burst.grid.pitch_mm), "field_order": order}
    return told if lens_field is None else told | {"optics": lens_field.optics}


def _slip_px(lens_field: LensField | None, offset_px: Floats) -> Floats | float:
    """Return how much more each pixel shifts than the middle, [axis frame row col]."""
    if lens_field is None:
        return 0.0
    shown_px = lens_field.at(lens_field.states(offset_px)).offset_px
    return np.moveaxis(shown_px - offset_px[:, None, None], -1, 0)


def _refined(field: LensField, bent: Floats, matrix: Floats) -> tuple[LensField, Floats]:
    """Return the field with what a scan adds to it per mm, and the map in the middle."""
    rows, cols = (slice((n - 1) // 2, n // 2 + 1) for n in bent.shape[:2])
    middle = bent[rows, cols].mean(axis=(0, 1))
    whole = matrix + middle
    return field.corrected((bent - middle) @ np.linalg.inv(whole)), whole


def _registered(burst: Burst, *, photometric: bool | None) -> tuple[Burst, Mask, Floats]:
    """Return the scan with registered offsets, without frames of another scene.

    Also which frames [frame] are left, and the covariance [2 frame, 2 frame] of their offsets.
    """
    frames = frames_of(burst, "amplitude")
    stuck = stuck_pixels(frames, burst.valid)
    dead = still_pixels(frames, burst.valid) | (False if stuck is None else stuck)
    burst = replace(burst, valid=burst.valid & ~dead)
    valid = burst.valid
    whole = filled(frames, valid)
    phase_px = phase_shifts(whole, 0)
    kept = ~unlike_frames(whole, phase_px, 0)
    if not kept.all():
        say_left_out(np.flatnonzero(~kept), UNLIKE, None)
        left = burst.select(np.flatnonzero(kept).tolist())
        burst, _, covariance_px2 = _registered(left, photometric=photometric)
        return burst, kept, covariance_px2
    gain, own = light_allowed_for(whole, phase_px, photometric, range(burst.frame_count))
    start_px = _best_of(_starts(burst, phase_px), whole / gain, valid)
    found = likely_shifts(frames / gain, valid, start_px, photometric=own)
    # Where the frames tell nothing, a shift is known to be some pixels at most.
    found = with_given(found, burst.offset_px - burst.offset_px[0], None, said=False)
    burst = replace(
        burst, offset_px=found.offset_px, offset_sigma_px=found.sigma_px, offset_source="registered"
    )
    return burst, kept, found.covariance_px2


def _best_of(starts: list[Floats], frames: Array, valid: Mask) -> Floats:
    """Return the start from which a picture is found that predicts the frames best.

    What stage and play explain is no measure: shifts that are all too small by half fit them as
    well, with as little noise, where a bright area reaches across the sensor.
    """
    level, size = (part(frames, axis=(1, 2), keepdims=True) for part in (np.mean, np.std))
    alike = (frames - level) / np.maximum(size, 1e-300)
    ends = [alternate(alike, valid, one[..., None], 0).place_px[..., 0] for one in starts]
    errors = [prediction_error(alike, valid, end)[0].mean() for end in ends]
    return ends[int(np.argmin(errors))]


def _starts(burst: Burst, phase_px: Floats) -> list[Floats]:
    """Return where registration may begin, relative to the first frame.

    Phase correlation of each frame is rough where content is aliased; what stage and play make of
    all of them is not. The map that planned the scan may be mirrored, or wrong by a tenth.
    """
    design = _design(_stage(burst), _directions(_commanded(burst)), None)
    found, _, _ = robust_fit(design, phase_px, np.zeros((phase_px.size, phase_px.size)))
    smooth_px = design @ found
    starts = [smooth_px - smooth_px[0], phase_px]
    if np.any(burst.offset_px):
        starts.insert(1, burst.offset_px - burst.offset_px[0])
    return starts


def _commanded(burst: Burst) -> Floats:
    return _stage(burst) if burst.stage_commanded_mm is None else burst.stage_commanded_mm


def _stage(burst: Burst) -> Floats:
    if burst.stage_mm is None:
        raise ValueError("the burst has no stage_mm, the positions read back while it was taken")
    count = burst.frame_count
    if count < _LEAST_FRAMES:
        raise ValueError(f"expected a scan of at least {_LEAST_FRAMES} frames, got {count}")
    spread = np.linalg.svd(burst.stage_mm - burst.stage_mm.mean(axis=0), compute_uv=False)
    if spread[1] < 0.05 * spread[0] or spread[0] == 0:
        raise ValueError("expected a scan along both axes of the stage, got positions on a line")
    return burst.stage_mm


def _directions(commanded_mm: Floats) -> Floats:
    """Return the sign of the last motion of each axis at each frame; 0 before it has moved."""
    direction = np.zeros_like(commanded_mm)
    least = _LEAST_MOTION * np.ptp(commanded_mm, axis=0)
    for k in range(1, len(commanded_mm)):
        step = commanded_mm[k] - commanded_mm[k - 1]
        direction[k] = np.where(np.abs(step) > least, np.sign(step), direction[k - 1])
    return direction


def _turns(direction: Floats) -> Mask:
    """Tell which axes were approached from both sides; the play of the others is not known."""
    return np.asarray((direction.max(axis=0) > 0) & (direction.min(axis=0) < 0))


def _held(
    commanded_mm: Floats,
    direction: Floats,
    away_mm: Floats,
    time_s: Floats | None,
    offset_px: Floats,
    known_px2: Floats,
) -> Floats:
    """Return where in its play each axis stands, -1 to 1: its direction if motions exceed it.

    The lens is moved when the play is used up, and else stays (friction holds it).
    """
    turns, held = _turns(direction), direction
    steps_mm = np.abs(np.diff(commanded_mm, axis=0))
    moves = steps_mm > _LEAST_MOTION * np.ptp(commanded_mm, axis=0)
    least_mm = np.min(steps_mm, axis=0, where=moves, initial=np.inf)
    for _ in range(_PLAY_PASSES):
        found, covariance, _ = robust_fit(_design(away_mm, held, time_s), offset_px, known_px2)
        half_mm = 0.5 * np.maximum(_play(found, covariance, turns)[0], 1e-12)
        lens_mm = commanded_mm - half_mm * direction
        for k in range(1, len(lens_mm)):
            place = commanded_mm[k]
            lens_mm[k] = np.clip(lens_mm[k - 1], place - half_mm, place + half_mm)
        held = np.where(2 * half_mm > least_mm, (commanded_mm - lens_mm) / half_mm, direction)
    return held


def _design(away_mm: Floats, direction: Floats, time_s: Floats | None) -> Floats:
    """Return the columns: stage, play of axes that turn, drift, constant."""
    columns = [*away_mm.T, *(direction.T[_turns(direction)])]
    if time_s is not None:
        columns.append(time_s)
    columns.append(np.ones(len(away_mm)))
    return np.stack(columns, axis=-1)


def _play(found: Floats, covariance: Floats, turns: Mask) -> tuple[Floats, Floats]:
    """Return play and its standard error of each axis from the shift between the approaches.

    The column of direction holds - M[:, axis] play / 2.
    """
    matrix, sigma = found[:2].T, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)).T
    play, play_sigma = np.zeros(2), np.zeros(2)
    for column, axis in enumerate(np.flatnonzero(turns), start=2):
        along = matrix[:, axis]
        square = float(along @ along)
        play[axis] = -2.0 * float(along @ found[column]) / square
        play_sigma[axis] = 2.0 * float(np.sqrt(np.sum((along * sigma[column]) ** 2))) / square
    return play, play_sigma


def _warn(sigma_px: float, matrix: Floats, matrix_sigma: Floats, *, blind: Mask) -> None:
    """Warn of a poor calibration; `blind` [2]: what frames tell of their shifts explains it."""
    shares = np.linalg.norm(matrix_sigma, axis=1) / np.linalg.norm(matrix)
    unseen = blind & (shares > _BLIND_SHARE)
    for share, name, told in zip(shares, ("row", "col"), unseen, strict=True):
        if told:
            warn_quality(
                f"the scan tells shifts along {name} to {100 * share:.0f} % only: the scene has "
                "too little texture; put a chart with edges in several directions there",
                3,
            )
    if sigma_px > BUDGET_PX and not unseen.any():
        why = "does the stage repeat, did the scene stand still?"
        if blind.all():
            why = "the frames tell no better: average more of them, more light, more texture"
        warn_quality(
            f"the calibration leaves {sigma_px:.3f} px rms unexplained (want {BUDGET_PX} px); "
            f"{why}",
            3,
        )
