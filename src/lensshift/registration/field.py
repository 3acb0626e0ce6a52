"""How the shift varies over the sensor, from every pixel of every frame of a scan."""

from __future__ import annotations

import numpy as np

from lensshift.core.arrays import Floats, Mask
from lensshift.core.gaussian import MAD_TO_SIGMA
from lensshift.core.types import Burst
from lensshift.registration.reference_image import reference_image
from lensshift.registration.taper import taper_frames

MAX_ORDER = 2  # of the polynomial over the sensor
_PASSES = 3  # of leaving outliers out
_BORDER_PX = 1  # where the slope is one-sided
_OUTLIER_SIGMAS = 4.0  # one in 16 000 by chance
# By how much of itself (rms) the map of a lens differs over the sensor where nobody knows. Of the
# paper's optic a moved first lens differs by 6 % at the worst corner (`lensshift lens which
# petzval_a`), a moved sensor not at all.
USUAL_SHARE = 0.01


def fit_field(
    burst: Burst, offset_px: Floats, away_mm: Floats, known_px: Floats | float = 0.0
) -> tuple[Floats | None, int, Floats, Floats]:
    """Return how the map differs at every pixel [row col 2 2], its order, and what textures add.

    None and 0 where the map is the same everywhere.

        y_k(u) - s(u - d_k) = - grad s . dM(u) away_k,   dM(u) = polynomial in (row, col)

    A spline through all frames is the model s; the coefficients of the polynomial are fitted to
    what it leaves, together with a shift of each frame, and the spline again without them. dM is
    0 on the mean over the sensor. An order is kept if every other frame finds the same: better
    to know it than to leave it out. The shift of a whole frame is that of its texture, which
    differs by [frame 2] px from that of the sensor. The last is the covariance [2 frame, 2 frame]
    of that: what was not found may still be there, as large as lenses usually have it.

    Parameters
    ----------
    offset_px : [frame 2] of the whole frame, from the linear model
    away_mm : [frame 2] where the stage really was, against rest
    known_px : [axis frame row col] what is known of how each pixel shifts further
    """
    frames = np.abs(burst.amplitude) if np.iscomplexobj(burst.amplitude) else burst.amplitude
    frames = np.where(burst.valid, frames, 0.0).astype(np.float64)
    weight = burst.valid.astype(np.float64)
    known_px = np.broadcast_to(known_px, (2, *frames.shape))
    best: Floats | None = None
    order, slip_px = 0, known_px
    for trial in range(1, MAX_ORDER + 1):
        basis = _basis(burst.grid.shape, trial)
        halves = [
            _coefficients(
                frames[part], weight[part], offset_px[part], away_mm[part], basis, known_px[:, part]
            )
            for part in (slice(0, None, 2), slice(1, None, 2))
        ]
        first, second = (np.einsum("bij,brc->rcij", half, basis) for half in halves)
        # The mean of two independent findings is nearer to the truth than nothing: their product is
        # the square of what is true, a quarter of the squared difference that of the mean's error.
        if np.mean(first * second) > 0.25 * np.mean((first - second) ** 2):
            found = _coefficients(frames, weight, offset_px, away_mm, basis, known_px)
            best, order = np.einsum("bij,brc->rcij", found, basis), trial
    if best is not None:
        slip_px = known_px + np.einsum("rcij,fj->ifrc", best, away_mm)
    slope = reference_image(frames, weight, offset_px, slip_px).slope
    seen = weight * taper_frames(frames, offset_px, own_mean=False).window ** 2
    doubt_px2 = _doubt(slope, seen, offset_px, _basis(burst.grid.shape, MAX_ORDER))
    return best, order, _of_texture(slope, seen, slip_px), doubt_px2


def _of_texture(slope: Floats, weight: Floats, slip_px: Floats) -> Floats:
    """Return the shift [frame 2] that tapered frames show where each pixel slips by its own."""
    moves = np.einsum("ifrc,jfrc,frc->fij", slope, slope, weight)
    asked = np.einsum("ifrc,jfrc,jfrc,frc->fi", slope, slope, slip_px, weight)
    return np.asarray(np.linalg.solve(moves, asked[..., None])[..., 0])


def _doubt(slope: Floats, weight: Floats, offset_px: Floats, basis: Floats) -> Floats:
    """Return the covariance of what texture adds, for a field of usual size and any shape."""
    size = USUAL_SHARE / np.sqrt(np.sum(basis.var(axis=(1, 2))))
    adds_px = [
        size * _of_texture(slope, weight, offset_px[:, axis, None, None] * along * term)
        for term in basis
        for along in np.eye(2)[..., None, None, None]
        for axis in (0, 1)
    ]
    whole = np.reshape(adds_px, (len(adds_px), -1))
    return np.asarray(whole.T @ whole)


def _basis(shape: tuple[int, int], order: int) -> Floats:
    """Return polynomials [term row col] up to an order, without the constant, of zero mean."""
    row, col = np.meshgrid(*(np.linspace(-1, 1, size) for size in shape), indexing="ij")
    terms = [row, col]
    if order > 1:
        terms += [row**2, row * col, col**2]
    return np.stack([term - term.mean() for term in terms])


def _coefficients(
    frames: Floats,
    weight: Floats,
    offset_px: Floats,
    away_mm: Floats,
    basis: Floats,
    known_px: Floats,
) -> Floats:
    """Return dM [term 2 2]."""
    found = np.zeros((len(basis), 2, 2))
    moved_px = offset_px
    used = weight.copy()
    used[:, :_BORDER_PX] = used[:, -_BORDER_PX:] = 0.0
    used[:, :, :_BORDER_PX] = used[:, :, -_BORDER_PX:] = 0.0
    for _ in range(_PASSES):
        slip_px = known_px + np.einsum("bij,brc,fj->ifrc", found, basis, away_mm)
        reference = reference_image(frames, weight, moved_px, slip_px)
        rest = frames - reference.seen
        here = used > 0
        spread = MAD_TO_SIGMA * float(np.median(np.abs(rest[here])))
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
    return found


def _free_shifts(slope: Floats, here: Mask) -> list[tuple[slice, Floats, Floats]]:
    """Return for each frame its pixels, what a shift does to them [pixel 2], and the inverse."""
    edges = np.concatenate([[0], np.cumsum(here.sum(axis=(1, 2)))])
    shifts = []
    for k in range(len(here)):
        moves = slope[:, k][:, here[k]].T
        solved = np.linalg.pinv(moves.T @ moves) @ moves.T
        shifts.append((slice(int(edges[k]), int(edges[k + 1])), moves, solved))
    return shifts


def _without_shifts(
    design: Floats, rest: Floats, shifts: list[tuple[slice, Floats, Floats]]
) -> tuple[Floats, Floats]:
    """Return normal matrix and right side with a free shift of each frame projected out."""
    normal, target = design.T @ design, design.T @ rest
    for part, moves, solved in shifts:
        crossed = design[part].T @ moves
        normal -= crossed @ (solved @ design[part])
        target -= crossed @ (solved @ rest[part])
    return normal, target
