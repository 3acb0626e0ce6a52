"""The power of the scene behind a burst, with its aliases, and of the noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lensshift.core.arrays import Array, Floats, Shifts

# The blur of a square pixel that fills its cell; the power law takes up what differs.
PIXEL_SIGMA_PX = 0.3
_FURTHEST_ALIAS = 3  # of sharp edges behind half-filled pixels 1e-5 of the power lies beyond
# The freed power leans towards the power law as if it had seen that many bins of it.
_LEANING_BINS = 0.3
_LEAST_FREEDOM = 1e-6  # so that roots and logarithms exist
_NEIGHBOURS = 3  # bins along each axis that are averaged
# Of the power of the scene, which may be 10^18 times the noise at the lowest frequencies of large
# smooth frames: with less on the diagonal no inverse is known.
_ROUNDING = 1e-13
_NUMBERS_AT_ONCE = 200_000  # a few MB at a time, which stay in the cache


@dataclass(frozen=True, slots=True, eq=False)
class Frequencies:
    """The frequencies of a transform without f = 0, and the aliases that fall on each.

    Parameters
    ----------
    shape : (rows, cols) of a frame
    down, right : [frequency alias] in cycles per pixel
    weight : [frequency] 1, or 1/2 where a real image counts a frequency twice
    whole_plane : whether the frames are complex
    reach : the largest alias along an axis
    """

    shape: tuple[int, int]
    down: Floats
    right: Floats
    weight: Floats
    whole_plane: bool
    reach: int

    @classmethod
    def of(cls, shape: tuple[int, ...], *, whole_plane: bool) -> Frequencies:
        """Return those of frames [frame row col].

        K frames sample root K times as finely along an axis, and tell aliases apart up to half of
        that.
        """
        frames, rows, cols = shape
        reach = min(max((math.isqrt(frames) + 1) // 2, 1), _FURTHEST_ALIAS)
        col = np.fft.fftfreq(cols) if whole_plane else np.fft.rfftfreq(cols)
        weight = np.ones((rows, col.size))
        if not whole_plane:
            weight[:, 0] = 0.5
            if cols % 2 == 0:
                weight[:, -1] = 0.5
        alias = np.arange(-reach, reach + 1.0)
        row_at, col_at = np.broadcast_arrays(
            np.fft.fftfreq(rows)[:, None, None, None] + alias[:, None],
            col[None, :, None, None] + alias,
        )
        count = alias.size**2
        return cls(
            (rows, cols),
            row_at.reshape(-1, count)[1:],
            col_at.reshape(-1, count)[1:],
            weight.ravel()[1:],
            whole_plane,
            reach,
        )

    def parts(self, frames: int, kinds: int) -> Iterator[slice]:
        """Yield slices of the frequencies that fit in memory one after another."""
        step = max(1, _NUMBERS_AT_ONCE // max(self.down.shape[1] * frames, (kinds * frames) ** 2))
        for first in range(0, len(self.down), step):
            yield slice(first, min(first + step, len(self.down)))

    def turns(self, part: slice) -> Array:
        """Return what a change of row, col and log gain multiplies an alias with, [f alias 3]."""
        row, col = -2j * np.pi * self.down[part], -2j * np.pi * self.right[part]
        return np.stack([row, col, np.ones_like(row)], axis=-1)

    def smoothed(self, values: Floats) -> Floats:
        """Return the mean over the neighbours of each frequency, aliases included, [f alias]."""
        from scipy.ndimage import uniform_filter

        rows, cols = ((2 * self.reach + 1) * size for size in self.shape)
        at_row = np.rint(self.down * self.shape[0]).astype(np.intp)
        at_col = np.rint(self.right * self.shape[1]).astype(np.intp)
        total, count = np.zeros((rows, cols)), np.zeros((rows, cols))
        for sign in (1,) if self.whole_plane else (1, -1):
            place = (sign * at_row % rows, sign * at_col % cols)
            np.add.at(total, place, values)
            np.add.at(count, place, 1.0)
        total = uniform_filter(total, _NEIGHBOURS, mode="wrap")
        count = uniform_filter(count, _NEIGHBOURS, mode="wrap")
        found: Floats = (total / count)[at_row % rows, at_col % cols]
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Power of the scene at each frequency and alias, and of white noise.

        P = exp(log_level) (f0^2 + |f|^2)^-exponent exp(-(2 pi sigma |f|)^2) freedom

    sigma is that of a full pixel while the frames tell one alias from none; more of them see a
    smaller pixel themselves.

    Parameters
    ----------
    frequencies : where
    log_level, exponent, log_noise : of the power law and of the noise
    freedom : [frequency alias] factor that the frames have shown, 1 at first
    """

    frequencies: Frequencies
    log_level: float
    exponent: float
    log_noise: float
    freedom: Floats

    @property
    def noise_power(self) -> float:
        """Variance of the noise of an LR pixel."""
        return float(np.exp(self.log_noise))

    @property
    def power(self) -> Floats:
        """Power P [frequency alias]."""
        at = self.frequencies
        square = at.down**2 + at.right**2
        blur = (2.0 * np.pi * PIXEL_SIGMA_PX / at.reach) ** 2 * square
        law = np.exp(self.log_level - self.exponent * self._log_frequency() - blur)
        return np.asarray(law * self.freedom)

    def _log_frequency(self) -> Floats:
        at = self.frequencies
        lowest = 1.0 / max(at.shape)
        return np.asarray(np.log(lowest**2 + at.down**2 + at.right**2))

    def steering(self, part: slice, offset_px: Shifts, gain: Array) -> Array:
        """Return a_m [frequency alias frame], what an alias looks like in each frame.

        All frequencies have the same aliases, so that exp(f + m) = exp(f) exp(m): an exponential
        takes many times as long as a product.
        """
        at = self.frequencies
        middle = at.down.shape[1] // 2  # where the alias is 0
        base = np.stack([at.down[part, middle], at.right[part, middle]], axis=-1)
        alias = np.stack([at.down[0], at.right[0]], axis=-1)
        alias = np.rint(alias - alias[middle])
        of_base = np.exp(-2j * np.pi * (base @ offset_px.T))
        of_alias = gain * np.exp(-2j * np.pi * (alias @ offset_px.T))
        return np.asarray(of_base[:, None] * of_alias)

    def covariance(self, power: Array, steering: Array) -> Array:
        """Return S [frequency frame frame] = sum P a a^H + sigma^2 I."""
        matrix = np.swapaxes(power[..., None] * steering, 1, 2) @ np.conj(steering)
        diagonal = np.arange(matrix.shape[-1])
        rounding = _ROUNDING * power.sum(axis=-1, keepdims=True)
        matrix[:, diagonal, diagonal] += self.noise_power + rounding
        return np.asarray(matrix)

    def scored(
        self, spectra: Array, offset_px: Shifts, gain: Array, *, whole: bool
    ) -> tuple[Spectrum, float]:
        """Return the spectrum after one step of Fisher scoring, and the size of the step.

        Level, exponent and noise take part if `whole`, otherwise only the noise.
        """
        terms = (0, 1, 2) if whole else (2,)
        score, information = np.zeros(3), np.zeros((3, 3))
        power, log_frequency = self.power, self._log_frequency()
        count = len(offset_px)
        for part in self.frequencies.parts(count, 1):
            steering = self.steering(part, offset_px, gain)
            matrix = self.covariance(power[part], steering)
            inverse = np.linalg.inv(matrix)
            seen = (inverse @ spectra[part][..., None])[..., 0]
            slopes: dict[int, Array] = {2: self.noise_power * np.eye(count)}
            if whole:
                steeper = -power[part] * log_frequency[part]
                slopes[0] = matrix - slopes[2]
                slopes[1] = np.swapaxes(steeper[..., None] * steering, 1, 2) @ np.conj(steering)
            weight = self.frequencies.weight[part]
            whitened = {p: inverse @ slopes[p] for p in terms}
            for p in terms:
                square = np.real(np.sum(np.conj(seen) * (slopes[p] @ seen[..., None])[..., 0], -1))
                score[p] += weight @ (square - np.real(np.einsum("fkk->f", whitened[p])))
                for q in terms:
                    product = np.sum(whitened[p] * np.swapaxes(whitened[q], 1, 2), axis=(1, 2))
                    information[p, q] += weight @ np.real(product)
        step = np.linalg.pinv(information, hermitian=True) @ score
        step = np.clip(step, -1.0, 1.0)
        moved = replace(
            self,
            log_level=self.log_level + float(step[0]),
            exponent=float(np.clip(self.exponent + step[1], 0.0, 4.0)),
            log_noise=self.log_noise + float(step[2]),
        )
        return moved, float(np.abs(step).max())

    def freed(self, spectra: Array, offset_px: Shifts, gain: Array) -> Spectrum:
        """Return the spectrum with the power that the frames show, smoothed over neighbours.

        P <- P0 (mean of E|X|^2 / P0)^(n / (n + nu)),   E|X|^2 given the frames (EM)
        """
        power = self.power
        seen_power = np.empty_like(power)
        for part in self.frequencies.parts(len(offset_px), 1):
            steering = self.steering(part, offset_px, gain)
            inverse = np.linalg.inv(self.covariance(power[part], steering))
            data = np.conj(steering) @ (inverse @ spectra[part][..., None])
            mean_square = (power[part] * np.abs(data[..., 0])) ** 2
            known = np.real(np.sum(np.conj(steering) * (steering @ np.swapaxes(inverse, 1, 2)), -1))
            seen_power[part] = mean_square + power[part] - power[part] ** 2 * known
        law = power / self.freedom
        bins = _NEIGHBOURS**2
        ratio = self.frequencies.smoothed(seen_power / law)
        lean = bins / (bins + _LEANING_BINS)
        return replace(self, freedom=np.maximum(ratio, _LEAST_FREEDOM) ** lean)

    def expected(self, spectra: Array, offset_px: Shifts, gain: Array) -> Array:
        """Return what of the spectra [frequency frame] is scene, not noise."""
        found = np.empty_like(spectra)
        power = self.power
        for part in self.frequencies.parts(len(offset_px), 1):
            matrix = self.covariance(power[part], self.steering(part, offset_px, gain))
            seen = np.linalg.solve(matrix, spectra[part][..., None])[..., 0]
            found[part] = spectra[part] - self.noise_power * seen
        return found


def first_spectrum(frequencies: Frequencies, spectra: Array) -> Spectrum:
    """Return a spectrum to start from: a usual power law that has the power of the frames."""
    start = Spectrum(frequencies, 0.0, 1.5, 0.0, np.ones_like(frequencies.down))
    weight = frequencies.weight[:, None]
    level = float(np.sum(weight * np.abs(spectra) ** 2) / spectra.shape[1])
    level = max(level, 1e-30)
    of_law = float(np.sum(weight * start.power))
    mean = level / float(np.sum(weight))
    return replace(
        start, log_level=float(np.log(level / of_law)), log_noise=float(np.log(1e-3 * mean))
    )
