"""Noise of the frames as a function of the light, variance = a + b I, with the scene in view.

A scene makes the residual of a smooth fit to the frames (`smooth_fit`) larger, and that of a stiff
fit more so: where stiff and soft fits say the same there is noise alone. Blocks of the frames that
pass this give level and slope; the slope counts as far as they tell it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.special import gammaln

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.order import median, quantile
from lensshift.reconstruction.smooth_fit import MIDDLE, SmoothFits, outliers, refilled, smooth_fits

# Windows spread over a large sensor tell as much as the whole of it; as many frames are enough.
WINDOWS, WINDOW_PX, MOST_FRAMES = 3, 48, 9
BORDER_PX = 1  # whose pixels are not judged
BLOCK_PX, BLOCK_STEP_PX = 3, 3
NOWHERE = np.zeros((1, 1, 1, 1), np.bool_)
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
    sigma : root of the mean variance, of a usual frame if they differ
    a, b : level and slope
    darkest, brightest : range of light that was seen; beyond it the variance is that at its end
    ceiling : whether texture may be in all that was seen, and there is less noise
    of_frames : variance of each frame over that, 1 of all if empty
    """

    sigma: float
    a: float
    b: float
    darkest: float
    brightest: float
    ceiling: bool = False
    of_frames: tuple[float, ...] = ()

    @property
    def coefficients(self) -> dict[str, float]:
        """Level and slope by name."""
        return {"a": self.a, "b": self.b}

    @property
    def noise_of_frames(self) -> dict[str, list[float]]:
        """Standard deviation of each frame by name, nothing if they are alike."""
        if not self.of_frames:
            return {}
        return {"noise_of_frames": (self.sigma * np.sqrt(self.of_frames)).tolist()}

    def scaled(self, unit: float, level: float) -> NoiseLaw:
        """Return the law of y * unit + level."""
        return replace(
            self,
            sigma=self.sigma * unit,
            a=self.a * unit**2 - self.b * unit * level,
            b=self.b * unit,
            darkest=self.darkest * unit + level,
            brightest=self.brightest * unit + level,
        )

    def times(self, factor: float) -> NoiseLaw:
        """Return the law of so many times the noise."""
        a, b = self.a * factor**2, self.b * factor**2
        return replace(self, sigma=self.sigma * factor, a=a, b=b, ceiling=False)

    def at_least(self, sigma: float) -> NoiseLaw:
        """Return the law with so much noise, of a usual frame, wherever it has less."""
        most = max(sigma, self.sigma)
        if self.b <= 0 or sigma**2 >= self.a + self.b * self.brightest:
            return replace(constant_noise(most), of_frames=self.of_frames)
        return replace(self, sigma=most, darkest=max(self.darkest, (sigma**2 - self.a) / self.b))

    def of_other_frames(self, variance: Floats, light: float) -> NoiseLaw:
        """Return the law of frames [frame] that have these variances where the light is this."""
        relative = variance / max(float(self.variance(np.array(light))), 1e-300)
        usual = float(np.median(relative))
        of_frames = tuple((relative / usual).tolist())
        return replace(self.times(math.sqrt(usual)), of_frames=of_frames)

    def variance(self, light: Array) -> Floats:
        """Return the variance at each pixel, [frame row col] if it differs between frames."""
        seen = np.clip(light, self.darkest, self.brightest)
        variance = np.asarray(self.a + self.b * seen, np.float64)
        return variance * np.array(self.of_frames)[:, None, None] if self.of_frames else variance


@dataclass(frozen=True, slots=True, eq=False)
class _White:
    """What fits leave of white noise.

    Parameters
    ----------
    energy : [fit block] of blocks that pass as noise, over `low`
    low : [fit] the low quantile of those energies
    purity : energy of the first fit over that of the last that most blocks keep to
    """

    energy: Array
    low: Array
    purity: float


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
    seen, used, cut = map(windows, whole)
    if not used.any():  # what is valid lies between the windows
        seen, used, cut = (one[None] for one in whole)
    parts = [seen.real, seen.imag][:components]
    level = 0.0 if components == 2 else median(seen[used])
    values = np.concatenate([np.where(used, part - level, 0.0) for part in parts])
    lit = np.concatenate([np.where(used, np.abs(seen) if len(parts) > 1 else seen - level, 0.0)
                          for _ in parts])  # fmt: skip
    used, cut = (np.concatenate([one for _ in parts]) for one in (used, cut))
    unit = float(np.sqrt(np.mean(values**2))) or 1.0
    geometry = offset.tobytes(), len(some), used.shape[-2:], round(float(blur_px), 3)
    fits = smooth_fits(*geometry)
    values, lit = (part.astype(np.float32) / np.float32(unit) for part in (values, lit))
    rest = fits.residuals(values, MIDDLE)[0]
    out, filled = outliers(fits, values, rest, used & ~cut)
    judged = used & ~out
    if not judged.all():
        values = refilled(fits, values, rest, ~judged, start=filled)
    energy, light = _blocks(values, judged, fits, lit, components, cut)
    if not light.size:
        return None
    return _fitted(energy, light, _white(*geometry, components)).scaled(unit, level)


def constant_noise(sigma: float, *, ceiling: bool = False) -> NoiseLaw:
    """Return the law of noise that is the same at any light."""
    return NoiseLaw(sigma, sigma**2, 0.0, -np.inf, np.inf, ceiling)


def windows(values: Array) -> Array:
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
def _white(
    offset_bytes: bytes, count: int, shape: tuple[int, int], blur_px: float, components: int
) -> _White:
    fits = smooth_fits(offset_bytes, count, shape, blur_px)
    windows = WINDOWS**2 // components * components
    noise = np.random.default_rng(0).standard_normal((windows, count, *shape), np.float32)
    energy, _ = _blocks(noise, np.ones(noise.shape, np.bool_), fits, noise, components)
    usual = energy[0] / energy[-1]
    purity = float(np.quantile(usual, PASSING))
    energy = energy[:, usual <= purity]
    low = np.quantile(energy, LOW, axis=1)
    return _White(energy / low[:, None], low, purity)


def _blocks(
    values: Array,
    judged: Mask,
    fits: SmoothFits,
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
    silent : [component window, frame row col] pixels that tell nothing, nor do blocks with one
        while there are others, nor what is left of a block while there is something
    """
    rest = fits.residuals(values)
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
        telling, others = full & (marked == 0), judged & ~silent
        if not telling.any() and others.any():  # such pixels are in all blocks
            return _blocks(values, others, fits, lit, components)
        full = telling if telling.any() else full
    return energy[:, full] / share[full], light[full] / share[full]


def _sampled(values: Array) -> Array:
    """Return the means of blocks [... row col] at every few pixels."""
    rows, cols = values.shape[-2:]
    sides = [min(BLOCK_PX, n) for n in (rows, cols)]
    mean = uniform_filter(values, sides, axes=(-2, -1), mode="constant")
    first = [side // 2 for side in sides]
    last = [n - (side - 1) // 2 for n, side in zip((rows, cols), sides, strict=True)]
    return mean[..., first[0] : last[0] : BLOCK_STEP_PX, first[1] : last[1] : BLOCK_STEP_PX]


def _fitted(energy: Array, light: Array, white: _White) -> NoiseLaw:
    """Return level and slope from blocks [fit block]."""
    purity = energy[0] / np.maximum(energy[-1], 1e-30)
    # Of fewer blocks than of noise are left out none is known to be free of texture.
    least = float(quantile(np.sort(purity), 1 - PASSING))
    pure = purity <= max(white.purity, least)
    relative, seen = energy[:, pure] / white.low[:, None], light[pure]
    best = int(quantile(np.sort(relative), LOW).argmin())
    values = relative[best]
    low, high = float(seen.min()), float(seen.max())
    slope = (_brighter(values, seen, white.energy[best]) - 1) / max(high - low, 1e-30)
    # At the darkest; the low quantile is no block that texture is in.
    level = float(quantile(np.sort(values / (1 + slope * (seen - low))), LOW))
    mean = level * float(np.mean(1 + slope * (np.clip(light, low, high) - low)))
    return NoiseLaw(
        math.sqrt(mean), level * (1 - slope * low), level * slope, low, high,
        ceiling=least > white.purity,
    )  # fmt: skip


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
    level = quantile(np.sort(relative), LOW)[:, None] * float(white.mean())
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
