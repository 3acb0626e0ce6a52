"""How the shift varies over the sensor, from every pixel of every frame of a scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lensshift.core.types import Burst
from lensshift.registration.reference_image import reference_image

Array = NDArray[np.float64]

MAX_ORDER = 2
_PASSES = 3
_BORDER_PX = 1
# An order is kept if it improves the fit by so many standard errors squared per parameter.
_SIGNIFICANT = 4.0
_OUTLIER_SIGMAS = 4.0


def fit_field(
    burst: Burst, offset_px: Array, away_mm: Array, known_px: Array | float = 0.0
) -> tuple[Array | None, int, Array]:
    """Return how the map differs at every pixel [row col 2 2], its order, and better offsets.

    None and 0 where the map is the same everywhere; the offsets then are those given.

        y_k(u) - s(u - d_k) = - grad s . dM(u) away_k,   dM(u) = polynomial in (row, col)

    A spline through all frames is the model s; the coefficients of the polynomial are fitted to
    what it leaves, together with a shift of each frame, and the spline again without them. dM
    is 0 on the mean over the sensor, and the offsets are what is left for the mean: where
    texture is, the shift of a whole frame may be another one.

    Parameters
    ----------
    offset_px : [frame 2] of the whole frame, from the linear model
    away_mm : [frame 2] where the stage really was, against rest
    known_px : [axis frame row col] what is known of how each pixel shifts further
    """
    frames = np.real(
        np.abs(burst.amplitude) if np.iscomplexobj(burst.amplitude) else burst.amplitude
    )
    frames = frames.astype(np.float64)
    weight = np.ones(frames.shape) if burst.valid is None else burst.valid.astype(np.float64)
    frames = np.where(weight > 0, frames, 0.0)
    best: Array | None = None
    order, better_px = 0, offset_px
    for trial in range(1, MAX_ORDER + 1):
        basis = _basis(burst.grid.shape, trial)
        found, gain, moved_px = _coefficients(frames, weight, offset_px, away_mm, basis, known_px)
        if trial == 1 and np.any(known_px):
            better_px = moved_px  # of the middle, not of where the texture is
        if gain > _SIGNIFICANT * found.size:
            best, order = np.einsum("bij,brc->rcij", found, basis), trial
            better_px = moved_px
    return best, order, better_px


def _basis(shape: tuple[int, int], order: int) -> Array:
    """Return polynomials [term row col] up to an order, without the constant, of zero mean."""
    row, col = np.meshgrid(*(np.linspace(-1, 1, size) for size in shape), indexing="ij")
    terms = [row, col]
    if order > 1:
        terms += [row**2, row * col, col**2]
    return np.stack([term - term.mean() for term in terms])


def _coefficients(
    frames: Array,
    weight: Array,
    offset_px: Array,
    away_mm: Array,
    basis: Array,
    known_px: Array | float,
) -> tuple[Array, float, Array]:
    """Return dM [term 2 2], by how many squared errors it differs from 0, offsets [frame 2]."""
    found = np.zeros((len(basis), 2, 2))
    gain, moved_px = 0.0, offset_px
    used = weight.copy()
    used[:, :_BORDER_PX] = used[:, -_BORDER_PX:] = 0.0
    used[:, :, :_BORDER_PX] = used[:, :, -_BORDER_PX:] = 0.0
    for _ in range(_PASSES):
        slip_px = known_px + np.einsum("bij,brc,fj->ifrc", found, basis, away_mm)
        reference = reference_image(frames, weight, moved_px, slip_px)
        rest = frames - reference.seen
        here = used > 0
        spread = 1.4826 * float(np.median(np.abs(rest[here])))
        here &= np.abs(rest) <= _OUTLIER_SIGMAS * max(spread, 1e-12)
        columns = [
            -(reference.slope[i] * away_mm[:, j, None, None] * term)[here]
            for term in basis
            for i in (0, 1)
            for j in (0, 1)
        ]
        design = np.stack(columns, axis=-1)
        # The whole frames were registered: their shifts are free as well.
        shifts = _free_shifts(reference.slope, here)
        normal, target = _without_shifts(design, rest[here], shifts)
        step = np.linalg.lstsq(normal, target, rcond=1e-10)[0]
        found = found + step.reshape(found.shape)
        left = rest[here] - design @ step
        moved_px = moved_px - np.stack([solved @ left[part] for part, _, solved in shifts])
        variance = float(np.mean(rest[here] ** 2))
        flat = found.ravel()
        gain = float(flat @ normal @ flat) / max(variance, 1e-300)
    return found, gain, moved_px


def _free_shifts(slope: Array, here: NDArray[np.bool_]) -> list[tuple[slice, Array, Array]]:
    """Return for each frame its pixels, what a shift does to them [pixel 2], and the inverse."""
    edges = np.concatenate([[0], np.cumsum(here.sum(axis=(1, 2)))])
    shifts = []
    for k in range(len(here)):
        moves = slope[:, k][:, here[k]].T
        solved = np.linalg.pinv(moves.T @ moves) @ moves.T
        shifts.append((slice(int(edges[k]), int(edges[k + 1])), moves, solved))
    return shifts


def _without_shifts(
    design: Array, rest: Array, shifts: list[tuple[slice, Array, Array]]
) -> tuple[Array, Array]:
    """Return normal matrix and right side with a free shift of each frame projected out."""
    normal, target = design.T @ design, design.T @ rest
    for part, moves, solved in shifts:
        crossed = design[part].T @ moves
        normal -= crossed @ (solved @ design[part])
        target -= crossed @ (solved @ rest[part])
    return normal, target
