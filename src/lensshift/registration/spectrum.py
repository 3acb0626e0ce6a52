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
    """The frequencies of a transform without f = 0, and the aliases that fall on each."""

    shape: tuple[int, int]  # (rows, cols) of a frame
    # [frequency alias] in cycles per pixel
    down: Floats
    right: Floats
    weight: Floats  # [frequency] 1, or 1/2 where a real image counts a frequency twice
    whole_plane: bool  # whether the frames are complex
    reach: int  # the largest alias along an axis

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

    @property
    def own(self) -> Floats:
        """(down, right) [2 frequency] of the frequencies themselves, whose alias is 0."""
        middle = self.down.shape[1] // 2
        return np.stack([self.down[:, middle], self.right[:, middle]])

    def parts(self, frames: int) -> Iterator[slice]:
        """Yield slices of the frequencies that fit in memory one after another."""
        step = max(1, _NUMBERS_AT_ONCE // max(self.down.shape[1], 4 * frames**2))
        for first in range(0, len(self.down), step):
            yield slice(first, min(first + step, len(self.down)))

    def steering(self, offset_px: Shifts, gain: Array) -> Steering:
        """Return what frames at some offsets [frame 2] and with some gains see of them."""
        base = self.own.T
        alias = np.rint(np.stack([self.down[0], self.right[0]], axis=-1) - base[0])
        of_alias = gain * np.exp(-2j * np.pi * (alias @ offset_px.T))
        pairs = of_alias[:, :, None] * np.conj(of_alias[:, None])
        return Steering(
            np.exp(2j * np.pi * (base @ offset_px.T)), of_alias, pairs.reshape(len(alias), -1)
        )

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
class Steering:
    """What a frequency and its aliases look like in each frame.

        a_m = exp(-2 pi i f . d) b_m,   b_m = g exp(-2 pi i m . d)

    The first factor is that of all aliases of a frequency, the second that of all frequencies:
    where spectra are turned back by the first, covariances are sums of the same few matrices.
    """

    back: Array  # [frequency frame] exp(2 pi i f . d)
    alias: Array  # [alias frame] b_m
    pairs: Array  # [alias frame * frame] b_m b_m^H

    def summed(self, power: Floats) -> Array:
        """Return sum over m of P b b^H [... f frame frame] for P [... f alias]."""
        count = self.alias.shape[1]
        sums = power @ self.pairs.view(np.float64)  # faster than of complex numbers
        return sums.view(np.complex128).reshape(*power.shape[:-1], count, count)


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Power of the scene at each frequency and alias, and of white noise.

        P = exp(log_level) (f0^2 + |f|^2)^-exponent exp(-(2 pi sigma |f|)^2) freedom

    sigma is that of a full pixel while the frames tell one alias from none; more of them see a
    smaller pixel themselves.
    """

    frequencies: Frequencies  # where
    # of the power law and of the noise
    log_level: float
    exponent: float
    log_noise: float
    freedom: Floats  # [frequency alias] factor that the frames have shown, 1 at first

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

    def inverted(
        self, spectra: Array, steering: Steering
    ) -> Iterator[tuple[slice, Array, Array, Array]]:
        """Yield a part of the frequencies, S^-1, y and S^-1 y there, turned back.

        S = sum P b b^H + sigma^2 I
        """
        power, diagonal = self.power, np.arange(spectra.shape[1])
        turned = steering.back * spectra
        for part in self.frequencies.parts(spectra.shape[1]):
            matrix = steering.summed(power[part])
            rounding = _ROUNDING * power[part].sum(axis=-1, keepdims=True)
            matrix[:, diagonal, diagonal] += self.noise_power + rounding
            inverse = np.linalg.inv(matrix)
            yield part, inverse, turned[part], (inverse @ turned[part][..., None])[..., 0]

    def scored(self, spectra: Array, steering: Steering, *, whole: bool) -> tuple[Spectrum, float]:
        """Return the spectrum after one step of Fisher scoring, and the size of the step.

        Level, exponent and noise take part if `whole`, otherwise only the noise. Of the level,
        dS = S - sigma^2 I; of the noise, dS = sigma^2 I.
        """
        score, information = np.zeros(3), np.zeros((3, 3))
        noise, count = self.noise_power, spectra.shape[1]
        steeper = -self.power * self._log_frequency()
        for part, inverse, y, seen in self.inverted(spectra, steering):
            weight = self.frequencies.weight[part]
            trace = noise * np.real(np.trace(inverse, axis1=1, axis2=2))
            square = noise * np.sum(np.abs(seen) ** 2, axis=1)
            both = noise**2 * np.sum(np.abs(inverse) ** 2, axis=(1, 2))
            score[2] += weight @ (square - trace)
            information[2, 2] += weight @ both
            if not whole:
                continue
            score[0] += weight @ (
                np.real(np.sum(np.conj(y) * seen, axis=1)) - square - count + trace
            )
            information[0, 0] += weight @ (count - 2.0 * trace + both)
            information[0, 2] += weight @ (trace - both)
            slope = steering.summed(steeper[part])
            whitened = inverse @ slope
            own = np.real(np.trace(whitened, axis1=1, axis2=2))
            mixed = noise * np.real(np.einsum("fkl,flk->f", whitened, inverse))
            bent = np.real(np.sum(np.conj(seen) * (slope @ seen[..., None])[..., 0], axis=1))
            score[1] += weight @ (bent - own)
            information[1, 1] += weight @ np.real(np.einsum("fkl,flk->f", whitened, whitened))
            information[0, 1] += weight @ (own - mixed)
            information[1, 2] += weight @ mixed
        information += np.triu(information, 1).T
        step = np.linalg.pinv(information, hermitian=True) @ score
        # The whole step is shortened: level and exponent go together, and a step that is cut in one
        # of them alone leaves the likelihood worse, to and fro without end.
        step *= min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-300))
        moved = replace(
            self,
            log_level=self.log_level + float(step[0]),
            exponent=float(np.clip(self.exponent + step[1], 0.0, 4.0)),
            log_noise=self.log_noise + float(step[2]),
        )
        return moved, float(np.abs(step).max())

    def freed(self, spectra: Array, steering: Steering) -> Spectrum:
        """Return the spectrum with the power that the frames show, smoothed over neighbours.

        P <- P0 (mean of E|X|^2 / P0)^(n / (n + nu)),   E|X|^2 given the frames (EM)
        """
        power = self.power
        seen_power = np.empty_like(power)
        pairs = steering.pairs.view(np.float64).T
        for part, inverse, _, seen in self.inverted(spectra, steering):
            data = seen @ np.conj(steering.alias).T
            known = inverse.reshape(len(seen), -1).view(np.float64) @ pairs
            mean_square = (power[part] * np.abs(data)) ** 2
            seen_power[part] = mean_square + power[part] - power[part] ** 2 * known
        law = power / self.freedom
        bins = _NEIGHBOURS**2
        ratio = self.frequencies.smoothed(seen_power / law)
        lean = bins / (bins + _LEANING_BINS)
        return replace(self, freedom=np.maximum(ratio, _LEAST_FREEDOM) ** lean)

    def expected(self, spectra: Array, steering: Steering) -> Array:
        """Return what of the spectra [frequency frame] is scene, not noise."""
        found = np.empty_like(spectra)
        for part, _, y, seen in self.inverted(spectra, steering):
            found[part] = np.conj(steering.back[part]) * (y - self.noise_power * seen)
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
