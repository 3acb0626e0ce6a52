"""A burst made ready for a solver: numbers in 0 .. 1, weights, the forward model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.types import Burst, ShiftField
from lensshift.forward.blur import ApertureBlur, Blur, GaussianBlur
from lensshift.forward.model import ForwardModel, forward_model
from lensshift.forward.prediction import FramePredictor

Array = NDArray[Any]

# Float frames with nearly all pixels below this count as normalised already.
NORMALISED_LIMIT = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """One channel of a burst, as the solvers want it.

    Parameters
    ----------
    y : [frame row col] float64 or complex128, divided by `intensity`; 0 where weight is 0
    weight : [frame row col] 0 .. 1; 0 at pixels that are invalid or look outside the HR image
    model : forward model of these frames, gain and bias included
    intensity : what 1 stands for in the units of the burst
    blur_sigma_px : width of the pixel response in LR pixels
    noise_sigma : noise of an LR pixel in units of `intensity`, or None
    shift_error_px : standard deviation of the offsets (rms over frames and axes), 0 if not known
    even_noise : whether all pixels have about the same noise, as amplitudes do and distances do not
    """

    y: Array
    weight: NDArray[np.float64]
    model: ForwardModel
    intensity: float
    blur_sigma_px: float
    noise_sigma: float | None
    shift_error_px: float = 0.0
    even_noise: bool = True

    @property
    def scale(self) -> int:
        """HR pixels per LR pixel."""
        return self.model.scale

    @property
    def offset_px(self) -> NDArray[np.float64]:
        """One offset [frame 2] per frame; of a shift field the mean over the sensor.

        Plain methods move whole frames and can do no better.
        """
        if self.model.offset_px is not None:
            return self.model.offset_px
        row, col = self.model.rows.position_hr_px, self.model.cols.position_hr_px
        rest = [(size - 1) / 2 for size in self.model.hr_shape]
        means = [row.mean(axis=(1, 2)) - rest[0], col.mean(axis=(1, 2)) - rest[1]]
        return -np.stack(means, axis=-1) / self.scale

    def with_photometry(self, gain: ArrayLike, bias: ArrayLike) -> Problem:
        """Return the problem with another gain and bias [frame], bias in units of `intensity`.

        The frames are brought back to gain 1 and bias 0, noisier ones with less weight.
        """
        gain, bias = np.asarray(gain, np.float64), np.asarray(bias, np.float64)
        y = (self.y - bias[:, None, None]) / gain[:, None, None]
        weight = self.weight * np.minimum(1.0, gain**2)[:, None, None]
        return replace(self, y=np.where(self.weight > 0, y, 0.0), weight=weight)


def peak_of(values: Array, used: NDArray[np.bool_]) -> float:
    """Return what to divide frames by for methods whose thresholds expect the range 0 .. 1.

    Integers: the largest number of their type. Floats: 1, unless they are not normalised; then
    their 99.5th percentile.
    """
    if values.dtype.kind in "ui":
        return float(np.iinfo(values.dtype).max)
    if np.max(np.abs(values), where=used, initial=0.0) <= NORMALISED_LIMIT:
        return 1.0
    return max(brightness_of(values, used), 1.0)


def brightness_of(values: Array, used: NDArray[np.bool_]) -> float:
    """Return the 99.5th percentile of |values|, which a few hot pixels do not move (1 if it is 0).

    A method that divides by it gives twice the image for twice the frames.
    """
    return float(np.percentile(np.abs(values[used]), 99.5)) or 1.0


def make_problem(
    burst: Burst,
    values: Array,
    scale: int,
    *,
    blur: Blur,
    shift_field: ShiftField | None,
    noise_sigma: float | None,
    intensity: Callable[[Array, NDArray[np.bool_]], float] = brightness_of,
    pixel_variance: Array | None = None,
    even_noise: bool = True,
) -> Problem:
    """Prepare one channel of a burst.

    Parameters
    ----------
    values : [frame row col] the channel
    intensity : (values, used) -> what to divide them by, `brightness_of` or `peak_of`
    pixel_variance : [frame row col] known noise variance of each LR pixel, or None
    even_noise : as in `Problem`
    """
    usable = burst.valid if burst.valid is not None else np.ones(values.shape, np.bool_)
    if shift_field is not None:
        if shift_field.offset_px.shape != (*values.shape, 2):
            raise ValueError(
                f"expected a shift field of shape {(*values.shape, 2)}, "
                f"got {shift_field.offset_px.shape}"
            )
        model = forward_model(
            burst.grid.shape, scale, shift_field_px=shift_field.offset_px, blur=blur
        )
    else:
        model = forward_model(burst.grid.shape, scale, burst.offset_px, blur=blur)
    weight = (usable & model.inside).astype(np.float64)
    if not weight.any():
        raise ValueError("no valid pixel sees the scene; are the offsets in pixels?")
    if pixel_variance is not None:
        weight *= _variance_weight(pixel_variance, weight)
    unit = intensity(values, weight > 0)
    kind = np.complex128 if values.dtype.kind == "c" else np.float64
    y = np.where(weight > 0, values, 0).astype(kind) / unit
    return Problem(
        y=y,
        weight=weight,
        model=model,
        intensity=unit,
        blur_sigma_px=blur_width_px(blur),
        noise_sigma=None if noise_sigma is None else noise_sigma / unit,
        shift_error_px=_rms(burst.offset_sigma_px),
        even_noise=even_noise,
    )


def make_blur(psf_sigma_px: float, fill_factor: float | None) -> Blur:
    """Return the pixel response: a Gaussian, or the aperture behind optics of that width."""
    if fill_factor is None:
        return GaussianBlur(psf_sigma_px)
    return ApertureBlur(fill_factor, psf_sigma_px)


def blur_width_px(blur: Blur) -> float:
    """Return the standard deviation of a pixel response in LR pixels."""
    if isinstance(blur, ApertureBlur):
        return float(np.hypot(blur.fill_factor / np.sqrt(12.0), blur.optics_sigma_px))
    if isinstance(blur, GaussianBlur):
        return blur.sigma_px
    raise TypeError(f"expected GaussianBlur or ApertureBlur, got {type(blur).__name__}")


def predictor(
    burst: Burst,
    problem: Problem,
    used: tuple[int, ...],
    image: Array,
    shift_field: ShiftField | None,
    gain: ArrayLike = 1.0,
    bias: ArrayLike = 0.0,
) -> FramePredictor:
    """Return what `Estimate.predict` calls, for frames of the whole burst, used or held out.

    Gain, bias and the shift field are those of the frames used; the others have none.
    """
    gains, biases, field_px = np.ones(burst.frame_count), np.zeros(burst.frame_count), None
    gains[list(used)], biases[list(used)] = gain, bias
    if shift_field is not None:
        shape = (burst.frame_count, *burst.grid.shape, 2)
        field_px = np.array(np.broadcast_to(burst.offset_px[:, None, None], shape))
        field_px[list(used)] = shift_field.offset_px
    model = problem.model
    return FramePredictor(image, model.scale, model.blur, burst.offset_px, gains, biases, field_px)


def _rms(values: Array | None) -> float:
    return 0.0 if values is None else float(np.sqrt(np.mean(values**2)))


def _variance_weight(pixel_variance: Array, weight: Array) -> NDArray[np.float64]:
    variance = np.asarray(pixel_variance, np.float64)
    if variance.shape != weight.shape:
        raise ValueError(f"expected pixel_variance of {weight.shape}, got {variance.shape}")
    used = weight > 0
    if not np.all(np.isfinite(variance[used])) or np.any(variance[used] <= 0):
        raise ValueError("expected a positive, finite pixel_variance at every valid pixel")
    least = float(np.min(variance[used]))
    return np.where(used, least / np.where(used, variance, 1.0), 0.0)
