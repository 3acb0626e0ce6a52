"""Whether the frames fit another reading of the shifts better: sign, axes, unit, order.

As many frames as a square of the scale determine the picture, so wrong shifts fit them to the
noise, and no residual shows it. Pixels that the fit has not seen do: under the right shifts their
neighbours from the other frames predict them best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array, Shifts
from lensshift.core.errors import warn_quality
from lensshift.reconstruction.glance import FAR_PX, Glance
from lensshift.reconstruction.held_out import (
    FOLDS,
    SAME_PX,
    SUSPICIOUS,
    Trial,
    by_solver,
    least_sure,
)
from lensshift.reconstruction.quick_shifts import (
    alike_in_light,
    found_shifts,
    found_turns,
    found_variance_px2,
    low_passed,
    without_lone_waves,
)

CONFIRMING_FOLDS = 2  # of four
# Fewer frames fit a picture however they turn; and in each quarter of it turning has to predict
# better by so many standard errors, and in no sixteenth worse by as many.
LEAST_TURNING, LEAST_QUARTER_T = 4, 2.0
# Frames that tell the given shifts to such errors, small beside the shifts, object to nothing.
AGREED_PX, AGREED_SHARE = 0.1, 0.25
# How much worse the given shifts have to predict: for a closer look, to name a mistake, and where
# none explains it; and by how many standard errors. Of 1266 right bursts only lone gratings beyond
# the Nyquist frequency were doubted, which are taken off since (`without_lone_waves`), and later
# chequers of whole pixels (`by_solver`); of 96 wrong ones 3 were not (two that look the same).
NAMED, UNNAMED, LEAST_T = 1.05, 1.2, 5.0
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
    "shifts that the frames hardly tell": "give the planned offset_px, or take a scene with edges",
    "no simple mistake": "check offset_px, or let `lensshift.register` find it",
}
OTHER_UNIT, NO_MISTAKE = "their unit", "no simple mistake"
STILL, TURNING = "shifts that did not happen", "frames that turn"
HARDLY_TOLD = "shifts that the frames hardly tell"
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
    warn_quality(
        f"the frames contradict offset_px: {seen}; likely {doubt.mistake}: {doubt.cure}",
        stacklevel + 1,
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
    What all this doubts the learned solver has to predict better as well: it knows edges, and that
    they do not tell shifts where all lie at one place of the pixels.

    Parameters
    ----------
    scale : HR pixels per LR pixel, by which a wrong unit would be off
    """
    given, seen = look.given_px, look.seen
    upright = len(given) < LEAST_TURNING or look.about_px is not None
    trial = Trial(look.values, seen, given, look.about_px)
    smooth, found = look.smooth, look.found_px
    first = _doubt([trial], smooth, found, scale) or (None if upright else _turn(trial, smooth))
    if first is None:
        return None
    # Other brightness of a frame looks like a shift of an edge or of a slope; without it, slow
    # slopes show none. But it puts all frames where a mistake has them by chance alone.
    alike = look.values if first.told else alike_in_light(look.values, seen, smooth, given)
    left = without_lone_waves(alike, seen)
    told: Doubt | None = first if first.told else None
    for values in (left,) if first.told else (alike, left):
        if values is None:
            break
        again = low_passed(values, seen)
        if again is None:
            return None
        trial = Trial(values, seen, given, look.about_px)
        found = found_shifts(again, given)
        told = _doubt([trial], again, found, scale) or (None if upright else _turn(trial, again))
        if told is None:
            return None
    if told is None or told.mistake == TURNING:
        return told
    judges = by_solver(alike, seen, given, look.about_px)
    return _doubt(judges, look.smooth, look.found_px, scale, final=True)


def surely_better(look: Glance, offset_px: Shifts, *, solved: bool = False) -> bool:
    """Return whether other shifts of all frames predict pixels better, beyond chance.

    Parameters
    ----------
    solved : whether the solver is asked, for some 30 times the time of a smooth picture
    """
    other_px = offset_px[look.numbers]
    facts = look.values, look.seen, look.given_px, look.about_px
    judges = by_solver(*facts) if solved else (Trial(*facts),)
    return least_sure(judges, other_px - other_px.mean(axis=0), CONFIRMING_FOLDS)[1] >= SURE


def _doubt(
    trials: Sequence[Trial], smooth: Array, found: Shifts, scale: int, *, final: bool = False
) -> Doubt | None:
    """Return the doubt that trials raise; where they are final, of what they predict alone."""
    given = trials[0].given_px
    span_px = float(np.ptp(given, axis=0).max())
    if span_px > FAR_PX:  # beyond the reach of the search
        near = found_shifts(smooth, np.zeros_like(given))
        found = near if least_sure(trials, near, 1)[0] > least_sure(trials, found, 1)[0] else found
    apart_px = found - given
    if np.abs(apart_px).max() < min(AGREED_PX, AGREED_SHARE * span_px or AGREED_PX):
        return None
    readings, square_px2 = _readings(given, found, scale), float(np.sum(apart_px**2))
    count, readings = len(readings), _near_the_best(readings, trials) if final else readings
    sure_px2 = LEAST_T**2 * found_variance_px2(smooth, found)
    first = (found, given / scale, given * scale)
    alike = not final and all(least_sure(trials, one, 1)[0] < SUSPICIOUS for one in first)
    off = np.abs(apart_px - np.median(apart_px, axis=0)).max(axis=1) >= LEAST_OFF_PX
    doubts, close = [], []
    for mistake, other in readings:
        # What the frames tell holds the errors of the shifts too, and predicts a little better.
        left = float(np.sum((other - found) ** 2)) / square_px2
        chance = 1.0 if mistake in FROM_FRAMES else count * left ** (len(given) - 1)
        told = chance <= CHANCE and (1.0 - left) * square_px2 >= sure_px2
        if alike and not told:
            continue
        ratio, t = least_sure(trials, other, FOLDS if final else CONFIRMING_FOLDS)
        sure = t >= LEAST_T
        if (sure and ratio >= NAMED) or (told and (sure if final else ratio >= 1.0)):
            doubts.append(Doubt(mistake, ratio, _factor(given, other), told))
            close += doubts[-1:] if left <= UNEXPLAINED else []
    likely = max((doubt.ratio for doubt in doubts), default=0.0) / SUSPICIOUS
    best = next((doubt for doubt in doubts if doubt.ratio >= likely), None)
    best = best if best is None or best.named else close[0]
    if best is None or best.mistake not in (OTHER_UNIT, NO_MISTAKE):
        return best
    few = off.mean() < LEAST_OFF_SHARE  # as where frames that alias seem to go farther than told
    return None if few or best.ratio < UNNAMED else best


def _near_the_best(
    readings: list[tuple[str, Shifts]], trials: Sequence[Trial]
) -> list[tuple[str, Shifts]]:
    """Return the readings that may predict best: one fold and one width tell the others apart."""
    ratios = [trials[0].compare(other, 1)[0] for _, other in readings]
    least = max(1.0, max(ratios) / UNNAMED)
    return [reading for reading, ratio in zip(readings, ratios, strict=True) if ratio >= least]


def _turn(trial: Trial, smooth: Array) -> Doubt | None:
    """Return the doubt that frames turn or grow as well, if that predicts them better.

    Better than other shifts alone, and in all quarters of the picture: what moves does so in some.
    """
    turned = found_turns(smooth, trial.given_px)
    if turned is None:
        return None
    found_px = found_shifts(smooth, trial.given_px)
    shifted = Trial(trial.values, trial.seen, found_px, None)
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
