"""Pixels that mix two surfaces, told from the distances around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import correlate1d, maximum_filter, minimum_filter

from lensshift.core.arrays import Array, Floats, Mask

# A pixel between two surfaces keeps this share of their step to both of them.
FLYING_SHARE = 0.2
FLYING_STEP = 0.05  # of the distance: smaller steps are no edges
FLYING_SIGMAS = 3.0
LEAST_STEP_M = 1e-6  # rounding of a distance
_AROUND = 2  # a surface is looked for in 5 x 5 pixels
_DEGREE = 2
_FREE = (2 * _AROUND + 1) ** 2 - 6  # values less the terms of a polynomial of that degree


def flying_pixels(
    distance_m: ArrayLike, *, noise_m: ArrayLike = 0.0, range_m: float | None = None
) -> Mask:
    """Return the pixels [row col] that lie between two surfaces and on neither.

        d - near >= q (far - near),   far - d >= q (far - near),   q = 0.2

    where near and far are either the nearest and farthest of the 3 x 3 neighbours, more than 5 % of
    near and 3 sigma apart, unless one slanted surface explains all 5 x 5 around, see `on_surface`;
    or what the two pixels on either side, along a row or a column, go on to at this pixel, from
    both of which it is off by more than 3 sqrt(6) sigma, the noise of that comparison: steps of any
    height, no slanted surface.

    Distances that come back are counted from 0 or from half their range, from where is farther from
    the pixel, as phasors mix the short way round; a surface may be a turn behind what is told.

    Parameters
    ----------
    distance_m : [row col]
    noise_m : standard deviation of the distances, sigma, one number or [row col]
    range_m : after which distances come back, if they do
    """
    image_m = np.asarray(distance_m, np.float64)
    sigma_m = np.broadcast_to(np.asarray(noise_m, np.float64), image_m.shape)
    if range_m is None:
        return _flying(image_m, sigma_m, [image_m])
    half_m = range_m / 2
    later_m = np.mod(image_m + half_m, range_m) + half_m
    ways = [image_m, later_m, image_m + range_m]
    amid = np.abs(image_m - half_m) < half_m / 2
    return np.where(amid, *(_flying(counted_m, sigma_m, ways) for counted_m in ways[:2]))


def _flying(image_m: Floats, sigma_m: Floats, ways: list[Floats]) -> Mask:
    """Return what flies if distances count so; no surface of any of the ways to count does."""
    near_m, far_m = minimum_filter(image_m, 3), maximum_filter(image_m, 3)
    step_m = FLYING_STEP * np.abs(minimum_filter(ways[0], 3))
    large = far_m - near_m > np.maximum(FLYING_SIGMAS * sigma_m, step_m)
    flying = large & _between(image_m, near_m, far_m)
    for counted_m in ways if flying.any() else []:
        flying &= ~on_surface(counted_m, sigma_m)
    for axis in (0, 1):
        if image_m.shape[axis] < 5:
            continue
        a, b, c, d, e, sigma = (
            np.moveaxis(part, axis, 0)[k : image_m.shape[axis] - 4 + k]
            for part, k in [(image_m, n) for n in range(5)] + [(sigma_m, 2)]
        )
        before, after = 2 * b - a, 2 * d - e
        apart = np.minimum(np.abs(c - before), np.abs(c - after))
        off = apart > np.maximum(FLYING_SIGMAS * np.sqrt(6.0) * sigma, LEAST_STEP_M)
        between = _between(c, np.minimum(before, after), np.maximum(before, after))
        np.moveaxis(flying, axis, 0)[2:-2] |= off & between
    return flying


def on_surface(distance_m: Floats, sigma_m: Floats) -> Mask:
    """Tell which pixels [row col] lie, with 5 x 5 around them, on one slanted surface.

    Of a plane behind a pinhole 1 / distance is nearly linear in rows and columns, however steeply
    the distance itself grows; a polynomial of degree 2 leaves 1e-4 of it where pixels are 2.5
    degrees wide. It explains what is there if the mean square of the rest, in units of the noise,
    is no more than chance allows:

        sum r^2 / (19 sigma^2) <= 1 + 3 sqrt(2 / 19)

    sigma is the geometric mean, as a few pixels beside a step have a wide one. A step that a pixel
    mixes half leaves 0.14 of the step. At the border the 5 x 5 are moved in. Images of less than
    five rows or columns show no surface.
    """
    if min(distance_m.shape) < 2 * _AROUND + 1:
        return np.zeros(distance_m.shape, np.bool_)
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.where(distance_m > 0, 1.0 / distance_m, np.nan)  # 1/m
        log_noise = np.log(sigma_m * near * near)
    along = np.arange(-_AROUND, _AROUND + 1.0)
    terms = np.linalg.qr(np.vander(along, _DEGREE + 1, increasing=True))[0].T
    rest = _sum(near * near)
    for order, term in enumerate(terms):
        part = correlate1d(near, term, axis=0)
        for other in terms[: _DEGREE + 1 - order]:
            rest -= np.square(correlate1d(part, other, axis=1))
    chance = 1.0 + FLYING_SIGMAS * np.sqrt(2.0 / _FREE)
    with np.errstate(invalid="ignore"):
        found = rest / _FREE <= chance * np.exp(2.0 * _sum(log_noise) / (2 * _AROUND + 1) ** 2)
    inside = slice(_AROUND, -_AROUND)
    return np.asarray(np.pad(found[inside, inside], _AROUND, mode="edge"))


def _sum(values: Array) -> Array:
    """Return the sums of 5 x 5 pixels."""
    ones = np.ones(2 * _AROUND + 1)
    return np.asarray(correlate1d(correlate1d(values, ones, axis=0), ones, axis=1))


def _between(image: Array, low: Array, high: Array) -> Mask:
    return np.asarray(np.minimum(image - low, high - image) >= FLYING_SHARE * (high - low))
