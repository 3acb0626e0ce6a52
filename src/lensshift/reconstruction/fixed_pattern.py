"""What stays at the pixels while the scene moves: the fixed pattern of a camera, and how much.

Of frames without their smooth part, r = y - (1 2 1)/4 x (1 2 1)/4 y, the covariance between pixels
of two frames follows from how far apart the places are that they look at, unless it follows from
the pixels themselves:

    <r_k(i) r_l(i + s)> = C(s - (d_l - d_k)) + p(s) + [k = l] t(s),
    C(e) = sum over v of S(v) cos(2 pi v e),   S, p, t >= 0

C of a scene that is whatever it is, p of a pattern of pixels, columns and rows, and t of noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.ndimage import correlate1d, minimum_filter, uniform_filter
from scipy.optimize import nnls

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.order import median

# Fewer frames, or smaller ones, do not tell the pattern from the scene.
LEAST_FRAMES, LEAST_PX = 3, 12
# More frames, and pixels beyond the middle of large ones, would say the same.
MOST_FRAMES, MOST_PX = 6, 192
SMOOTH = np.array([0.25, 0.5, 0.25])
REACH_PX = 2  # how far apart pixels are compared
LAGS = [(a, b) for a in range(REACH_PX + 1) for b in range(-REACH_PX, REACH_PX + 1)
        if (a, b) >= (0, 0)]  # fmt: skip
# Frequencies in cycles per pixel, up to where a square pixel sees nothing. Waves so far apart are
# alike again after 5 px: what lies more than half of that apart is not compared.
STEP, HIGHEST = 0.2, 1.0
MOST_APART_PX = 0.5 / STEP - 0.1
PATTERN = slice(-6, -3)  # of the terms
# How much scatters is seen by so many parts along rows and along columns.
PARTS = 4
# Four standard errors of 16 parts; of 384 right bursts of eight kinds of scenes none has more than
# three. And the covariances are as they were told, within what they scatter by.
SURE, FITS = 4.0, 1.0


@dataclass(frozen=True, slots=True)
class PatternPower:
    """How much of what frames show stays at the pixels.

    Parameters
    ----------
    variance : of the pattern, in units of the frames
    sure : over its standard error
    misfit : what is left of the covariances over what they scatter by
    """

    variance: float
    sure: float
    misfit: float

    @property
    def certain(self) -> bool:
        """Whether a scene that moves as it was told does not explain the frames without it."""
        return self.sure > SURE and self.misfit < FITS


def pattern_power(
    frames: Array, valid: Mask, offset_px: Floats, *, phases: bool = False
) -> PatternPower | None:
    """Return how much of frames [frame row col] stays at the pixels, None if they cannot tell.

    Parameters
    ----------
    frames : real
    valid : [frame row col]
    offset_px : [frame 2]
    phases : whether they are phases: of these products of pixels count by their inverse variance
    """
    chosen = np.flatnonzero(valid.any(axis=(1, 2)))
    away_px = np.abs(offset_px[chosen] - np.median(offset_px[chosen], axis=0)).max(axis=1)
    chosen = chosen[away_px < MOST_APART_PX / 2]  # near enough to each other to be compared
    evenly = np.linspace(0, len(chosen) - 1, min(len(chosen), MOST_FRAMES))
    chosen = chosen[np.unique(evenly.round().astype(int))]
    if len(chosen) < LEAST_FRAMES or min(frames.shape[1:]) < LEAST_PX:
        return None
    rows, cols = (slice((n - min(n, MOST_PX)) // 2, (n + min(n, MOST_PX)) // 2)
                  for n in frames.shape[1:])  # fmt: skip
    there = chosen, rows, cols
    parts, weight = _covariances(frames[there], valid[there], 1 + phases)
    if not np.all(weight > 0):
        return None
    offset = np.round(offset_px[chosen] - offset_px[chosen[0]], 3)
    compared, Q, R = _design(offset.tobytes(), len(chosen))
    whole, count = parts.sum(axis=0) / weight.sum(axis=0), len(parts)
    scatter = ((parts - whole * weight) / weight.sum(axis=0)).reshape(count, -1)[:, compared]
    error = float(np.sum(scatter**2)) * count / (count - 1)
    if error == 0.0:
        return None
    seen = whole.ravel()[compared]
    unit = float(np.abs(seen).max())
    found = nnls(R, Q.T @ seen / unit)[0]
    rest = seen - Q @ (R @ found) * unit
    without = (parts.sum(axis=0) - parts) / (weight.sum(axis=0) - weight)
    others = Q.T @ without.reshape(count, -1)[:, compared].T / unit
    return PatternPower(
        float(found[PATTERN].sum()) * unit, _sure(R, found, others), float(rest @ rest) / error
    )


def _sure(R: Floats, found: Floats, others: Floats) -> float:
    """Return the pattern over its standard error, by the jackknife.

    Parameters
    ----------
    found : what all parts tell
    others : [term part] Q^T of what all parts but one tell
    """
    variance, count = float(found[PATTERN].sum()), others.shape[1]
    active = found > 0.0
    if not active[PATTERN].any():
        return 0.0
    linear = np.zeros((len(found), count))
    linear[active] = np.linalg.lstsq(R[:, active], others, rcond=None)[0]

    def over(solved: Array) -> float:
        spread = float(np.sqrt((count - 1) * np.var(solved[PATTERN].sum(axis=0))))
        return variance / spread if spread > 0.0 else 0.0

    if (most := over(linear)) < SURE:  # most bursts; what is 0 may be more without a part
        return most
    return over(np.stack([nnls(R, one)[0] for one in others.T], axis=-1))


def _covariances(frames: Array, valid: Mask, power: int) -> tuple[Floats, Floats]:
    """Return sums of products [part lag frame frame], and of their weights [part lag 1 1].

    Calm pixels count more, by this power of their unrest: there is less of the scene in them.
    """
    used = valid.all(axis=0)
    level = median(frames[:, used]) if used.any() else 0.0
    y = np.where(used, frames, level).astype(np.float64) - level
    rough = y - correlate1d(correlate1d(y, SMOOTH, axis=1), SMOOTH, axis=2)
    whole = (minimum_filter(used, 3) * 1.0)[1:-1, 1:-1]
    rough = rough[:, 1:-1, 1:-1] * whole
    unrest = uniform_filter(np.mean(rough**2, axis=0), 5)
    usual = median(unrest) or float(unrest.mean())
    calm = whole / (unrest + usual) ** power if usual > 0.0 else 0.0 * whole  # frames of one value
    ends = [np.linspace(REACH_PX, n - REACH_PX, PARTS + 1).round().astype(int)
            for n in whole.shape]  # fmt: skip
    parts = [(r, c) for r in pairwise(ends[0]) for c in pairwise(ends[1])]
    count = len(frames)
    both, share = np.concatenate([rough, whole[None]]), np.concatenate([rough * calm, calm[None]])
    found = np.empty((len(parts), count + 1, len(LAGS), count + 1))
    for number, ((top, bottom), (left, right)) in enumerate(parts):
        there = np.empty((len(LAGS), count + 1, bottom - top, right - left))
        for place, (down, across) in enumerate(LAGS):
            there[place] = both[:, top + down : bottom + down, left + across : right + across]
        own = share[:, top:bottom, left:right].reshape(count + 1, -1)
        np.matmul(own, there.reshape(-1, own.shape[1]).T, out=found[number].reshape(count + 1, -1))
    found = found.swapaxes(1, 2)
    return found[..., :-1, :-1], found[..., -1:, -1:]


@lru_cache(maxsize=8)
def _design(offset_bytes: bytes, count: int) -> tuple[Array, Floats, Floats]:
    """Return which covariances are compared, and Q R of what they are made of.

    The last six columns are those of patterns and of noise: of pixels, columns and rows.
    """
    offset_px = np.frombuffer(offset_bytes).reshape(count, 2)
    moved = offset_px[None] - offset_px[:, None]
    apart = np.array(LAGS, np.float64)[:, None, None] - moved
    steps = np.arange(-round(HIGHEST / STEP), round(HIGHEST / STEP) + 1) * STEP
    waves = np.array([(v, w) for v in steps for w in steps if (v, w) >= (0.0, 0.0)])
    scene = np.cos(2 * np.pi * (apart @ waves.T))
    still = np.broadcast_to(_kernels()[:, None, None], (*apart.shape[:-1], 3))
    noise = still * np.eye(count)[None, :, :, None]
    rows = np.flatnonzero(np.all(np.abs(apart) < MOST_APART_PX, axis=-1))
    design = np.concatenate([scene, still, noise], axis=-1).reshape(-1, scene.shape[-1] + 6)[rows]
    return (rows, *np.linalg.qr(design))


def _kernels() -> Floats:
    """Return [lag kind] the covariances of r of white pixels, columns and rows of variance 1.

    Of the impulse less what is smooth, with itself: 1 - 2 h + h * h along an axis where it varies.
    """
    once = np.pad(SMOOTH, REACH_PX)
    twice = np.convolve(np.convolve(SMOOTH, SMOOTH), [0.0, 1.0, 0.0])
    impulse = (np.arange(len(once)) == len(once) // 2) * 1.0
    of_lines = impulse - 2 * once + twice
    row, col = (np.array(axis) + len(once) // 2 for axis in zip(*LAGS, strict=True))
    white = impulse[row] * impulse[col] - 2 * once[row] * once[col] + twice[row] * twice[col]
    return np.stack([white, of_lines[col], of_lines[row]], axis=-1)
