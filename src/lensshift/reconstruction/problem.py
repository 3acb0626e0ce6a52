"""A burst made ready for a solver: numbers in 0 .. 1, weights, the forward model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.errors import DataError, warn_quality
from lensshift.core.order import quantile
from lensshift.core.stray_light import StrayLight
from lensshift.core.types import Burst, ShiftField
from lensshift.forward.blur import ApertureBlur, Blur, GaussianBlur
from lensshift.forward.model import ForwardModel, forward_model
from lensshift.forward.prediction import FramePredictor
from lensshift.reconstruction.clipping import beside, clipped_pixels
from lensshift.reconstruction.noise import Noise, estimate_noise

# So many pixels tell the percentiles of frames to a thousandth of the contrast.
MOST_PIXELS = 2**15
# Float frames whose brightest pixel lies between these count as normalised to 0 .. 1 already.
NORMALISED = (0.05, 1.5)
# A Gaussian of 1 px lets 0.7 % of the contrast at the Nyquist frequency of a frame through: beyond
# it there is nothing left to resolve. Ten times that is no pixel response but another unit.
QUESTIONED_BLUR_PX, MOST_BLUR_PX = 1.0, 10.0
# The standard deviation of a square pixel that is as wide as the pitch.
SQUARE_PIXEL_PX = 1 / math.sqrt(12)
# The pixel and optics together where nothing is known.
NOMINAL_BLUR_PX = 0.3
# Of the weight of a distance: a phase of a hundredth of the usual amplitude is none.
LEAST_SHARE_OF_LIGHT = 1e-4
# A scene this many times its contrast away from 0 loses quality (0.5 dB at 30 times, of a photo).
LARGE_LEVEL = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """One channel of a burst, as the solvers want it.

    Parameters
    ----------
    y : [frame row col] float64 or complex128, without `level` and divided by `intensity`; 0 where
        weight is 0
    weight : [frame row col] 0 .. 1; 0 at pixels that are invalid or look outside the HR image
    model : forward model of these frames, gain and bias included
    intensity : what 1 stands for in the units of the burst
    level : what 0 stands for
    blur_sigma_px : width of the pixel response in LR pixels
    noise_sigma : noise of an LR pixel in units of `intensity`, or None
    shift_error_px : [frame] standard deviation of the offsets about their common part, 0 if not
        known
    even_noise : whether all pixels have about the same noise, as amplitudes do and distances do not
    told_sigma : noise of the pixels of weight 1 in units of `intensity`, where the variance of each
        was given, or None
    clipped : [frame row col] pixels of light at an end of the range of the camera, None if there
        are none
    stray_light : what was taken out of `y`, or None
    """

    y: Array
    weight: Floats
    model: ForwardModel
    intensity: float
    blur_sigma_px: float
    noise_sigma: float | None
    shift_error_px: Floats | float = 0.0
    level: float = 0.0
    even_noise: bool = True
    told_sigma: float | None = None
    clipped: Mask | None = None
    stray_light: StrayLight | None = None

    @property
    def scale(self) -> int:
        """HR pixels per LR pixel."""
        return self.model.scale

    @property
    def offset_px(self) -> Floats:
        """One offset [frame 2] per frame: plain methods move whole frames and can do no better."""
        return self.model.mean_offset_px

    @property
    def told(self) -> float | None:
        """The noise of a pixel of weight 1, if somebody told it."""
        return self.told_sigma or self.noise_sigma

    def judging(self, sigma: Floats) -> Floats:
        """Return the noise [frame row col] of pixels that may object, infinite of the others."""
        if self.clipped is None:
            return sigma
        silent = beside(self.model.operator, self.clipped, self.scale)
        judging = np.where(silent, np.inf, sigma)
        return judging if np.isfinite(judging).any() else sigma

    @property
    def telling_weight(self) -> Floats:
        """The weight [frame row col] of pixels that tell noise, gain and bias; 0 of the others.

        Where none tells, all count.
        """
        telling = np.where(np.isfinite(self.judging(self.weight)), self.weight, 0.0)
        return telling if telling.any() else self.weight

    @property
    def shown_noise(self) -> Noise:
        """What the frames say of their noise."""
        return estimate_noise(
            self.model.operator, self.y, self.telling_weight, even=self.even_noise
        )

    def with_photometry(self, gain: ArrayLike, bias: ArrayLike) -> Problem:
        """Return the problem with another gain and bias [frame], bias in units of `intensity`.

        The frames are brought back to gain 1 and bias 0, noisier ones with less weight.
        """
        gain, bias = np.asarray(gain, np.float64), np.asarray(bias, np.float64)
        y = (self.y - bias[:, None, None]) / gain[:, None, None]
        weight = self.weight * np.minimum(1.0, gain**2)[:, None, None]
        return replace(self, y=np.where(self.weight > 0, y, 0.0), weight=weight)

    def with_brightness(self, amplitude: Array) -> Problem:
        """Return the problem of distances with the noise that amplitudes [frame row col] tell.

            sigma_d = sigma_a / a c / (4 pi f): weights (a / median)^2, at most 1

        Where hardly any light comes back a distance may be anything, and is off by metres. The
        median is of pixels with light; where none has any they tell nothing.
        """
        used, light = self.weight > 0, np.abs(amplitude)
        if not np.any(light[used]):
            return self
        share = (light / np.median(light[used & (light > 0)])) ** 2
        return replace(self, weight=self.weight * np.clip(share, LEAST_SHARE_OF_LIGHT, 1.0))


def peak_of(values: Array, used: Mask) -> float:
    """Return what to divide frames by for the toolbox, which expects the range 0 .. 1 as published.

    Integers: the largest number of their type. Floats: 1, unless they are not normalised; then
    their 99.5th percentile.
    """
    if values.dtype.kind in "ui":
        return float(np.iinfo(values.dtype).max)
    low, high = NORMALISED
    if low < np.max(np.abs(values), where=used, initial=0.0) <= high:
        return 1.0
    return brightness_of(values, used)


def brightness_of(values: Array, used: Mask) -> float:
    """Return the 99.5th percentile of |values|, which a few hot pixels do not move (1 if it is 0).

    A method that divides by it gives twice the image for twice the frames.
    """
    return float(quantile(np.sort(np.abs(some_pixels(values, used))), 0.995)) or 1.0


def make_problem(
    burst: Burst,
    values: Array,
    scale: int,
    *,
    blur: Blur,
    shift_field: ShiftField | None,
    noise_sigma: float | None,
    intensity: Callable[[Array, Mask], float] = brightness_of,
    pixel_variance: Array | None = None,
    even_noise: bool = True,
    take_level: bool = False,
    keep_outside: bool = False,
) -> Problem:
    """Prepare one channel of a burst.

    Parameters
    ----------
    values : [frame row col] the channel
    intensity : (values, used) -> what to divide them by, `brightness_of` or `peak_of`
    pixel_variance : [frame row col] known noise variance of each LR pixel, or None
    even_noise : as in `Problem`; of such values stray light is taken out that the burst tells
    take_level : whether a level far above the contrast is taken off: what is relative to the size
        of the values would not see the scene
    keep_outside : whether pixels count that look outside the HR image
    """
    if shift_field is not None:
        if shift_field.offset_px.shape != (*values.shape, 2):
            raise ValueError(
                f"expected a shift field of shape {(*values.shape, 2)}, "
                f"got {shift_field.offset_px.shape}"
            )
        model = forward_model(
            burst.grid.shape, scale, shift_field_px=shift_field.offset_px,
            spot_px2=shift_field.spot_px2, skew_px3=shift_field.skew_px3, blur=blur,
        )  # fmt: skip
    else:
        model = forward_model(burst.grid.shape, scale, burst.offset_px, blur=blur)
    weight = (burst.valid & model.inside).astype(np.float64)
    if not weight.any():
        raise DataError("no valid pixel sees the scene; are they in pixels?", field="offset_px")
    if keep_outside:
        weight = burst.valid.astype(np.float64)
    least = None
    if pixel_variance is not None:
        share, least = _variance_weight(pixel_variance, weight)
        weight *= share
    kind = np.complex128 if values.dtype.kind == "c" else np.float64
    used = weight > 0
    level, unit = _large_level(values, used) if take_level else (0.0, 0.0)
    unit = unit or intensity(values, used)
    y = (np.where(used, values, level).astype(kind) - level) / unit
    stray_light = StrayLight.told(burst.meta.get("stray_light")) if even_noise else None
    if stray_light is not None:
        y = np.where(used, stray_light.removed(y), 0.0)
    spot_px2 = 0.0 if model.spot_px2 is None else float(model.spot_px2[..., :2].mean())
    return Problem(
        y=y,
        weight=weight,
        model=model,
        intensity=unit,
        level=level,
        blur_sigma_px=math.sqrt(max(blur_width_px(model.blur) ** 2 + spot_px2, 0.0)),
        noise_sigma=None if noise_sigma is None else noise_sigma / unit,
        shift_error_px=_own_error_px(burst.offset_sigma_px, burst.frame_count),
        even_noise=even_noise,
        told_sigma=None if least is None else float(np.sqrt(least)) / unit,
        clipped=clipped_pixels(values, used) if even_noise and kind is np.float64 else None,
        stray_light=stray_light,
    )


def make_blur(psf_sigma_px: float | None, fill_factor: float | None) -> Blur:
    """Return the pixel response: a Gaussian, or the aperture behind optics of that width.

    Without a width the Gaussian has 0.3 px, and the optics behind an aperture none.

    Raises
    ------
    ValueError
        If the width can be none in LR pixels.

    Warns
    -----
    QualityWarning
        If it leaves nothing to resolve.
    """
    if psf_sigma_px is not None:
        if not (np.isfinite(psf_sigma_px) and 0.0 <= psf_sigma_px <= MOST_BLUR_PX):
            raise ValueError(
                f"psf_sigma_px: expected 0 to {MOST_BLUR_PX:g} LR pixels, got {psf_sigma_px}"
            )
        if psf_sigma_px > QUESTIONED_BLUR_PX:
            warn_quality(
                f"psf_sigma_px {psf_sigma_px:g}: so wide a response leaves nothing between the "
                "pixels to resolve; is it in LR pixels (a square pixel has 0.29)?",
                3,
            )
    if fill_factor is None:
        return GaussianBlur(NOMINAL_BLUR_PX if psf_sigma_px is None else psf_sigma_px)
    return ApertureBlur(fill_factor, psf_sigma_px or 0.0)


def blur_width_px(blur: Blur) -> float:
    """Return the standard deviation of a pixel response in LR pixels."""
    if isinstance(blur, ApertureBlur):
        return float(np.hypot(blur.fill_factor / np.sqrt(12.0), blur.optics_sigma_px))
    if isinstance(blur, GaussianBlur):
        return blur.sigma_px
    raise TypeError(f"expected GaussianBlur or ApertureBlur, got {type(blur).__name__}")


def square_pixel(blur: Blur) -> Blur:
    """Return a response of this kind that is that of the pixel alone."""
    if isinstance(blur, ApertureBlur):
        return ApertureBlur(blur.fill_factor)
    return GaussianBlur(SQUARE_PIXEL_PX)


def without_lens(blur: Blur) -> Blur:
    """Return a response without what a lens has added: no pixel is wider than a square one."""
    return min(blur, square_pixel(blur), key=blur_width_px)


def predictor(
    burst: Burst,
    problem: Problem,
    used: Sequence[int],
    image: Array,
    shift_field: ShiftField | None,
    gain: ArrayLike = 1.0,
    bias: ArrayLike = 0.0,
) -> FramePredictor:
    """Return what `Estimate.predict` calls, for frames of the whole burst, used or held out.

    Gain, bias and the shift field are those of the frames used; the others have what the burst
    says of them.
    """
    gains, biases = np.ones(burst.frame_count), np.zeros(burst.frame_count)
    gains[list(used)], biases[list(used)] = gain, bias
    field_px, of_spots = None, []
    if shift_field is not None:
        shape = (burst.frame_count, *burst.grid.shape, 2)
        others = burst.shift_field
        others_px = burst.offset_px[:, None, None] if others is None else others.offset_px
        field_px = np.array(np.broadcast_to(others_px, shape))
        field_px[list(used)] = shift_field.offset_px
        for known in (shift_field.spot_px2, shift_field.skew_px3):
            if known is not None:  # that of others is the mean of those
                of_all = np.tile(known.mean(axis=0), (burst.frame_count, 1, 1, 1))
                of_all[list(used)] = known
                of_spots.append(of_all)
    scale, blur = image.shape[0] // burst.grid.shape[0], problem.model.blur
    return FramePredictor(
        image, scale, blur, burst.offset_px, gains, biases, field_px, *of_spots,
        stray_light=problem.stray_light,
    )  # fmt: skip


def _large_level(values: Array, used: Mask) -> tuple[float, float]:
    """Return median and contrast of frames far from 0 for their contrast, 0 and 0 of others."""
    if values.dtype.kind == "c":
        return 0.0, 0.0
    ordered = np.sort(some_pixels(values, used))
    low, level, high = (float(quantile(ordered, share)) for share in (0.005, 0.5, 0.995))
    if abs(level) <= LARGE_LEVEL * (high - low):
        return 0.0, 0.0
    return level, high - low


def some_pixels(values: Array, used: Mask, most: int = MOST_PIXELS) -> Array:
    """Return the pixels that are used, of many some that are spread over all frames."""
    step = values.size // most | 1  # odd, so that no column is seen alone
    some = values.ravel()[::step][used.ravel()[::step]]
    return some if some.size else values[used]


def _own_error_px(sigma_px: Array | None, count: int) -> Floats:
    """Return the error [frame] of each shift beyond that of a usual one.

    Shifts about a reference share its error, which moves the picture as a whole; what usual errors
    do to the frames is in the noise that these show; and errors that are alike for all frames leave
    nobody to believe more.
    """
    if sigma_px is None:
        return np.zeros(count)
    variance = np.mean(sigma_px**2, axis=1)
    known = variance[variance > 0.0]
    usual = np.median(known) if known.size else 0.0
    return np.asarray(np.sqrt(np.maximum(variance - usual, 0.0)))


def _variance_weight(pixel_variance: Array, weight: Array) -> tuple[Floats, float]:
    """Return the least variance over that of each pixel, and the least."""
    variance = np.asarray(pixel_variance, np.float64)
    if variance.shape != weight.shape:
        raise ValueError(f"expected pixel_variance of {weight.shape}, got {variance.shape}")
    used = weight > 0
    if not np.all(np.isfinite(variance[used])) or np.any(variance[used] <= 0):
        raise ValueError("expected a positive, finite pixel_variance at every valid pixel")
    least = float(np.min(variance[used]))
    return np.where(used, least / np.where(used, variance, 1.0), 0.0), least
