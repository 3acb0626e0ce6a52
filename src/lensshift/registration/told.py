"""Shifts that were told, corrected as far as the frames surely show other ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from lensshift.core.arrays import Array, Mask, Shifts
from lensshift.registration.blocks import LEAST_VALID, scatter_of_parts, telling_part
from lensshift.registration.likelihood import UNKNOWN_PX, likely_shifts

# Samples of all frames together that are asked: four frames of 48 x 48 px, for a bounded price.
# Along an axis at least so many. And so many frames at a time, beside the first.
MOST_SAMPLES, LEAST_PX, MOST_OTHERS = 4 * 48**2, 24, 4
# Farther away are no errors of a rig, but frames that lie elsewhere, or something that moved.
REACH_PX = 0.3
# Twice the gain in log likelihood by which told shifts are surely wrong: the usual 3 sigma.
SURE = 3.0**2
# Errors in question lie between what nobody can tell and that reach.
_LOG_RANGE = (np.log(1e-5), np.log(REACH_PX))
_LEAST_PX2 = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Where the frames of a burst lie, beside where they were told to."""

    offset_px: Shifts  # [frame 2], with the mean that was told
    sigma_px: Shifts  # [frame 2] its standard deviation about that mean
    error_px: float  # standard deviation that the told offsets seem to have


def corrected_shifts(frames: Array, valid: Mask, told_px: Shifts) -> Correction | None:
    """Return the shifts as told and as shown weigh together, None if the frames do not object.

        d - t = e + n,   e ~ N(0, s^2 P),   n ~ N(0, C),   s by maximum likelihood
        e = s^2 (s^2 P + C)^-1 (d - t)

    d the likeliest shifts, t those told, both about their means (P: a common shift of all frames
    moves the picture and shows nowhere), C what the frames tell d to, wider where parts of the
    sensor disagree. Told shifts that are right leave s = 0 and stay; so do those of scenes with
    edges in one direction alone. Gain and level of each frame are free.

    Parameters
    ----------
    frames, valid : [frame row col]
    told_px : [frame 2]

    Source: the parametric empirical Bayes estimate, Efron and Morris (1973).
    """
    apart = _told_apart(frames, valid, told_px)
    if apart is None:
        return None
    away, variance, direction = apart

    def cost(log_s: float) -> float:
        whole = variance + np.exp(2.0 * log_s)
        return 0.5 * float(np.sum(np.log(whole) + away**2 / whole))

    best = minimize_scalar(cost, bounds=_LOG_RANGE, method="bounded")
    if 2.0 * (cost(_LOG_RANGE[0]) - best.fun) < SURE:
        return None
    error_px2 = float(np.exp(2.0 * best.x))
    share = error_px2 / (error_px2 + variance)
    spread = (direction * (share * variance)) @ direction.T
    return Correction(
        told_px + (direction @ (share * away)).reshape(told_px.shape),
        np.sqrt(np.maximum(np.diag(spread), 0.0)).reshape(told_px.shape),
        float(np.sqrt(error_px2)),
    )


def _told_apart(frames: Array, valid: Mask, told_px: Shifts) -> tuple[Array, Array, Array] | None:
    """Return likeliest less told shifts along uncorrelated directions, with their variances.

    None if the search leaves the place that it started at.
    """
    found = _likeliest(frames, valid, told_px)
    if found is None:
        return None
    likeliest_px, covariance_px2 = found
    about_mean = np.kron(np.eye(len(told_px)) - 1.0 / len(told_px), np.eye(2))
    away = about_mean @ (likeliest_px - told_px).ravel()
    if not np.abs(away).max() < REACH_PX:
        return None
    variance, direction = np.linalg.eigh(about_mean @ covariance_px2 @ about_mean)
    # The common shift leaves two directions without any variance, which come first.
    variance, direction = np.maximum(variance[2:], _LEAST_PX2), direction[:, 2:]
    return direction.T @ away, variance, direction


def _likeliest(frames: Array, valid: Mask, told_px: Shifts) -> tuple[Shifts, Array] | None:
    """Return the likeliest shifts near those told, and their covariance; None if not known.

    An edge that lies along the pixels looks alike in many places, and all along it: where there is
    a direction without detail, nothing tells how far such an edge may lie from where it seems to.
    Of many frames some at a time are asked, each time beside the first: the price of a likelihood
    goes with the cube of their number.
    """
    if valid.mean(axis=(1, 2)).min() < LEAST_VALID:
        return None
    count = len(frames)
    side = max(LEAST_PX, int((MOST_SAMPLES / count) ** 0.5))
    values = np.where(valid, frames, 0)
    values = values / (np.abs(values).max() or 1.0)
    part = telling_part(values, valid, told_px, side)
    values, seen = values[part], valid[part]
    likeliest_px, covariance = told_px.copy(), np.zeros((2 * count, 2 * count))
    others = np.random.default_rng(0).permutation(np.arange(1, count))  # no line of a pattern
    for some in np.array_split(others, -(-len(others) // MOST_OTHERS)):
        asked = np.append(0, some)
        fit = likely_shifts(values[asked], seen[asked], told_px[asked], photometric=True)
        if not fit.converged or np.any(fit.sigma_px > UNKNOWN_PX):
            return None
        scatter = scatter_of_parts(values[asked], seen[asked], fit, 0, photometric=True)
        likeliest_px[some] = fit.offset_px[1:]
        place = (2 * asked[:, None] + [0, 1]).ravel()
        covariance[np.ix_(place, place)] += scatter.widened(fit.covariance_px2)
    return likeliest_px, covariance
