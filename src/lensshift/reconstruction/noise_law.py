"""Noise of the frames as a function of the light, variance = a + b I, with the scene in view.

At each spatial frequency of the frames a scene of falling spectrum has the covariance D between
frames, known from their shifts; what it hardly reaches is noise:

    r = s (s 1 + D)^-1 y,   D_kj = sum over aliases v of |H(v)|^2 / |v|^4 exp(-2 pi i v (d_k - d_j))

the residual of a smooth fit in closed form, for stiff and soft fits s. A scene makes a residual
larger, and that of the stiff fit more so: where both say the same there is noise alone. Blocks of
the frames that pass this give level and slope; the slope counts as far as they tell it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import fft
from scipy.ndimage import uniform_filter
from scipy.special import gammaln

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.gaussian import MAD_TO_SIGMA

# Power of a scene over that of the noise, at 1 cycle per LR pixel, where a fit stops following.
STIFFNESS = np.array([3.0, 0.3, 0.03])
ALIASES = 3  # a square pixel lets 10 % through at the third
# Windows spread over a large sensor tell as much as the whole of it; as many frames are enough.
WINDOWS, WINDOW_PX, MOST_FRAMES = 3, 48, 9
PAD_PX, BORDER_PX = 4, 1  # continued beyond the border, whose pixels are not judged
BLOCK_PX, BLOCK_STEP_PX = 3, 3
NOWHERE = np.zeros((1, 1, 1, 1), np.bool_)
# The median of 144 sizes, compared to that of all frames: five of its standard errors more.
ODD_FRAME = 1.5
OUTLIER_SIGMAS, OUTLIER_BLOCK_PX = 4.0, 12
# Steps that fill pixels in, fewer where a hundredth of their residual is left.
REFILLS, REFILLED = 8, 0.01
# The share of the blocks of white noise that passes as such, and the quantile that stands for the
# blocks that pass: texture may be in some.
PASSING, LOW = 0.9, 0.05
# Variance at the brightest over that at the darkest, from no slope to light alone; and steps of
# expectation and maximisation, after which the share of texture changes by a hundredth at most.
BRIGHTER, MIXTURE_STEPS = np.geomspace(1.0, 1000.0, 16), 6
TEXTURE = 1000.0  # how much larger than noise a block with texture may be; more counts no more


@dataclass(frozen=True, slots=True)
class NoiseLaw:
    """Variance of an LR pixel, a + b I for light between `darkest` and `brightest`.

    Parameters
    ----------
    sigma : root of the mean variance
    a, b : level and slope
    darkest, brightest : range of light that was seen; beyond it the variance is that at its end
    ceiling : whether texture may be in all that was seen, and there is less noise
    """

    sigma: float
    a: float
    b: float
    darkest: float
    brightest: float
    ceiling: bool = False

    @property
    def coefficients(self) -> dict[str, float]:
        """Level and slope by name."""
        return {"a": self.a, "b": self.b}

    def scaled(self, unit: float, level: float) -> NoiseLaw:
        """Return the law of y * unit + level."""
        return NoiseLaw(
            self.sigma * unit,
            self.a * unit**2 - self.b * unit * level,
            self.b * unit,
            self.darkest * unit + level,
            self.brightest * unit + level,
            self.ceiling,
        )

    def times(self, factor: float) -> NoiseLaw:
        """Return the law of so many times the noise."""
        a, b = self.a * factor**2, self.b * factor**2
        return NoiseLaw(self.sigma * factor, a, b, self.darkest, self.brightest)

    def variance(self, light: Array) -> Floats:
        """Return the variance at each pixel."""
        seen = np.clip(light, self.darkest, self.brightest)
        return np.asarray(self.a + self.b * seen, np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Filters:
    """Residual filters of one geometry, and what they make of white noise.

    Parameters
    ----------
    response : [fit frame frame frequency]
    gain : [fit frame] root mean square of the residual of unit white noise
    share : [frame] standard deviation of the residual of the middle fit over that of what the
        others predict, for a pixel that is as the fit expects
    energy : [fit block] of white noise
    """

    response: Array
    gain: Array
    share: Array
    energy: Array


def noise_law(
    offset_px: Array, y: Array, weight: Array, blur_px: float, silent: Mask | None = None
) -> NoiseLaw | None:
    """Return the noise of frames [frame row col] that have one shift each, None if too few tell.

    Of phasors that of a component, as a function of the amplitude.

    Parameters
    ----------
    offset_px : [frame 2]
    y : real or complex
    weight : [frame row col] 0 at pixels that must not be used
    blur_px : standard deviation of the pixel response in LR pixels
    silent : [frame row col] pixels that tell nothing of noise, nor do blocks with one of them
    """
    some = np.unique(np.linspace(0, len(y) - 1, min(len(y), MOST_FRAMES)).round().astype(int))
    offset = np.round(offset_px[some] - offset_px[some[0]], 6)  # what rounding adds is no new case
    cut = np.zeros(y[some].shape, np.bool_) if silent is None else silent[some]
    whole, components = (y[some], weight[some] > 0, cut), 2 if y.dtype.kind == "c" else 1
    seen, used, cut = map(_windows, whole)
    if not used.any():  # what is valid lies between the windows
        seen, used, cut = (one[None] for one in whole)
    parts = [seen.real, seen.imag][:components]
    level = 0.0 if components == 2 else float(np.median(seen[used]))
    values = np.concatenate([np.where(used, part - level, 0.0) for part in parts])
    lit = np.concatenate([np.where(used, np.abs(seen) if len(parts) > 1 else seen - level, 0.0)
                          for _ in parts])  # fmt: skip
    used, cut = (np.concatenate([one for _ in parts]) for one in (used, cut))
    unit = float(np.sqrt(np.mean(values**2))) or 1.0
    filters = _filters(
        offset.tobytes(), len(some), used.shape[-2:], round(float(blur_px), 3), components
    )
    values, lit = (part.astype(np.float32) / np.float32(unit) for part in (values, lit))
    judged = used & ~_outliers(values, used & ~cut, filters)
    if not judged.all():
        values = _refilled(values, ~judged, filters)
    energy, light = _blocks(values, judged, filters, lit, components, cut)
    return _fitted(energy, light, filters.energy).scaled(unit, level) if light.size else None


def constant_noise(sigma: float, *, ceiling: bool = False) -> NoiseLaw:
    """Return the law of noise that is the same at any light."""
    return NoiseLaw(sigma, sigma**2, 0.0, -np.inf, np.inf, ceiling)


def _windows(values: Array) -> Array:
    """Return parts [window frame row col] spread over the frames, or all of small ones."""
    starts, sides = [], []
    for size in values.shape[1:]:
        whole = size <= 1.5 * WINDOW_PX
        sides.append(size if whole else WINDOW_PX)
        count = 1 if whole else min(WINDOWS, size // WINDOW_PX + 1)
        starts.append(np.linspace(0, size - sides[-1], count).astype(int))
    return np.stack([
        values[:, top : top + sides[0], left : left + sides[1]]
        for top in starts[0] for left in starts[1]
    ])  # fmt: skip


@lru_cache(maxsize=8)
def _filters(
    offset_bytes: bytes, count: int, shape: tuple[int, int], blur_px: float, components: int
) -> _Filters:
    offset_px = np.frombuffer(offset_bytes).reshape(count, 2)
    padded = _padded_shape(shape)
    row, col = np.fft.fftfreq(padded[0]), np.fft.rfftfreq(padded[1])
    alias = np.arange(-ALIASES, ALIASES + 1)
    v, w = (at[:, None] + alias for at in (row, col))
    square = np.maximum((v * v)[:, None, None, :, None] + (w * w)[:, None, None, :], 1e-4)
    size = np.exp(-2 * np.pi**2 * blur_px**2 * square) / square
    along_row, along_col = (
        np.exp(-2j * np.pi * at[:, None] * offset_px[:, axis, None])
        for axis, at in enumerate((v, w))
    )
    seen = size * along_row[:, None, ..., None] * along_col[:, :, None]
    seen = seen.reshape(*size.shape[:2], count, -1)  # of each alias by each frame
    covariance = seen @ np.conj(np.swapaxes(seen, -1, -2))
    eye = np.eye(count)
    response = np.stack([s * np.linalg.inv(s * eye + covariance) for s in STIFFNESS])
    twice = np.where((col == 0) | (col == 0.5), 1.0, 2.0)  # for the half that is left out
    power = np.einsum("srckj,c->sk", np.abs(response) ** 2, twice) / (padded[0] * padded[1])
    gain = np.sqrt(power).astype(np.float32)
    own = np.einsum("rckk,c->k", response[1].real, twice) / (padded[0] * padded[1])
    filters = _Filters(
        np.ascontiguousarray(np.moveaxis(response, (1, 2), (3, 4))).astype(np.complex64),
        gain,
        np.sqrt(own).astype(np.float32),
        np.empty(0),
    )
    windows = WINDOWS**2 // components * components
    white = np.random.default_rng(0).standard_normal((windows, count, *shape), np.float32)
    energy, _ = _blocks(white, np.ones(white.shape, np.bool_), filters, white, components)
    return replace(filters, energy=energy)


def _padded_shape(shape: tuple[int, int]) -> tuple[int, int]:
    rows, cols = (fft.next_fast_len(n + 2 * min(PAD_PX, n - 1), real=True) for n in shape)
    return rows, cols


def _residuals(values: Array, filters: _Filters, fits: slice) -> Array:
    """Return the residuals [fit window frame row col] of the fits, in units of those of noise."""
    shape = values.shape[-2:]
    pads = [min(PAD_PX, n - 1) for n in shape]
    wide = _continued(_continued(values, pads[0], 2), pads[1], 3)
    padded = _padded_shape(shape)
    spectrum = fft.rfft2(wide, padded)
    found = np.einsum("skjrc,wjrc->swkrc", filters.response[fits], spectrum)
    rows, cols = (slice(pad, pad + n) for pad, n in zip(pads, shape, strict=True))
    rest = fft.irfft2(found, padded)[..., rows, cols]
    return np.asarray(rest / filters.gain[fits][:, None, :, None, None])


def _continued(values: Array, pad: int, axis: int) -> Array:
    """Return values that go on beyond the border as their mirror image about it, turned over."""
    if pad == 0:
        return values
    moved = np.moveaxis(values, axis, 0)
    parts = [2 * moved[:1] - moved[pad:0:-1], moved, 2 * moved[-1:] - moved[-2 : -pad - 2 : -1]]
    return np.moveaxis(np.concatenate(parts), 0, axis)


def _blocks(
    values: Array,
    judged: Mask,
    filters: _Filters,
    lit: Array,
    components: int,
    silent: Mask = NOWHERE,
) -> tuple[Array, Array]:
    """Return mean squares [fit block] of the residuals and the light [block].

    A block is one of all components: that of a phasor across the light may be quantised until it
    is still.

    Parameters
    ----------
    values : [component window, frame row col]
    judged : [component window, frame row col] pixels that count
    lit : [component window, frame row col] light
    silent : [component window, frame row col] pixels that tell nothing, nor do blocks with one,
        while there are others
    """
    rest = _residuals(values, filters, slice(None))
    inner = np.zeros(values.shape, np.float32)
    cut = tuple(slice(min(BORDER_PX, (n - 1) // 2), n - min(BORDER_PX, (n - 1) // 2))
                for n in values.shape[-2:])  # fmt: skip
    inner[..., cut[0], cut[1]] = judged[..., cut[0], cut[1]]
    share, energy, light = (
        part.reshape(*part.shape[:-3], components, -1, *part.shape[-2:]).mean(axis=-4)
        for part in (
            _sampled(inner.mean(axis=1)),
            _sampled(np.mean(rest**2 * inner, axis=2)),
            _sampled(np.mean(lit * inner, axis=1)),
        )
    )
    full = share > 1 / 3 if (share > 1 / 3).any() else share > 0
    if silent.any():
        marked = _sampled(np.asarray(silent.any(axis=1), np.float32)).reshape(full.shape)
        telling = full & (marked == 0)
        full = telling if telling.any() else full
    return energy[:, full] / share[full], light[full] / share[full]


def _outliers(values: Array, used: Mask, filters: _Filters) -> Mask:
    """Return the pixels that the others contradict.

    A residual is also large beside an outlier. So all pixels where it is large are left out, and
    those that the rest then predicts come back.
    """
    rest = _residuals(values, filters, slice(1, 2))[0]
    usual, of_frame = _usual(rest, used), _usual(_alone(rest), _alone(used)).reshape(rest.shape)
    odd = of_frame > ODD_FRAME * usual
    doubted = used & (odd | (np.abs(rest) > OUTLIER_SIGMAS * usual))
    if not doubted.any():
        return np.zeros(used.shape, np.bool_)
    filled = _refilled(values, doubted | ~used, filters)
    rest = _residuals(filled, filters, slice(1, 2))[0]
    usual = _usual(rest, used & ~doubted) / filters.share[:, None, None]
    return np.asarray(doubted & (np.abs(values - filled) > OUTLIER_SIGMAS * usual))


def _alone(values: Array) -> Array:
    return np.asarray(values.reshape(-1, 1, *values.shape[2:]))


def _usual(rest: Array, used: Mask) -> Array:
    """Return the usual size of the residual around each pixel [window 1 row col]."""
    windows, count, rows, cols = rest.shape
    side = OUTLIER_BLOCK_PX
    tall, wide = -(-rows // side), -(-cols // side)
    size = np.full((windows, count, tall * side, wide * side), np.nan, np.float32)
    size[:, :, :rows, :cols] = np.where(used, np.abs(rest), np.nan)
    blocks = size.reshape(windows, count, tall, side, wide, side).transpose(0, 2, 4, 1, 3, 5)
    ordered = np.sort(blocks.reshape(windows, tall, wide, -1), axis=-1)  # NaN last
    middle = np.isfinite(ordered).sum(axis=-1, keepdims=True) // 2
    found = np.nan_to_num(np.take_along_axis(ordered, middle, axis=-1)[..., 0])
    around = np.repeat(np.repeat(found, side, axis=1), side, axis=2)[:, None, :rows, :cols]
    return np.asarray(MAD_TO_SIGMA * around)


def _refilled(values: Array, missing: Mask, filters: _Filters) -> Array:
    """Return the frames with the residual of the middle fit brought to 0 at missing pixels."""

    def rest(x: Array) -> Array:
        return np.where(missing, _residuals(x, filters, slice(1, 2))[0], np.float32(0))

    filled = values.copy()
    r = rest(values)
    p, power = r.copy(), float(np.vdot(r, r))
    enough = REFILLED**2 * power
    for _ in range(REFILLS):  # conjugate gradients
        q = rest(p)
        curvature = float(np.vdot(p, q))
        if curvature <= np.finfo(np.float32).tiny or power <= enough:
            break
        step = power / curvature
        filled -= step * p
        r -= step * q
        power, before = float(np.vdot(r, r)), power
        p = r + (power / before) * p
    return filled


def _sampled(values: Array) -> Array:
    """Return the means of blocks [... row col] at every few pixels."""
    rows, cols = values.shape[-2:]
    sides = [min(BLOCK_PX, n) for n in (rows, cols)]
    mean = uniform_filter(values, sides, axes=(-2, -1), mode="constant")
    first = [side // 2 for side in sides]
    last = [n - (side - 1) // 2 for n, side in zip((rows, cols), sides, strict=True)]
    return mean[..., first[0] : last[0] : BLOCK_STEP_PX, first[1] : last[1] : BLOCK_STEP_PX]


def _fitted(energy: Array, light: Array, white: Array) -> NoiseLaw:
    """Return level and slope from blocks [fit block] and those of white noise."""
    purity, usual = energy[0] / np.maximum(energy[-1], 1e-30), white[0] / white[-1]
    limit = np.quantile(usual, PASSING)
    # Of fewer blocks than of noise are left out none is known to be free of texture.
    ceiling = bool((least := np.quantile(purity, 1 - PASSING)) > limit)
    pure = purity <= max(limit, least)
    white = white[:, usual <= limit]
    reference = np.quantile(white, LOW, axis=1)
    best = int((np.quantile(energy[:, pure], LOW, axis=1) / reference).argmin())
    values, seen = energy[best, pure] / reference[best], light[pure]
    low, high = float(seen.min()), float(seen.max())
    slope = (_brighter(values, seen, white[best] / reference[best]) - 1) / max(high - low, 1e-30)
    # At the darkest; the low quantile is no block that texture is in.
    level = float(np.quantile(values / (1 + slope * (seen - low)), LOW))
    mean = level * float(np.mean(1 + slope * (np.clip(light, low, high) - low)))
    return NoiseLaw(math.sqrt(mean), level * (1 - slope * low), level * slope, low, high, ceiling)


def _brighter(values: Array, light: Array, white: Array) -> float:
    """Return how much larger the variance is at the brightest block than at the darkest.

        p(v | I) = (1 - q) Gamma(v / s(I)) + q / (range of log v)     per unit of log v

    The blocks are as those of white noise are, or texture made them anything; s follows the light
    by each of `BRIGHTER`, the level is the low quantile, q that of the greatest likelihood. It is
    as likely as not that noise does not follow the light, and the mean of log s counts.
    """
    if not light.max() > light.min():
        return 1.0
    at = (light - light.min()) / (light.max() - light.min())
    relative = values / (1 + (BRIGHTER[:, None] - 1) * at)
    shape = float(white.mean()) ** 2 / float(white.var())
    level = np.quantile(relative, LOW, axis=1, keepdims=True) * float(white.mean())
    share = 0.5
    for _ in range(MIXTURE_STEPS):
        log_x = np.log(np.maximum(relative / level, 1e-30))
        noise = np.exp(shape * (log_x + math.log(shape) - np.exp(log_x)) - gammaln(shape))
        texture = np.exp(shape * np.minimum(log_x, 0.0)) / math.log(TEXTURE)  # it takes nothing
        both = (1 - share) * noise + share * texture
        told, clean = np.sum(np.log(both), axis=1), (1 - share) * noise / both
        share = np.clip(1 - clean.mean(axis=1, keepdims=True), 0.01, 0.99)
        level = np.sum(clean * relative, axis=1, keepdims=True) / np.sum(
            clean, axis=1, keepdims=True
        )
    odds = np.exp(told - told.max()) * np.r_[len(BRIGHTER) - 1, np.ones(len(BRIGHTER) - 1)]
    return float(np.exp(odds @ np.log(BRIGHTER) / odds.sum()))
