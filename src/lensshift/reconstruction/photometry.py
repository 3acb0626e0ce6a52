"""Gain and bias of each frame against the burst as a whole."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.defects import NO_CHANCE, unequal_brightness
from lensshift.core.errors import warn_quality
from lensshift.core.gaussian import MEDIAN_ERROR, MEDIAN_SIZE
from lensshift.core.local_means import gaussian_around, mean_around
from lensshift.core.types import Burst, Estimate, Frame
from lensshift.forward.differences import image_slopes
from lensshift.forward.least_squares import smooth_fit
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.displacement import ALLOWED_SHIFT_PX
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.misfit import ESTIMATED, LIMIT
from lensshift.reconstruction.noise import robust_scale
from lensshift.reconstruction.quantiles import ENOUGH, weighted_mad, weighted_median
from lensshift.registration.blocks import filled
from lensshift.registration.light import gains_of_light, light_said
from lensshift.registration.robust_fit import HUBER_SIGMAS

# Rounds end when no gain changes by more than this share, far below what it is off by in the end:
# 0.3 % on boxes and photographs of SNR 100. Each halves what is left, whatever it began with.
SETTLED, MOST_ROUNDS = 1e-3, 16
# Of the light of a frame, if another light is to explain what changed.
LIT = 0.9
# Light is told from what is no farther from it than that, which two rounds find. Less than a tenth
# of noise is farther than twice its deviation.
MOST_SIGMAS, ROUNDS_OF_LIGHT, NOISE_SIGMAS = 3.0, 2, 2.0
# A Gaussian that leaves a hundredth of what pixels cannot tell from its alias, at half a cycle.
LOW_PASS_PX = math.sqrt(2 * math.log(100)) / math.pi


def estimate_photometry(A: LinearOperator, y: Array, weight: Array) -> tuple[Floats, Floats]:
    """Estimate gain and bias [frame] such that y_k = gain_k (A x)_k + bias_k.

    A smooth x is fitted to the corrected frames and each frame is regressed on its prediction
    (Huber weights), in turn. Only ratios and differences between frames can be seen, so the
    geometric mean of the gains is held at 1 and the mean of the biases at 0.

    Parameters
    ----------
    A : HR image [row col] to frames [frame row col], gain 1
    y, weight : [frame row col]

    Raises
    ------
    ValueError
        If the frames are complex.
    """
    if y.dtype.kind == "c":
        raise ValueError("photometric estimation expects real frames, got complex phasors")
    count = len(y)
    gain, bias = np.ones(count), np.zeros(count)
    for _ in range(MOST_ROUNDS):
        before = gain.copy()
        corrected = (y - bias[:, None, None]) / gain[:, None, None]
        seen = A.forward(smooth_fit(A, corrected, weight, 0.03, 20))
        for k in range(count):
            used = weight[k] > 0
            if np.count_nonzero(used) >= 3:
                gain[k], bias[k] = _regress(seen[k][used], y[k][used])
        gain = np.maximum(gain, 1e-3)
        gain /= np.exp(np.mean(np.log(gain)))
        bias -= bias.mean()
        if np.max(np.abs(gain / before - 1.0)) < SETTLED:
            break
    return gain, bias


@dataclass(frozen=True, slots=True, eq=False)
class _Gain:
    """How many times as bright some pixels are as others of the same surfaces.

        g = median y / y' where it is within 3 d,   s = 1.253 d / sqrt n

    Weighted by |y'| and at most its median, y' the brighter ones, so that g < 1; of phasors both
    components have one. s is the standard error of a median of n values, of which d is the robust
    deviation.

    Parameters
    ----------
    gain : g
    darker : whether the pixels are the darker ones
    apart : [pixel] by how much each ratio is more than g
    bright, dark, light : [pixel] y' and y, and the weight
    spread : d
    alike_px : pixels that noise makes alike
    turn_rad : by how much the phases of phasors differ
    """

    gain: float
    darker: bool
    apart: Array
    bright: Array
    dark: Array
    light: Array
    spread: float
    alike_px: float
    turn_rad: float

    @property
    def times(self) -> float:
        return self.gain if self.darker else 1 / self.gain

    @property
    def chance(self) -> bool:
        """Whether g is no farther from 1 than chance has it once in a million times."""
        from scipy.special import ndtr, stdtrit

        used = self.light[np.abs(self.apart) <= MOST_SIGMAS * self.spread]
        count = float(np.sum(used)) ** 2 / float(np.sum(used**2)) / self.alike_px
        if count <= 1:
            return True
        few = float(-stdtrit(count - 1, float(ndtr(-NO_CHANCE))))
        return 1 - self.gain <= few * self.spread * MEDIAN_ERROR / math.sqrt(count)

    @property
    def level(self) -> bool:
        """Whether a level that is added leaves less than half of the squares."""
        if np.iscomplexobj(self.dark):  # all that is added to phasors is light
            return False
        even = np.ones(self.dark.shape)
        added, times = (weighted_mad(self.dark - g * self.bright, even) for g in (1.0, self.gain))
        return 2 * added**2 < times**2

    def share(self, which: Mask) -> float:
        """Return the share of the light of some pixels."""
        return float(np.sum(self.light[which]) / np.sum(self.light))


def _gain(now: Array, then: Array, alike_px: float = 1.0) -> _Gain | None:
    """Return the gain of pixels against others, None if they are as bright."""
    darker = float(np.sum(np.abs(now))) < float(np.sum(np.abs(then)))
    dark, bright = (now, then) if darker else (then, now)
    seen = bright != 0
    if not seen.any():
        return None
    dark, bright = dark[seen], bright[seen]
    ratio = dark / bright
    size = np.abs(bright)
    light = used = np.minimum(size, np.median(size))
    for _ in range(ROUNDS_OF_LIGHT):
        # Beyond 2 is noise of dark pixels, which the halvings of a median need not count to.
        parts = (np.clip(part, -2, 2) for part in (ratio.real, ratio.imag))
        mean = complex(*(weighted_median(part, used) for part in parts))
        gain = abs(mean)
        if not 0 < gain < 1:
            return None
        apart = np.clip((ratio * mean.conjugate()).real / gain, -2, 2) - gain
        spread = weighted_mad(apart, used) / MEDIAN_SIZE + float(np.finfo(np.float32).eps)
        used = np.where(np.abs(apart) <= MOST_SIGMAS * spread, light, 0.0)
    return _Gain(gain, darker, apart, bright, dark, light, spread, alike_px, float(np.angle(mean)))


def light_since(frame: Frame, before: Frame, noise_sigma: float = 0.0) -> float:
    """Return how many times as bright a frame is as another one of the same place; 1 if not surely.

    Surely: it is no chance, no level that is added, and nine tenths of the light are nearer to it
    than to once, but for twice the noise. What is in a part of the frame, as what moved, is no
    other light, and less than half a frame says nothing.

    Parameters
    ----------
    noise_sigma : of a pixel, of a component of phasors
    """
    some = slice(None, None, max(1, frame.valid.size // ENOUGH) | 1)
    masks = (frame.valid.ravel()[some], before.valid.ravel()[some])
    used = masks[0] & masks[1]
    if 2 * np.sum(used) < max(np.sum(mask) for mask in masks):
        return 1.0
    now, then = (one.amplitude.ravel()[some][used] for one in (frame, before))
    found = _gain(now, then)
    if found is None or found.chance or found.level:
        return 1.0
    noise = NOISE_SIGMAS * noise_sigma * math.hypot(1, found.gain) / np.abs(found.bright)
    lit = found.share(np.abs(found.apart) < (1 - found.gain) / 2 + noise)
    return found.times if lit > LIT else 1.0


def lights(burst: Burst, latest: int) -> Floats:
    """Return how many times as bright as each frame [frame] of a burst the latest one is.

    All of them are 1 unless one surely is not: it is no chance, and no level that is added. Frames
    of other places see other aliases: they are compared behind a low pass, where they lie on each
    other, which takes nothing but their shifts. Aliases and noise lie on both sides, what moved in
    a part of the frame on one. Less than half a frame says nothing.
    """
    times, surely = np.ones(burst.frame_count), False
    for k, now, then, used in on_latest(burst, latest):
        if 2 * np.sum(used) < max(np.sum(burst.valid[j]) for j in (k, latest)):
            continue
        found = _gain(now[used], then[used], 4 * math.pi * LOW_PASS_PX**2)
        if found is None:
            continue
        far = (found.gain - 1) / 2, MOST_SIGMAS * found.spread
        sides = (
            found.share(found.apart > of) - found.share(found.apart < -of) for of in np.abs(far)
        )
        other = max(map(abs, sides)) < 1 - LIT and not found.level
        one = abs(found.turn_rad) * found.gain < far[1] < found.gain  # of all, and no phase turned
        times[k], surely = found.times, surely or (other and one and not found.chance)
    return times if surely else np.ones(burst.frame_count)


def differing(burst: Burst, latest: int, noise_sigma: float) -> Mask:
    """Return where [frame row col] each frame shows something else than the latest one.

        |G (y - y_k)|^2 > 4 (2 s^2 / (4 pi g^2) + (0.1 px G y')^2)

    Over 3 x 3 pixels, slopes over 5 x 5; G is the low pass of `lights`, of width g. Aliases of
    detail finer than pixels may differ as well.
    """
    from scipy.ndimage import shift

    found = np.zeros(burst.valid.shape, np.bool_)
    noise = noise_sigma**2 * (1 + np.iscomplexobj(burst.amplitude)) / (2 * math.pi * LOW_PASS_PX**2)
    for k, now, then, used in on_latest(burst, latest):
        steep = sum(np.abs(slope) ** 2 for slope in image_slopes(now))
        allowed = noise + ALLOWED_SHIFT_PX**2 * mean_around(np.asarray(steep), 5)
        other = used & (mean_around(np.abs(now - then) ** 2, 3) > LIMIT * allowed)
        away = burst.offset_px[k] - burst.offset_px[latest]
        found[k] = shift(other.astype(np.float64), away, order=1, mode="nearest") > 0
    return found


def on_latest(burst: Burst, latest: int) -> Iterator[tuple[int, Array, Array, Mask]]:
    """Yield the number of each other frame, then behind a low pass the latest one, and that one.

    Both [row col] as the latest lies, and where both are known.
    """
    from scipy.ndimage import shift

    seen = np.maximum(gaussian_around(burst.valid.astype(np.float64), LOW_PASS_PX), 1e-3)
    smooth = gaussian_around(np.where(burst.valid, burst.amplitude, 0), LOW_PASS_PX) / seen
    for k, away in enumerate(burst.offset_px - burst.offset_px[latest]):
        if k != latest:
            there = shift(burst.valid[k].astype(np.float64), -away, order=1)
            used = burst.valid[latest] & (there > 1 - 1e-6)  # of what lies between, all four
            yield k, smooth[latest], shift(smooth[k], -away, mode="mirror"), used


def in_one_light(
    found: Estimate,
    frames: Array,
    burst: Burst,
    request: Request,
    allowing: Callable[[], Estimate],
    *,
    stacklevel: int = 2,
) -> Estimate:
    """Return the estimate that allows for other brightness of frames, if that was all there was.

    Frames that show less of a scene, as of one that turned, look darker as well; and light that
    drifts by little looks as if bright parts had moved. Nothing is asked of a stream, whose
    pictures follow its light, nor where it was allowed for.

    Parameters
    ----------
    found : of the frames [frame row col] of the burst
    allowing : finds the estimate that allows for it

    Warns
    -----
    QualityWarning
        If it was, or if the means of the frames differ.
    """
    if request.streamed or request.photometric:
        return found
    differ, said = unequal_brightness(frames, burst.valid), found.notes.get("contradiction", "")
    if said and frames.dtype.kind != "c":
        known_px = 0.0 if burst.offset_sigma_px is None else burst.offset_sigma_px
        drift = light_said(gains_of_light(filled(frames, burst.valid), burst.offset_px, known_px))
        if not (drift or differ or ESTIMATED in said):
            return found
        again = allowing()
        if drift or not again.notes.get("contradiction"):
            how = drift or "the frames differ in brightness"
            how = next((one for one in said.split("; and ") if ESTIMATED in one), how)
            how = how.partition(":")[0]
            done = "the picture allows for it, by a gain and a bias of each frame (in its notes)"
            differ, found = f"{how}: {done}", again
    if differ:
        warn_quality(differ, stacklevel + 1)
    return found


def std_of_level(image: Floats, gain: Floats, bias: Floats) -> Floats:
    """Return the standard deviation of what no frame tells: the gain and bias that all share.

        std^2 = var_k(gain_k x + bias_k) / K

    The frames are as different from what they should be as from each other, so that their mean is
    off by as much as a mean of K such draws. It is one error for the whole picture.

    Parameters
    ----------
    image : [row col] in the units of the frames
    gain, bias : [frame] as estimated, at least two of them
    """
    count = len(gain)
    spread = np.cov(np.stack([gain, bias]))
    variance = spread[0, 0] * image**2 + 2 * spread[0, 1] * image + spread[1, 1]
    return np.asarray(np.sqrt(np.maximum(variance, 0.0) / count))


def _regress(x: Array, y: Array, passes: int = 8) -> tuple[float, float]:
    """Return slope and intercept of y over x by a Huber fit; slope 1 where x is flat."""
    w = np.ones_like(x)
    slope, intercept = 1.0, float(np.median(y - x))
    for _ in range(passes):
        mean_x, mean_y = np.average(x, weights=w), np.average(y, weights=w)
        spread = np.average((x - mean_x) ** 2, weights=w)
        residual = y - slope * x - intercept
        scale = max(robust_scale(residual), 1e-9)
        # Too flat a frame has no slope to see: only its bias is fitted.
        if spread * w.sum() > (10.0 * scale) ** 2:
            slope = float(np.average((x - mean_x) * (y - mean_y), weights=w) / spread)
        intercept = float(mean_y - slope * mean_x)
        residual = np.abs(y - slope * x - intercept)
        w = np.minimum(1.0, HUBER_SIGMAS * scale / np.maximum(residual, 1e-12))
    return slope, intercept
