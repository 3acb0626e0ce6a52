"""What the frames say against the picture: where they contradict it, by how much, and likely why.

After solving, each LR pixel is off its prediction by some standard deviations. Noise spreads such
residuals evenly; a shift that was not told, something that moved, another gain leave patterns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import find_objects, label, maximum, maximum_filter

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.gaussian import MEDIAN_SIZE
from lensshift.core.local_means import mean_around
from lensshift.core.order import median
from lensshift.core.types import Burst
from lensshift.forward.operator import LinearOperator, mean_seen, single
from lensshift.reconstruction.displacement import (
    ALLOWED_SHIFT_PX,
    MOST_SQUARE,
    OUTLIER_SQUARE,
    TELLING_SHARE,
    WINDOW_PX,
    around,
    displaced,
    elsewhere,
    fits,
    slopes_of,
    some_pixels,
    usual,
)

# Neighbours of a pixel along rows and columns of its frame.
ALONG = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])
# Frames contradict where what is left is twice the noise and what such shifts explain; so it was
# in 1 of 240 right bursts. Lone outliers raise that limit, by so many of their deviations.
LIMIT, LIMIT_SIGMAS = 4.0, 8.0
# Something moved where a frame contradicts by so much more (as errors of a shift by 0.37 px would);
# of what contradicts around it nothing is believed: all up to the first, none from the second of
# the doubts on. Less may be an error of the model, and a picture of one frame alone loses more than
# that costs, of real frames up to twofold. Chosen on 30 random bursts with a part that moved; on 60
# others what moved is as good as where all that contradicts is taken for movement. What surely lies
# elsewhere (`displaced`) is movement and no such error.
MOVED_DOUBT, MOVED_BELIEF, OTHER_BELIEF = 3.5, (0.5, 0.8), (1.0, 2.5)
# Blocks in which most pixels tell of noise that is larger than told.
BLOCK_PX = 6
# What is left besides the light is at least this part of the noise, which other light inflates.
LEAST_REST = 0.25
# And as light that goes with the slopes of a smooth scene by chance, in standard errors of a fit.
LIGHT_SIGMAS = 3.0
# One frame contradicts alone if no other does in so much of where it does.
ALONE_SHARE = 0.25
# A frame with so much more noise than the best is not the one that says what was where.
UNSURE = 1.1
# What all frames contradict by at least this part of the most is no movement.
ALIKE = 0.5
# What is done about other brightness, and what is left to say where it was done.
ESTIMATED = "photometric=True (--photometric) estimates gain and bias"
NOT_ENOUGH = "the gain and bias found for each frame do not explain it (use fewer by frames=)"
# Standard errors that chi-square has to be larger than 1 by before it counts against `std`.
SIGNIFICANT = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """What is left of the frames.

    Parameters
    ----------
    chi_square : [row col] mean square of the residuals that touch an HR pixel, in units of their
        noise: 1 where all is well
    unexplained : [row col] standard deviation of what chance does not explain of it, in units of
        the frames: the picture is wrong by about as much
    doubt : [frame row col] residual around each LR pixel over what may be, 1 and more where the
        frame contradicts
    against : [frame row col] the same, of the noise as it was told
    off_px : frame -> how far (row, col) it seems to lie from where its shift says, of those that
        contradict as a whole; NaN if they contradict by more than that
    everywhere : whether those would show it in most of the picture, so that nothing else explains
        what they contradict
    brightness : how much gain and bias of a frame differ, over what else is left of it
    more : whether the frames contradict without their own gain and bias as well
    unsure : frames that were told to be noisier than others, by themselves or by their shift
    """

    chi_square: Floats
    unexplained: Floats
    doubt: Floats
    against: Floats
    off_px: dict[int, tuple[float, float]]
    everywhere: bool
    brightness: float
    more: bool
    unsure: frozenset[int]

    @property
    def curable(self) -> bool:
        """Whether a frame shows another scene somewhere, and most lie where they should."""
        in_places = bool(self.off_px or self.doubt.max(initial=0.0) > 1.0)
        return in_places and not (self.lit or self.shifts_wrong)

    @property
    def contradicts(self) -> bool:
        """Whether the frames contradict in any way."""
        return self.lit or self.shifts_wrong or self.curable

    @property
    def shifts_wrong(self) -> bool:
        """Whether half of the frames or more lie elsewhere."""
        return 2 * len(self.off_px) >= len(self.doubt)

    @property
    def lit(self) -> bool:
        """Whether gain and bias differ between frames that lie where they should."""
        return self.brightness >= 1.0 and not self.off_px

    @property
    def first(self) -> int:
        """The frame that says what was where: the first that is sure of its place, if one is."""
        elsewhere = self.unsure.union(self.off_px if self.everywhere else ())
        return next((k for k in range(len(self.doubt)) if k not in elsewhere), 0)

    def weight(self, of_phasors: bool) -> Floats:
        """Return [frame row col] 0 .. 1: how much of each LR pixel to believe in another solution.

        Where a frame or the first one contradicts by far, only the first is believed: what moves is
        shown as it was then. Towards such places the weights of the others fall steadily.
        Phasors are believed where nothing contradicts: a little light from elsewhere turns a phase.
        """
        worst = np.maximum(self.against, self.against[self.first])
        moved, other = (
            np.clip((none - worst) / (none - full), 0.0, 1.0)
            for full, none in (MOVED_BELIEF, OTHER_BELIEF)
        )
        parts, number = label(worst > MOVED_BELIEF[0], np.stack([0 * ALONG, ALONG, 0 * ALONG]))
        peaks = np.asarray(maximum(worst, parts, np.arange(number + 1)))
        far = (parts > 0) & (peaks > MOVED_DOUBT)[parts]
        weight = np.where(far | of_phasors, moved, other)
        weight[self.first] = 1.0
        return np.asarray(weight)

    def explain(self, frames: Sequence[int]) -> str | None:
        """Return what is likely wrong and what to do, None if nothing is.

        Parameters
        ----------
        frames : their numbers in the burst
        """
        if self.lit:
            lit = (
                f"the frames differ in brightness by {self.brightness:.1f} times what they differ "
                f"by otherwise: {ESTIMATED}"
            )
            return f"{lit}; and {self._moved(frames[self.first])}" if self.more else lit
        said = [self._elsewhere(frames)] if self.off_px else []
        if self.doubt.max(initial=0.0) > 1.0 and not (self.off_px and self.everywhere):
            said.append(self._moved(frames[self.first]))
        return "; or ".join(said) or None

    def _elsewhere(self, frames: Sequence[int]) -> str:
        if self.shifts_wrong:
            return (
                f"the frames contradict offset_px: {len(self.off_px)} of {len(self.doubt)} lie "
                "elsewhere than it says; check it, or let `lensshift.register` find it"
            )
        said = []
        for k, (down, right) in self.off_px.items():
            where = f"it lies about ({down:+.1f}, {right:+.1f}) px from where its offset_px says"
            if np.isnan(down):
                where = "it shows another scene, or lies far from where its offset_px says"
            said.append(f"frame {frames[k]} does not fit: {where}")
        at = ", ".join(said)
        return f"{at} (correct it, or leave it out by frames=)"

    def _moved(self, first: int) -> str:
        anywhere, _ = label(self.doubt.max(axis=0) > 1.0)
        rows, cols = find_objects(anywhere)[np.argmax(np.bincount(anywhere.ravel())[1:])]
        shown = f": there the picture shows frame {first}" if self.curable else ""
        return (
            f"something moved at rows {rows.start} .. {rows.stop - 1}, columns {cols.start} .. "
            f"{cols.stop - 1} of the frames{shown} (if nothing moved, check offset_px, "
            "psf_sigma_px and whether the camera turned: register finds it)"
        )


def find_misfit(A: LinearOperator, image: Array, y: Array, sigma: Floats, scale: int) -> Misfit:
    """Compare frames with what a picture predicts.

        chi2 = A^T (|r|^2 / sigma^2) / A^T 1,   r = y - A x

    Parameters
    ----------
    A : HR image [row col] to frames [frame row col]
    image : [row col] the picture x
    y : [frame row col] real or complex
    sigma : [frame row col] noise of each LR pixel, per component; infinite where it was not used
    scale : HR pixels per LR pixel
    """
    parts = 2.0 if y.dtype.kind == "c" else 1.0
    used = np.isfinite(sigma)
    image, y, seen = single(image), single(y), used.astype(np.float32)
    predicted = A.forward(image)
    slopes, contrast = slopes_of(A, image, scale)
    r = np.where(used, y - predicted, 0.0)
    square = np.abs(r) ** 2 / parts
    noise = single(np.where(used, sigma, 1.0) ** 2)
    variance = noise + ALLOWED_SHIFT_PX**2 / parts * contrast
    told = square / variance
    excess = _excess_noise(told, used)
    variance *= excess
    q = told / excess
    # Noise that most pixels refute was found and not read (`learned/belief.py`): no measure alone.
    usual_square = MEDIAN_SIZE**2 if parts == 1.0 else np.log(2.0)  # medians of chi-square
    beside_all = told / max(median(told[used]) / usual_square, 1.0)
    alone = _alone(q)
    limit = _limit(alone, used)
    inner = seen.copy()  # border pixels see what lies beside the picture
    inner[:, [0, -1]] = inner[:, :, [0, -1]] = 0.0
    doubt, against = (
        around(np.minimum(v, MOST_SQUARE), inner, WINDOW_PX, 1.0) / limit for v in (q, beside_all)
    )
    moved = displaced(r, slopes, variance * parts, inner)
    moved *= moved > 1.0  # less is no evidence
    doubt, against = np.maximum(doubt, moved), np.maximum(against, MOVED_DOUBT * moved)
    off_px, everywhere = elsewhere(r, slopes, variance * parts, used, doubt, limit)
    terms = [np.ones_like(r), predicted - predicted.mean(), *slopes]
    brightness, light = _brightness(r, np.stack(terms, axis=1), variance * parts, used, doubt)
    rest = np.abs(r - np.einsum("kt,tkhw->khw", light, np.stack(terms[:2]))) ** 2 / parts
    unlit = around(np.minimum(rest / variance, MOST_SQUARE), inner, WINDOW_PX, 1.0) / limit
    lone = None if off_px or brightness >= 1.0 else _lone_frame(doubt)
    if lone is not None:  # by more than its slopes can tell
        off_px, everywhere = {lone: (np.nan, np.nan)}, True
    if len(y) > 2:  # all frames alike: detail finer than the grid, nothing that moved
        alike = doubt.min(axis=0) > ALIKE * doubt.max(axis=0)
        doubt = np.where(alike, np.minimum(doubt, 1.0), doubt)
    if np.count_nonzero(doubt > 1.0) < WINDOW_PX:  # what contradicts does so in all that see it
        doubt = np.minimum(doubt, 1.0)
    more = bool(np.count_nonzero((unlit > 1.0) & (doubt > 1.0)) >= WINDOW_PX)
    chi = square / noise * seen
    chi_square = np.where(A.adjoint(seen) > 1e-9, mean_seen(A, chi, seen), 1.0)
    unexplained = _unexplained(A, chi, noise, seen * ~alone, parts)
    usual = np.array([s[u].mean() if u.any() else np.inf for s, u in zip(sigma, used, strict=True)])
    unsure = frozenset(np.flatnonzero(usual > UNSURE * usual.min()).tolist())
    return Misfit(
        chi_square, unexplained, doubt, against, off_px, everywhere, brightness, more, unsure
    )


def _excess_noise(q: Array, used: Mask) -> Array:
    """Return [row col] by how much more than told most frames vary around each pixel, at least 1.

    The median of a block of the frame where it is least: noise that is told too small, as where
    light makes it larger, and detail finer than the grid. What moves is somewhere in some frame.
    """
    rows, cols = q.shape[1:]
    tall, wide = -(-rows // BLOCK_PX), -(-cols // BLOCK_PX)
    room = ((0, 0), (0, tall * BLOCK_PX - rows), (0, wide * BLOCK_PX - cols))
    known = np.pad(np.where(used, q, np.nan), room, constant_values=np.nan)
    blocks = known.reshape(len(q), tall, BLOCK_PX, wide, BLOCK_PX).transpose(0, 1, 3, 2, 4)
    ordered = np.sort(blocks.reshape(len(q), tall, wide, -1), axis=-1)  # NaN last
    last = np.maximum(np.isfinite(ordered).sum(axis=-1, keepdims=True) - 1, 0)
    typical = np.take_along_axis(ordered, last // 2, axis=-1)[..., 0]
    typical = np.nan_to_num(np.fmin.reduce(typical, axis=0))
    excess = np.maximum(maximum_filter(typical, 3) / MEDIAN_SIZE**2, 1.0)
    return np.repeat(np.repeat(excess, BLOCK_PX, 0), BLOCK_PX, 1)[:rows, :cols]


def _alone(q: Array) -> Mask:
    """Tell outliers that stand alone: pixels of a camera, none of which the scene knows."""
    far = q > OUTLIER_SQUARE
    return far & (mean_around(far.astype(np.float64), 3, zeros=True) < 1.5 / 9)


def _limit(alone: Mask, used: Mask) -> float:
    """Return how large the mean square in a window has to be, with outliers that stand alone."""
    share = min(float(alone[used].mean()), 0.1)
    rate = share / (1 - share) ** 8  # their eight neighbours are none
    spread = np.sqrt((2 + rate * (MOST_SQUARE - 1) ** 2) / WINDOW_PX**2)
    return max(LIMIT, 1 + rate * (MOST_SQUARE - 1) + LIMIT_SIGMAS * float(spread))


def _unexplained(A: LinearOperator, chi: Array, noise: Array, seen: Array, parts: float) -> Floats:
    """Return [row col] the size of what chance does not explain of chi-square, where seen."""
    nearby, count = (mean_around(v, 3, zeros=True) for v in (chi * seen, seen))
    pooled = mean_seen(A, nearby / np.maximum(count, 1e-9), count)
    samples = np.maximum(A.adjoint(count), 1e-9)
    ones = np.maximum(A.adjoint(np.ones_like(seen)), 1e-9)
    number = 9 * len(seen) * parts * samples / ones
    chance = 1.0 + SIGNIFICANT * np.sqrt(2.0 / np.maximum(number, 1.0))
    excess = np.maximum(pooled / chance - 1.0, 0.0)
    return np.asarray(np.sqrt(excess * mean_seen(A, noise, seen)))


def _brightness(
    r: Array, terms: Array, variance: Array, used: Mask, doubt: Array
) -> tuple[float, Array]:
    """Return the largest difference in gain and bias of a frame over what else is left of it.

    And both of each frame, [frame 2].

    Where a frame contradicts more than it usually does, it counts less: that is not its light.
    Neither is what goes with its slopes, the last of `terms` [frame term row col].
    """
    on = some_pixels(used)
    enough = on.sum(axis=-1) >= WINDOW_PX**2
    found = np.zeros((len(r), 2))
    if not enough.any():
        return 0.0, found
    on, r, terms, variance, doubt = (
        v[enough] for v in (on, *(some_pixels(v) for v in (r, terms, variance, doubt)))
    )
    odd = np.maximum(doubt / np.maximum(usual(doubt, on)[:, None], 1e-12), 1.0)
    fit, covariance = fits(terms, variance * odd**2, r, on)
    fit = fit[:, None]
    own = fit[..., :2] - fit[..., :2].mean(axis=0)  # what all share is the picture's
    found[enough] = own[:, 0]
    lit = terms[:, :2]
    light = np.abs((own @ lit)[:, 0]) ** 2 * on
    # In a smooth scene light goes with slopes, and the fit hardly tells them apart.
    chance = LIGHT_SIGMAS**2 * np.sum((covariance[:, :2, :2] @ lit).conj() * lit, axis=1).real * on
    # A few bright pixels that do not fit have a gain of their own, whatever the dark ones say.
    size, number = np.abs(r - (fit @ terms)[:, 0]), on.sum(axis=-1)
    rest = np.maximum.reduce([
        usual(size, on) / MEDIAN_SIZE, usual(size, light) / MEDIAN_SIZE,
        LEAST_REST * np.sqrt(usual(variance, light)), np.sqrt(chance.sum(axis=-1) / number),
    ])  # fmt: skip
    return float(np.max(np.sqrt(light.sum(axis=-1) / number) / rest)), found


def _lone_frame(doubt: Array) -> int | None:
    """Return the one frame that contradicts in much of the picture, where no other does."""
    share = np.mean(doubt > 1.0, axis=(1, 2))
    worst = int(np.argmax(share))
    alone = np.sum(share > ALONE_SHARE * share[worst]) == 1 and len(doubt) > 2
    return worst if alone and share[worst] > TELLING_SHARE else None


def what_else(part: Burst, channel: str, scale: int) -> str:
    """Say what else lets frames contradict a picture in places; nothing if nothing does."""
    causes = []
    if channel != "phasor" and part.distance_m is not None:
        causes.append(
            "pixels see two distances, whose amplitude is no mean of theirs (channel phasor, with "
            "modulation_hz, allows for it)"
        )
    if part.frame_count > scale**2:
        causes.append(f"there is detail that scale {scale} cannot show (a larger one may)")
    return f"; or {', or '.join(causes)}" if causes else ""
