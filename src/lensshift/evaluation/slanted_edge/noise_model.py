"""Noise of a region, read off the plateaus: its level on both sides, correlation, uneven light."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.special import fdtr, fdtrc

from lensshift.core.arrays import Mask
from lensshift.evaluation.slanted_edge.edge_model import Matrix, Vector

Places = NDArray[np.intp]

_LARGEST_ORDER = 3
_SIGNIFICANT = 1e-3
NOISELESS = 1e-4  # of the contrast
_WHOLE = 1e-3  # of a step: nearer to a whole number of steps is rounded
_LARGEST_SUM = 0.8  # of a prediction: a smoother noise is not told from uneven light
_BLOCK = 4
_FEWEST_BLOCKS = 8
_MOST_SITES = 10_000
_NEAR_STEPS, _NEAREST = 6, 3  # where there may be more noise, and where it is looked for
_FREE_ERROR = 2e-3  # of the contrast: what a free ESF may be off by near a sharp edge
_NEAR_STEP_PX = 2.0  # of the distance from the edge, in which noise near it is told
_NEAR_PX = 8.0  # how far its own correlation reaches: a block of a JPEG
_FEWEST_SITES = 40  # plateau pixels below which noise counts as white and even


@dataclass(frozen=True, slots=True)
class NearNoise:
    """Noise near an edge that is not that of the plateaus."""

    variance: Vector  # over that of the plateaus, in steps of the distance from the edge
    order: int  # as those of `NoiseModel`
    prediction: Vector
    innovation: float  # variance that this prediction leaves, over that of the plateaus' own


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """What whitens the noise of a region."""

    dark_sigma: float  # standard deviation on the dark plateau
    bright_sigma: float  # on the bright one
    order: int  # reach in pixels of the prediction from earlier neighbours; 0 for white noise
    prediction: Vector  # [k] factors of those neighbours, in the order of `_half_plane`
    near: NearNoise | None = None  # noise near the edge, None where it is that of the plateaus

    @property
    def is_plain(self) -> bool:
        """Whether there is nothing to whiten."""
        return self.order == 0 and self.dark_sigma == self.bright_sigma and self.near is None

    def relative_sigma(self, response: Vector, normal_px: Vector) -> Vector:
        """Return the deviation of pixels over that of the dark plateau; shot noise is linear."""
        ratio = (self.bright_sigma / self.dark_sigma) ** 2
        share = np.clip(response, 0.0, 1.0)
        variance = 1.0 - share + ratio * share
        if self.near is not None:
            steps = self.near.variance
            middles = _NEAR_STEP_PX * (np.arange(steps.size) + 0.5)
            variance *= np.interp(np.abs(normal_px), middles, steps)
        return np.asarray(np.sqrt(variance))

    def whitener(
        self, places: Places, relative_sigma: Vector, normal_px: Vector
    ) -> sparse.csr_array:
        """Return [m n]: pixels minus what their neighbours foretell, over their deviation.

        Of pixels at places [n 3], with the deviations of `relative_sigma`, so far from the edge.
        """
        scaled = sparse.diags_array(1.0 / relative_sigma)
        order = max(self.order, 0 if self.near is None else self.near.order)
        if order == 0:
            return scaled.tocsr()
        found = _look_up(_index_of(places), places, _half_plane(order))
        whole = np.all(found >= 0, axis=1)
        taps = np.hstack([np.flatnonzero(whole)[:, None], found[whole]])
        factors = np.tile(_widened(self.order, self.prediction, order), (len(taps), 1))
        if self.near is not None:
            close = np.abs(normal_px[whole]) < _NEAR_PX
            own = _widened(self.near.order, self.near.prediction, order)
            factors[close] = own / np.sqrt(self.near.innovation)
        rows = np.repeat(np.arange(len(taps)), taps.shape[1])
        shape, entries = (len(taps), len(places)), (factors.ravel(), (rows, taps.ravel()))
        return (sparse.csr_array(entries, shape=shape) @ scaled).tocsr()


def _widened(order: int, prediction: Vector, wanted: int) -> Vector:
    """Return 1 and minus the factors of a prediction of a larger order, those beyond being 0."""
    steps = _half_plane(wanted)
    factors = np.zeros(len(steps))
    factors[np.max(np.abs(steps), axis=1, initial=0) <= order] = -prediction
    return np.append(1.0, factors)


@dataclass(frozen=True, slots=True)
class Rounding:
    """What whole numbers do to pixels whose noise is too small to dither them."""

    sigma: float  # of a single pixel; 0 where values are not whole numbers of a step
    alike: Vector  # [n] how many pixels see the light of each, to a step

    def shared(self, sigma: Vector) -> Vector:
        """Return [n]: the variance by which to raise that of pixels of deviation `sigma` [n].

            m s^2 / 12 exp(-4 pi^2 v / s^2),   s the step, v the variance of noise before rounding

        All m pixels that see the same light are off by the same: together they count as one.
        Noise of half a step takes that error away (the factor is the square of the first harmonic).

        Source: Widrow and Kollar, Quantization Noise, 2008, of the characteristic function.
        """
        if self.sigma == 0.0:
            return np.zeros_like(self.alike)
        before = np.maximum((sigma / self.sigma) ** 2 - 1.0, 0.0)
        return np.asarray(self.alike * self.sigma**2 * np.exp(-(np.pi**2) / 3.0 * before))


def rounding_of(values: Vector, smooth: Vector) -> Rounding:
    """Return how values [n] are rounded, of pixels that see about the light `smooth` [n].

    They are alike by what they see: were it by what they were rounded to, the rarer one of two
    numbers on a plateau would count as much as the other one.
    """
    levels = np.unique(values)
    steps = np.diff(levels)
    step = float(np.min(steps, initial=np.inf))
    whole = np.isfinite(step) and np.all(np.abs(steps / step - np.rint(steps / step)) < _WHOLE)
    if not whole or levels.size <= 2:
        return Rounding(0.0, np.zeros_like(values))
    rising = np.sort(smooth)
    ends = (np.searchsorted(rising, smooth + side * step) for side in (0.5, -0.5))
    return Rounding(step / np.sqrt(12.0), np.maximum(np.subtract(*ends), 1).astype(np.float64))


def plateau_tilt_matters(
    values: Vector, places: Places, sides: list[Mask], columns: Matrix, least: float = 0.0
) -> bool:
    """Tell whether planes describe the plateaus better than constants do (F test).

    The test takes the means of blocks of pixels, which correlated noise does not deceive. Planes
    have slopes [n k]; a deviation below `least`, as that of rounding, is not worth them.
    """
    least = max(least, NOISELESS)
    plain = tilted = 0.0
    blocks = 0
    for side in sides:
        if not side.any():
            return False
        means = _block_means(places[side], np.column_stack([values, columns])[side])
        if len(means) < _FEWEST_BLOCKS:
            return False
        means = means - means.mean(axis=0)
        y, slopes = means[:, 0], means[:, 1:]
        rest = y - slopes @ np.linalg.lstsq(slopes, y)[0]
        plain, tilted, blocks = plain + y @ y, tilted + rest @ rest, blocks + y.size
    terms = 2 * columns.shape[1]
    freedom = blocks - terms - 2
    if tilted <= least**2 * blocks:
        return bool(plain > least**2 * blocks)
    ratio = (plain - tilted) / terms / (tilted / freedom)
    return bool(fdtrc(terms, freedom, ratio) < _SIGNIFICANT)


def few_factors(columns: Matrix, values: Vector) -> Vector:
    """Return the least squares factors of a few long columns, quickly by the normal equations."""
    return np.asarray(np.linalg.lstsq(columns.T @ columns, columns.T @ values)[0])


def _block_means(places: Places, columns: Matrix) -> Matrix:
    """Return [b k]: means over blocks that are at least half full."""
    frame, row, col = (places // np.array([1, _BLOCK, _BLOCK])).T
    block = np.ravel_multi_index((frame, row, col), (frame.max() + 1, row.max() + 1, col.max() + 1))
    count = np.bincount(block)
    sums = np.stack([np.bincount(block, weights=column) for column in columns.T], axis=1)
    full = count >= _BLOCK**2 // 2
    return np.asarray(sums[full] / count[full, None])


def estimate_noise(residual: Vector, places: Places, sides: list[Mask]) -> NoiseModel:
    """Estimate the noise from the residuals [n] at places [n 3], by masks of both plateaus.

    The two sides get different levels only if an F test tells them apart; the order of the
    prediction is the one with the smallest Bayesian information criterion.
    """
    counts = [int(side.sum()) for side in sides]
    if min(counts) < _FEWEST_SITES:
        both = residual[sides[0] | sides[1]] if sum(counts) > 1 else residual
        sigma = float(np.std(both))
        return NoiseModel(sigma, sigma, 0, np.zeros(0))
    dark, bright = (float(np.std(residual[side])) for side in sides)
    together = float(np.sqrt(np.mean(residual[sides[0] | sides[1]] ** 2)))
    if min(dark, bright) < NOISELESS:  # rounding alone; it is neither white nor of one size
        return NoiseModel(together, together, 0, np.zeros(0))
    scaled = np.full(residual.size, np.nan)
    for side in sides:
        scaled[side] = (residual[side] - residual[side].mean()) / np.std(residual[side])
    order, prediction, _ = _best_prediction(scaled, places, np.flatnonzero(np.isfinite(scaled)))
    # Correlated residuals count for less than their number.
    of_dark, of_bright = (count / (1 + 2 * order) ** 2 for count in counts)
    told = of_bright, of_dark, (bright / dark) ** 2
    if min(fdtrc(*told), fdtr(*told)) < 0.5 * _SIGNIFICANT:
        return NoiseModel(dark, bright, order, prediction)
    return NoiseModel(together, together, order, prediction)


def _by_distance(values: Vector, normal_px: Vector) -> tuple[Vector, Places]:
    """Return sums of squares [b], and counts, in steps of the distance from the edge."""
    number, bins = (np.abs(normal_px) / _NEAR_STEP_PX).astype(np.intp), _NEAR_STEPS + 1
    number = np.minimum(number, _NEAR_STEPS)
    sums = np.bincount(number, values**2, minlength=bins).astype(np.float64)
    return sums, np.bincount(number, minlength=bins)


def noise_of_covariance(covariance: Matrix, contrast: float) -> NoiseModel:
    """Return what whitens noise of a known autocovariance, as `noise_autocovariance` returns.

        sum_j C(n_i - n_j) a_j = C(n_i),   n the neighbours that come earlier

    Raises `ValueError` if it is not the autocovariance of any noise.

    Source: Yule-Walker equations, Kay, Modern Spectral Estimation, 1988.
    """
    values = np.asarray(covariance, dtype=np.float64)
    if values.ndim != 2 or min(size % 2 for size in values.shape) == 0:
        raise ValueError(f"expected a noise_covariance of odd sides, got shape {values.shape}")
    if not np.all(np.isfinite(values)) or not np.allclose(values, values[::-1, ::-1]):
        raise ValueError("expected a finite noise_covariance, equal at opposite lags")
    rows, cols = (size // 2 for size in values.shape)
    variance = float(values[rows, cols])
    if not variance > 0.0 or np.max(np.abs(values)) > variance * (1.0 + 1e-9):
        raise ValueError("expected a noise_covariance that is largest, and positive, in the middle")
    sigma = float(np.sqrt(variance)) / contrast
    order = min(_LARGEST_ORDER, max(rows, cols))
    steps = _half_plane(order)
    if order == 0:
        return NoiseModel(sigma, sigma, 0, np.zeros(0))

    far = 2 * order  # the farthest that two neighbours lie apart; beyond the lags, noise is free
    padded = np.pad(values, far)

    def at(lags: Places) -> Matrix:
        row, col = np.moveaxis(lags, -1, 0)
        return np.asarray(padded[rows + far + row, cols + far + col])

    between = at(steps[:, None, :] - steps[None, :, :])
    between.flat[:: len(steps) + 1] += NOISELESS * variance  # smooth noise has nearly equal rows
    return NoiseModel(sigma, sigma, order, _foretelling(between, at(steps)))


def _best_prediction(scaled: Vector, places: Places, sites: Places) -> tuple[int, Vector, float]:
    """Return order and factors that foretell noise [n] at places [n 3], and the variance left."""
    widest, sites = _half_plane(_LARGEST_ORDER), sites[:: max(1, sites.size // _MOST_SITES)]
    found = _look_up(_index_of(places), places[sites], widest)
    around = np.where(found >= 0, scaled[found], np.nan)
    whole = np.all(np.isfinite(around), axis=1)
    around, foretold = around[whole], scaled[sites[whole]]
    best, lowest = (0, np.zeros(0), 1.0), np.inf
    count = int(whole.sum())
    for order in range(_LARGEST_ORDER + 1):
        used = np.max(np.abs(widest), axis=1) <= order
        terms = int(used.sum())
        if count < 4 * terms + _FEWEST_SITES // 2:
            break
        inputs = around[:, used]
        products = inputs.T @ inputs
        factors = _foretelling(products, inputs.T @ foretold) if terms else np.zeros(0)
        rest = float(np.mean((foretold - inputs @ factors) ** 2))
        criterion = count * np.log(max(rest, 1e-300)) + terms * np.log(count)
        if criterion < lowest:
            best, lowest = (order, factors, rest), criterion
    return best


def _foretelling(products: Matrix, right: Vector) -> Vector:
    """Return least squares factors of neighbours [k], of a sum that leaves plateaus their level.

    A sum of 1 whitens every constant to 0: the levels are free then, and diverge.
    """
    factors, evenly = np.linalg.lstsq(products, np.stack([right, np.ones(right.size)], 1))[0].T
    over = max(float(factors.sum()) - _LARGEST_SUM, 0.0)
    return np.asarray(factors - over / evenly.sum() * evenly)


def _half_plane(order: int) -> Places:
    """Return [k 2]: steps to all neighbours within `order` that come earlier, row by row."""
    steps = range(-order, order + 1)
    return np.array([(dr, dc) for dr in steps for dc in steps if (dr, dc) < (0, 0)], dtype=np.intp)


def _index_of(places: Places) -> Places:
    """Return [frame row col]: the number of the pixel there, -1 for none; a margin all round."""
    margin = _LARGEST_ORDER
    frames, rows, cols = places.max(axis=0) + 1
    index = np.full((frames, rows + 2 * margin, cols + 2 * margin), -1, dtype=np.intp)
    index[places[:, 0], places[:, 1] + margin, places[:, 2] + margin] = np.arange(len(places))
    return index


def _look_up(index: Places, places: Places, steps: Places) -> Places:
    """Return [n k]: the numbers of the pixels that lie each of the steps [k 2] from the places."""
    strides = np.array([index[0].size, index.shape[2], 1])
    start = places @ strides + _LARGEST_ORDER * strides[1:].sum()
    return np.asarray(np.take(index, start[:, None] + steps @ strides[1:]))


def with_edge(
    noise: NoiseModel, residual: Vector, response: Vector, normal_px: Vector, places: Places,
) -> NoiseModel:  # fmt: skip
    """Return the noise with that near the edge, if there is more of it than on plateaus (F test).

    Compression keeps more of the noise in blocks with an edge, and adds what its steps cut off;
    lines that are displaced or pixels that differ show at the edge alone. The residual is that of
    a free ESF, `response`; all are [n], places [n 3].
    """
    if noise.dark_sigma <= NOISELESS:
        return noise
    relative = noise.relative_sigma(response, normal_px)
    # What their neighbours foretell of the pixels would make fewer of them independent.
    whitener = noise.whitener(places, relative, normal_px)
    which = np.maximum.reduceat(whitener.indices, whitener.indptr[:-1])
    sums, counts = _by_distance(whitener @ residual, normal_px[which])
    near, far = int(counts[:_NEAREST].sum()), int(counts[_NEAR_STEPS])
    level = float(sums[_NEAR_STEPS]) / max(far, 1)
    if min(near, far) < _FEWEST_SITES or level <= 0.0:
        return noise
    most = float(sums[:_NEAREST].sum()) / near - _FREE_ERROR**2
    if fdtrc(near, far, most / level) > _SIGNIFICANT:
        return noise
    sums, counts = _by_distance(residual / relative, normal_px)
    far_level = float(sums[_NEAR_STEPS]) / counts[_NEAR_STEPS]
    # Where compression left nothing at all far out, the plateaus' own level counts.
    level = max(far_level, noise.dark_sigma**2)
    each = (sums / np.maximum(counts, 1) - _FREE_ERROR**2)[:_NEAR_STEPS] / level
    if np.max(each) <= 1.0:  # the pixels scatter less there: neighbours merely foretell less
        return noise
    louder = NearNoise(np.append(np.maximum(each, 1.0), 1.0), 0, np.zeros(0), 1.0)
    noise = replace(noise, near=louder)
    scaled = residual / noise.relative_sigma(response, normal_px)
    close = np.abs(normal_px) < _NEAR_PX
    order, prediction, left = _best_prediction(scaled, places, np.flatnonzero(close))
    beyond = _best_prediction(scaled, places, np.flatnonzero(~close))[2]
    innovation = left / max(beyond * level / far_level, np.finfo(float).tiny)
    return replace(noise, near=NearNoise(louder.variance, order, prediction, innovation))
