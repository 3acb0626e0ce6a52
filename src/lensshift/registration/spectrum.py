"""The power of the scene behind a burst, with its aliases, and of the noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lensshift.core.arrays import Array, Floats, Shifts

# The blur of a square pixel that fills its cell; the power law takes up what differs.
PIXEL_SIGMA_PX = 0.3
_FURTHEST_ALIAS = 3  # of sharp edges behind half-filled pixels 1e-5 of the power lies beyond
# The freed power leans towards the power law as if it had seen that many bins of it.
_LEANING_BINS = 0.3
# Of a pattern against noise, logarithms: a thousandth is none.
_LEAST_LOG_PATTERN, _FIRST_LOG_PATTERN = -7.0, -4.0
# Of the power of the frames: a pattern of 4 % of the light, where that varies by 30 %.
_MOST_PATTERN = 0.02
_LEAST_FREEDOM = 1e-6  # so that roots and logarithms exist
_PASSES, _SMALL_STEP = 5, 0.02  # of the first power law, which goes on to change later
_NEIGHBOURS = 3  # bins along each axis that are averaged
# Of the power of the scene, which may be 10^18 times the noise at the lowest frequencies of large
# smooth frames: with less on the diagonal no inverse is known.
_ROUNDING = 1e-13
_NUMBERS_AT_ONCE = 200_000  # a few MB at a time, which stay in the cache


@dataclass(frozen=True, eq=False)
class Frequencies:
    """The frequencies of a transform without f = 0, and the aliases that fall on each."""

    shape: tuple[int, int]  # (rows, cols) of a frame
    # [frequency alias] in cycles per pixel
    down: Floats
    right: Floats
    weight: Floats  # [frequency] 1, or 1/2 where a real image counts a frequency twice
    whole_plane: bool  # whether the frames are complex
    reach: int  # the largest alias along an axis
    sets: int = 1  # of frames, whose frequencies come one set after another

    @classmethod
    def of(cls, shape: tuple[int, ...], *, whole_plane: bool, sets: int = 1) -> Frequencies:
        """Return those of frames [frame row col], or of several sets of such frames.

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
            np.tile(row_at.reshape(-1, count)[1:], (sets, 1)),
            np.tile(col_at.reshape(-1, count)[1:], (sets, 1)),
            np.tile(weight.ravel()[1:], sets),
            whole_plane,
            reach,
            sets,
        )

    @cached_property
    def of_set(self) -> Floats:
        """Weight [set frequency], 0 at frequencies of other sets."""
        return np.kron(np.eye(self.sets), np.ones(len(self.weight) // self.sets)) * self.weight

    def each(self, values: Floats | float) -> Floats:
        """Return values [set] at every frequency."""
        return np.repeat(values, len(self.weight) // self.sets)

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

    @cached_property
    def log_square(self) -> Floats:
        """Logarithm [frequency alias] of f0^2 + |f|^2, f0 the lowest frequency of a frame."""
        return np.asarray(np.log(max(self.shape) ** -2.0 + self.down**2 + self.right**2))

    def smoothed(self, values: Floats) -> Floats:
        """Return the mean over the neighbours of each frequency, aliases included, [f alias]."""
        from scipy.ndimage import uniform_filter

        rows, cols = ((2 * self.reach + 1) * size for size in self.shape)
        row, col = (np.rint(of * size).astype(np.intp) for of, size in
                    zip((self.down, self.right), self.shape, strict=True))  # fmt: skip
        first = rows * cols * np.arange(self.sets).repeat(len(self.weight) // self.sets)[:, None]
        places = np.stack([(first + sign * row % rows * cols + sign * col % cols)
                           for sign in ((1,) if self.whole_plane else (1, -1))])  # fmt: skip
        planes, near = (self.sets, rows, cols), (1, _NEIGHBOURS, _NEIGHBOURS)
        sums = []
        for of in (values, np.ones_like(values)):
            weight = np.broadcast_to(of, places.shape).ravel()
            whole = np.bincount(places.ravel(), weight, self.sets * rows * cols).reshape(planes)
            sums.append(uniform_filter(whole, near, mode="wrap").ravel()[places[0]])
        return np.asarray(sums[0] / sums[1])


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


class Solved(NamedTuple):
    """A part of the frequencies; covariance and spectra are turned back by `Steering.back`."""

    part: slice
    inverse: Array  # [frequency frame frame] S^-1
    y: Array  # [frequency frame] the spectra
    seen: Array  # [frequency frame] S^-1 y


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power of the scene at each frequency and alias, of white noise and of a fixed pattern.

        P = exp(log_level) (f0^2 + |f|^2)^-exponent exp(-(2 pi sigma |f|)^2) freedom

    sigma is that of a full pixel while the frames tell one alias from none; more of them see a
    smaller pixel themselves.
    """

    frequencies: Frequencies  # where
    # [set] of the power law and of the noise
    log_level: Floats
    exponent: Floats
    log_noise: Floats
    log_pattern: Floats  # of what stays at the pixels while the scene moves
    freedom: Floats  # [frequency alias] factor that the frames have shown, 1 at first
    most_pattern: Floats | float = np.inf  # [set] logarithm; more is a scene that stands still
    pattern_asked: bool = False  # or else it is known

    @property
    def noise_power(self) -> Floats:
        """Variance [set] of the noise of an LR pixel."""
        return np.exp(self.log_noise)

    @cached_property
    def power(self) -> Floats:
        """Power P [frequency alias]."""
        at = self.frequencies
        square = at.down**2 + at.right**2
        blur = (2.0 * np.pi * PIXEL_SIGMA_PX / at.reach) ** 2 * square
        level, exponent = (at.each(of)[:, None] for of in (self.log_level, self.exponent))
        law = np.exp(level - exponent * at.log_square - blur)
        return np.asarray(law * self.freedom)

    def solved(self, spectra: Array, steering: Steering) -> Iterator[Solved]:
        """Yield a part of the frequencies after another, with S^-1 and S^-1 y there.

        S = sum P b b^H + sigma^2 I + tau^2 c c^H,   c = exp(2 pi i f . d)
        """
        power, diagonal = self.power, np.arange(spectra.shape[1])
        noise = self.frequencies.each(self.noise_power)
        turned = steering.back * spectra
        for part in self.frequencies.parts(spectra.shape[1]):
            matrix = steering.summed(power[part])
            rounding = _ROUNDING * power[part].sum(axis=-1)
            matrix[:, diagonal, diagonal] += (noise[part] + rounding)[:, None]
            matrix += self._still(steering, part)
            inverse = np.linalg.inv(matrix)
            seen = (inverse @ turned[part][..., None])[..., 0]
            yield Solved(part, inverse, turned[part], seen)

    def _still(self, steering: Steering, part: slice) -> Array:
        """Return the covariance of the fixed pattern [f frame frame]: it is in all frames alike."""
        tau = np.exp(0.5 * self.frequencies.each(self.log_pattern))
        back = steering.back[part] * tau[part, None]
        return np.asarray(back[:, :, None] * np.conj(back[:, None]))

    def learned(
        self,
        spectra: Array,
        steering: Steering,
        *,
        whole: bool,
        ask: Callable[[Solved], None] | None = None,
    ) -> Learned:
        """Return what the frames say of scene and noise; of the power law only if `whole`.

        `ask` is told of each part of the frequencies, to take what else it says.
        """
        sets = self.frequencies.sets
        score, information = np.zeros((4, sets)), np.zeros((4, 4, sets))
        power = np.empty_like(self.power)
        pairs = steering.pairs.view(np.float64).T
        for one in self.solved(spectra, steering):
            part, inverse, _, seen = one
            self._score(one, steering, score, information, whole=whole)
            data = seen @ np.conj(steering.alias).T
            known = inverse.reshape(len(seen), -1).view(np.float64) @ pairs
            mean_square = (self.power[part] * np.abs(data)) ** 2
            power[part] = mean_square + self.power[part] - self.power[part] ** 2 * known
            if ask is not None:
                ask(one)
        return Learned(*self._stepped(score, information), power)

    def _score(
        self, at: Solved, steering: Steering, score: Floats, information: Floats, *, whole: bool
    ) -> None:
        """Add the gradient by noise, pattern, level and exponent [4 set], and information.

        Level and exponent take part if `whole`.
        """
        part, inverse, _, seen = at
        weight = self.frequencies.of_set[:, part]
        noise = self.frequencies.each(self.noise_power)[part, None, None]
        powers = (self.power, -self.power * self.frequencies.log_square) if whole else ()
        slopes = [noise * np.eye(seen.shape[1]), self._still(steering, part),
                  *(steering.summed(one[part]) for one in powers)]  # fmt: skip
        whitened = [noise * inverse, *(inverse @ one for one in slopes[1:])]
        for i, slope in enumerate(slopes):
            bent = np.sum(np.conj(seen) * (slope @ seen[..., None])[..., 0], axis=1)
            score[i] += weight @ np.real(bent - np.trace(whitened[i], axis1=1, axis2=2))
            for j in range(i, len(slopes)):
                both = np.sum(whitened[i] * np.swapaxes(whitened[j], 1, 2), axis=(1, 2))
                information[i, j] += weight @ np.real(both)

    def _stepped(self, score: Floats, information: Floats) -> tuple[Spectrum, float]:
        """Return the spectrum after a step of Fisher scoring, and the size of the step."""
        square = np.moveaxis(information, 2, 0)
        square = square + np.triu(square, 1).swapaxes(1, 2)
        step = (np.linalg.pinv(square, hermitian=True) @ score.T[..., None])[..., 0]
        # The whole step is shortened: level and exponent go together, and a step that is cut in one
        # of them alone leaves the likelihood worse, to and fro without end. A pattern that is small
        # as yet asks for steps as large as its score is unsure.
        still, rest = np.clip(step[:, 1], -1.0, 1.0), step[:, [0, 2, 3]]
        rest /= np.maximum(np.abs(rest).max(axis=1, keepdims=True), 1.0)
        log_noise = self.log_noise + rest[:, 0]
        log_pattern = np.maximum(self.log_pattern + still, log_noise + _LEAST_LOG_PATTERN)
        log_pattern = np.minimum(log_pattern, self.most_pattern)
        moved = replace(
            self, log_noise=log_noise, log_level=self.log_level + rest[:, 1],
            log_pattern=log_pattern if self.pattern_asked else self.log_pattern,
            exponent=np.clip(self.exponent + rest[:, 2], 0.0, 4.0),
        )  # fmt: skip
        return moved, float(np.abs(rest).max())

    def freed(self, power: Floats) -> Spectrum:
        """Return the spectrum with the power that the frames show, smoothed over neighbours.

        P <- P0 (mean of E|X|^2 / P0)^(n / (n + nu)),   E|X|^2 given the frames (EM)
        """
        bins = _NEIGHBOURS**2
        ratio = self.frequencies.smoothed(power * self.freedom / self.power)
        lean = bins / (bins + _LEANING_BINS)
        return replace(self, freedom=np.maximum(ratio, _LEAST_FREEDOM) ** lean)

    def pattern_over(self, before: Spectrum) -> float:
        """Return by how much the logarithm of the power of the pattern has grown, 0 if unasked."""
        if not before.pattern_asked:
            return 0.0
        return float(np.max(self.log_pattern - before.log_pattern))

    def asking_pattern(self) -> Spectrum:
        """Return the spectrum with a small fixed pattern, whose power is asked from here on."""
        return replace(self, log_pattern=self.log_noise + _FIRST_LOG_PATTERN, pattern_asked=True)


class Learned(NamedTuple):
    """What frames say of scene and noise."""

    spectrum: Spectrum  # after one step of Fisher scoring
    step: float  # its size
    power: Floats  # [frequency alias] E|X|^2 given the frames


def first_spectrum(
    frequencies: Frequencies, spectra: Array, steering: Steering, log_pattern: float = -np.inf
) -> Spectrum:
    """Return the likeliest power law beside a pattern, from one with the power of the frames."""
    none = np.zeros(frequencies.sets)
    start = Spectrum(frequencies, none, none + 1.5, none, none, np.ones_like(frequencies.down))
    of_set = frequencies.of_set
    level = of_set @ np.sum(np.abs(spectra) ** 2, axis=1) / spectra.shape[1]
    level = np.maximum(level, 1e-30)
    of_law = of_set @ start.power.sum(axis=1)
    mean = level / of_set.sum(axis=1)
    log_noise = np.log(1e-3 * mean)
    found = replace(
        start, log_level=np.log(level / of_law), log_noise=log_noise,
        log_pattern=log_pattern + none, most_pattern=np.log(_MOST_PATTERN * mean),
    )  # fmt: skip
    for _ in range(_PASSES):
        found, step, *_ = found.learned(spectra, steering, whole=True)
        if step < _SMALL_STEP:
            break
    return found
