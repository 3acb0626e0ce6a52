"""Whether the frames fit another reading of the shifts better: sign, axes, unit, order.

As many frames as a square of the scale determine the picture, so wrong shifts fit them to the
noise, and no residual shows it. Pixels that the fit has not seen do: under the right shifts their
neighbours from the other frames predict them best.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array, Mask, Shifts
from lensshift.core.errors import QualityWarning
from lensshift.core.gaussian import MAD_TO_SIGMA
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.least_squares import smooth_fit
from lensshift.forward.model import forward_model
from lensshift.reconstruction.glance import FAR_PX, Glance
from lensshift.reconstruction.quick_shifts import (
    found_shifts,
    found_turns,
    found_variance_px2,
    low_passed,
    without_lone_waves,
)

# Of fewer held-out pixels nothing follows.
LEAST_HELD_OUT = 50
# Of each trial the pixels of one fold, drawn at random, are held out.
FOLDS, CONFIRMING_FOLDS = 4, 2
# A smooth fit of little stiffness follows the scene; what it assumes of the blur hardly matters.
STIFFNESS, ITERATIONS, BLUR_PX, LEAST_SCALE = 0.03, 15, 0.3, 2
# Errors count up to this many robust deviations, or this part of the spread of the scene.
CLIP_SIGMAS, CLIP_CONTRAST = 5.0, 0.5
# Readings whose shifts differ by less from those given are the same.
SAME_PX = 0.02
# Fewer frames fit a picture however they turn; and in each quarter of it turning has to predict
# better by so many standard errors, and in no sixteenth worse by as many.
LEAST_TURNING, LEAST_QUARTER_T = 4, 2.0
# Frames that tell the given shifts to such errors, small beside the shifts, object to nothing.
AGREED_PX, AGREED_SHARE = 0.1, 0.25
# How much worse the given shifts have to predict: for a closer look, to name a mistake, and where
# none explains it; and by how many standard errors. Of 1266 right bursts only lone gratings beyond
# the Nyquist frequency were doubted, which are taken off since (`without_lone_waves`); of 96 wrong
# ones 3 were not (two that cannot be told apart).
SUSPICIOUS, NAMED, UNNAMED, LEAST_T = 1.03, 1.05, 1.2, 5.0
# Of shifts that the frames tell by other means as well, the usual 3 sigma are enough.
SURE = 3.0
# Where no mistake explains it so many frames have to be off; fewer are left out by the solvers.
LEAST_OFF_PX, LEAST_OFF_SHARE = 0.2, 0.25
# Frames lie where a reading has them, not there by chance, if random shifts as far from the given
# ones come as near to any of the readings less often than this.
CHANCE = 0.01
# A mistake explains what the frames tell if it leaves a tenth of the squares: errors of the shifts.
UNEXPLAINED = 0.1

# Of two readings that do as well the first is named.
CURES: Mapping[str, str] = {
    "their sign": "negate offset_px: positive means that the content moved down and right",
    "the sign of the rows": "negate offset_px[:, 0]: positive means that the content moved down",
    "the sign of the columns": "negate offset_px[:, 1]: positive means that it moved right",
    "rows and columns swapped": "give offset_px as (row, col)",
    "rows and columns swapped, and a sign": "give offset_px as (row, col), positive down and right",
    "their unit (HR pixels)": "divide offset_px by the scale: it is in LR pixels",
    "their unit (too small)": "multiply offset_px by the scale: it is in LR pixels",
    "their unit": "multiply offset_px by about {factor:.2g}: it is in LR pixels",
    "shifts that did not happen": "the frames lie at one place: check whether the lens moved",
    "shifts that were not told": "let `lensshift.register` find offset_px: the frames lie apart",
    "the order of the frames": "bring the frames into the order of offset_px",
    "frames that turn": "let `lensshift.register` find shifts and turns",
    "no simple mistake": "check offset_px, or let `lensshift.register` find it",
}
OTHER_UNIT, NO_MISTAKE = "their unit", "no simple mistake"
STILL, TURNING = "shifts that did not happen", "frames that turn"
# Readings that follow from where the frames seem to lie are always near that.
FROM_FRAMES = (OTHER_UNIT, NO_MISTAKE, "shifts that were not told", "the order of the frames")


@dataclass(frozen=True, slots=True)
class Doubt:
    """A reading of the shifts that predicts pixels better than the given one.

    Parameters
    ----------
    mistake : the likely one, a key of `CURES`
    ratio : error at unseen pixels under the given shifts over that under the other reading
    factor : of another unit, by which the given shifts are too small
    told : whether the frames themselves tell these shifts, and not by chance
    """

    mistake: str
    ratio: float
    factor: float = 1.0
    told: bool = False

    @property
    def named(self) -> bool:
        """Whether a mistake of all shifts explains it, not only one of some frames."""
        return self.mistake != NO_MISTAKE

    @property
    def cure(self) -> str:
        """What to do about it."""
        return CURES[self.mistake].format(factor=self.factor)


def warn_of_doubt(doubt: Doubt, *, stacklevel: int = 2) -> None:
    """Warn of what `doubtful_shifts` found, with the cure.

    Warns
    -----
    QualityWarning
        Always.
    """
    seen = f"pixels left out are predicted {doubt.ratio:.2f} times worse than under another reading"
    if doubt.ratio < NAMED:
        seen = "they lie elsewhere, where another reading has them"
    warnings.warn(
        f"the frames contradict offset_px: {seen}; likely {doubt.mistake}: {doubt.cure}",
        QualityWarning,
        stacklevel=stacklevel + 1,
    )


def doubtful_shifts(look: Glance, scale: int) -> Doubt | None:
    """Return what seems to be wrong with the shifts of some frames, or None.

    A smooth picture is fitted to three quarters of the pixels, under the given shifts and under
    others: negated, rows for columns, in another unit, as the frames themselves tell them, in the
    order that comes closest to that, and of frames that also turn and grow. The reading that
    predicts the remaining pixels best is named if the given one errs more by 5 % (20 % where no
    simple mistake explains it), and by five standard errors of the difference. What white noise
    alone does to a reading does not count. So is a reading that predicts no worse if the frames
    seem to lie just where it has them, and by five standard errors not where they were told.
    A wave that holds most of what there is passes for its alias; what is left without it decides.

    Parameters
    ----------
    scale : HR pixels per LR pixel, by which a wrong unit would be off
    """
    given, seen = look.given_px, look.seen
    upright = len(given) < LEAST_TURNING or look.about_px is not None
    trial = _Trial(look.values, seen, given, look.about_px)
    smooth, found = look.smooth, look.found_px
    first = _doubt(trial, smooth, found, scale) or (None if upright else _turn(trial, smooth))
    if first is None:
        return None
    # Other brightness of a frame looks like a shift of an edge; without it, slow slopes show none.
    # But it puts all frames where a mistake has them by chance alone.
    alike = look.values if first.told else _alike(look.values, seen)
    left = without_lone_waves(alike, seen)
    told: Doubt | None = first if first.told else None
    for values in (left,) if first.told else (alike, left):
        if values is None:
            break
        again = low_passed(values, seen)
        if again is None:
            return None
        trial = _Trial(values, seen, given, look.about_px)
        found = found_shifts(again, given)
        told = _doubt(trial, again, found, scale) or (None if upright else _turn(trial, again))
        if told is None:
            break
    return told


def surely_better(look: Glance, offset_px: Shifts) -> bool:
    """Return whether other shifts of all frames predict pixels better, beyond chance."""
    other_px = offset_px[look.numbers]
    trial = _Trial(look.values, look.seen, look.given_px, look.about_px)
    sure = trial.compare(other_px - other_px.mean(axis=0), CONFIRMING_FOLDS)[1]
    return sure >= SURE


def _doubt(trial: _Trial, smooth: Array, found: Shifts, scale: int) -> Doubt | None:
    given = trial.given_px
    span_px = float(np.ptp(given, axis=0).max())
    if span_px > FAR_PX:  # beyond the reach of the search
        near = found_shifts(smooth, np.zeros_like(given))
        found = near if trial.compare(near, 1)[0] > trial.compare(found, 1)[0] else found
    apart_px = found - given
    if np.abs(apart_px).max() < min(AGREED_PX, AGREED_SHARE * span_px or AGREED_PX):
        return None
    readings, square_px2 = _readings(given, found, scale), float(np.sum(apart_px**2))
    sure_px2 = LEAST_T**2 * found_variance_px2(smooth, found)
    first = (found, given / scale, given * scale)
    alike = all(trial.compare(other, 1)[0] < SUSPICIOUS for other in first)
    off = np.abs(apart_px - np.median(apart_px, axis=0)).max(axis=1) >= LEAST_OFF_PX
    doubts, close = [], []
    for mistake, other in readings:
        # What the frames tell holds the errors of the shifts too, and predicts a little better.
        left = float(np.sum((other - found) ** 2)) / square_px2
        chance = 1.0 if mistake in FROM_FRAMES else len(readings) * left ** (len(given) - 1)
        told = chance <= CHANCE and (1.0 - left) * square_px2 >= sure_px2
        if alike and not told:
            continue
        ratio, sure = trial.compare(other, CONFIRMING_FOLDS)
        if (sure >= LEAST_T and ratio >= NAMED) or (told and ratio >= 1.0):
            doubts.append(Doubt(mistake, ratio, _factor(given, other), told))
            close += doubts[-1:] if left <= UNEXPLAINED else []
    likely = max((doubt.ratio for doubt in doubts), default=0.0) / SUSPICIOUS
    best = next((doubt for doubt in doubts if doubt.ratio >= likely), None)
    best = best if best is None or best.named else close[0]
    if best is None or best.mistake not in (OTHER_UNIT, NO_MISTAKE):
        return best
    few = off.mean() < LEAST_OFF_SHARE  # as where frames that alias seem to go farther than told
    return None if few or best.ratio < UNNAMED else best


def _turn(trial: _Trial, smooth: Array) -> Doubt | None:
    """Return the doubt that frames turn or grow as well, if that predicts them better.

    Better than other shifts alone, and in all quarters of the picture: what moves does so in some.
    """
    turned = found_turns(smooth, trial.given_px)
    if turned is None:
        return None
    found_px = found_shifts(smooth, trial.given_px)
    shifted = _Trial(trial.values, trial.seen, found_px, None)
    ratios = []
    for other in (trial, shifted):
        ratio, sure = other.compare(turned, CONFIRMING_FOLDS)
        if sure < LEAST_T or ratio < NAMED:
            return None
        ratios.append(ratio)
    if min(shifted.sure_by_part(turned, CONFIRMING_FOLDS, 2)) < LEAST_QUARTER_T:
        return None
    if min(trial.sure_by_part(turned, CONFIRMING_FOLDS, 4)) < -LEAST_QUARTER_T:
        return None  # something large moved, beside what rests
    return Doubt(TURNING, ratios[0])


class _Trial:
    """Fits to a part of the pixels, and how well they predict the others."""

    def __init__(
        self, values: Array, seen: Mask, given_px: Shifts, about_px: Array | None, seed: int = 0
    ) -> None:
        rng = np.random.default_rng(seed)
        kind = np.complex64 if np.iscomplexobj(values) else np.float32
        self.values, self.seen, self.given_px = values.astype(kind), seen, given_px
        self.about_px = about_px
        self.fold = rng.integers(0, FOLDS, values.shape)
        self.noise = rng.standard_normal(values.shape, np.float32)
        self.cache: dict[tuple[bytes, int, bool], Array] = {}

    def compare(self, other_px: Shifts, folds: int) -> tuple[float, float]:
        """Return the mean error as given over that of a reading, and how sure it is larger.

        The ratio is the smaller one of that of the frames and that beyond what white noise has;
        the second number is the difference in its standard errors.
        """
        over_sensor = other_px.ndim == 4
        given_px = self.given_px[:, None, None] if over_sensor else self.given_px
        if np.abs(other_px - given_px).max() < SAME_PX:
            return 1.0, 0.0
        one, two = self._errors(self.given_px, folds), self._errors(other_px, folds)
        both = np.isfinite(one) & np.isfinite(two)
        if both.sum() < max(LEAST_HELD_OUT, 0.5 * np.isfinite(one).sum()):
            return 1.0, 0.0
        one, two = one[both], two[both]
        quiet = MAD_TO_SIGMA * min(np.median(one), np.median(two))
        clip = max(CLIP_SIGMAS * quiet, CLIP_CONTRAST)
        one, two = np.minimum(one, clip), np.minimum(two, clip)
        if one.mean() >= SUSPICIOUS * two.mean():
            noise = [self._errors(o, FOLDS, noise=True) for o in (self.given_px, other_px)]
            two = two * max(1.0, float(np.nanmean(noise[0]) / np.nanmean(noise[1])))
        sure = (one.mean() - two.mean()) / max(float(np.std(one - two)), 1e-300)
        return float(one.mean() / max(two.mean(), 1e-300)), float(sure * np.sqrt(one.size))

    def sure_by_part(self, other_px: Shifts, folds: int, along: int) -> list[float]:
        """Return the difference of the errors in standard errors, in parts of the picture.

        Parameters
        ----------
        along : parts along each axis
        """
        apart = self._errors(self.given_px, folds) - self._errors(other_px, folds)
        rows = [
            np.array_split(side, along, axis=3) for side in np.array_split(apart, along, axis=2)
        ]
        found = []
        for part in (part for row in rows for part in row):
            one = part[np.isfinite(part)]
            if one.size < 2:  # as where most of it is invalid
                continue
            found.append(float(one.mean() / max(np.std(one), 1e-300) * np.sqrt(one.size)))
        return found

    def _errors(self, offset_px: Shifts, folds: int, *, noise: bool = False) -> Array:
        """Return |error| [fold frame row col] at the pixels held out, NaN elsewhere."""
        return np.stack([self._fold_errors(offset_px, fold, noise) for fold in range(folds)])

    def _fold_errors(self, offset_px: Shifts, fold: int, noise: bool) -> Array:
        key = (offset_px.tobytes(), fold, noise)
        if key not in self.cache:
            y = self.noise if noise else self.values
            if self.about_px is not None:
                offset_px = offset_px[:, None, None] + self.about_px
            kind = "shift_field_px" if offset_px.ndim == 4 else "offset_px"
            # What so many frames may show; thirds of a pixel are coarse steps on a grid of halves.
            scale = max(LEAST_SCALE, math.isqrt(len(y)))
            model = forward_model(
                y.shape[1:], scale, **{kind: offset_px}, blur=GaussianBlur(BLUR_PX)
            )
            usable = self.seen & model.inside
            held = usable & (self.fold == fold)
            A, weight = model.operator, np.where(held, 0.0, usable)
            error = y - A.forward(smooth_fit(A, y, weight, STIFFNESS, ITERATIONS))
            self.cache[key] = np.where(held, np.abs(error), np.nan).astype(np.float64)
        return self.cache[key]


def _readings(given_px: Shifts, found_px: Shifts, scale: int) -> list[tuple[str, Shifts]]:
    """Return likely mistakes and the shifts without them."""
    from scipy.optimize import linear_sum_assignment

    flip_row, flip_col = np.array([-1.0, 1.0]), np.array([1.0, -1.0])
    swapped, untold = given_px[:, ::-1].copy(), np.abs(given_px).max() < SAME_PX
    apart = np.sum((found_px[:, None, :] - given_px[None, :, :]) ** 2, axis=-1)
    return [
        ("their sign", -given_px),
        ("the sign of the rows", given_px * flip_row),
        ("the sign of the columns", given_px * flip_col),
        ("rows and columns swapped", swapped),
        ("rows and columns swapped, and a sign", -swapped),
        ("rows and columns swapped, and a sign", swapped * flip_row),
        ("rows and columns swapped, and a sign", swapped * flip_col),
        ("their unit (HR pixels)", given_px / scale),
        ("their unit (too small)", given_px * scale),
        (STILL, np.zeros_like(given_px)),
        ("the order of the frames", given_px[linear_sum_assignment(apart)[1]]),
        *_by_a_factor(given_px, found_px, scale),
        ("shifts that were not told" if untold else NO_MISTAKE, found_px),
    ]


def _by_a_factor(given_px: Shifts, found_px: Shifts, scale: int) -> list[tuple[str, Shifts]]:
    """Return the shifts in the unit in which they come closest to those found, if they do.

    And if that is none of those that have a name.
    """
    factor = _factor(given_px, found_px)
    if any(abs(factor / named - 1.0) < UNEXPLAINED for named in (1.0, scale, 1.0 / scale)):
        return []
    rest_px, apart_px = factor * given_px - found_px, given_px - found_px
    explained = np.vdot(rest_px, rest_px) <= UNEXPLAINED * np.vdot(apart_px, apart_px)
    return [(OTHER_UNIT, factor * given_px)] if explained and factor > 0 else []


def _factor(given_px: Shifts, other_px: Shifts) -> float:
    """Return how many times as large as the given shifts others are."""
    return float(np.sum(given_px * other_px)) / max(float(np.sum(given_px**2)), 1e-300)


def _alike(values: Array, seen: Mask) -> Array:
    """Return the frames about their means, in units of their spread: no gain, no bias."""
    share = np.maximum(seen.mean(axis=(1, 2), keepdims=True), 1e-12)
    about = np.where(
        seen, values - np.where(seen, values, 0.0).mean((1, 2), keepdims=True) / share, 0.0
    )
    spread = np.sqrt((np.abs(about) ** 2).mean(axis=(1, 2), keepdims=True) / share)
    return np.asarray(about / np.maximum(spread, 1e-300))
