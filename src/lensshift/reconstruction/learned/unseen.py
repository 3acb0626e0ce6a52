"""Pixels of a picture that frames hardly show: what is drawn there, and how far off that may be.

The prior goes on into a gap for a pixel or two; beyond, it knows nothing, and says too little of
its error. There the picture is that of the nearest pixel that was seen, and the scene itself tells
how much pixels so far apart differ.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.types import Estimate
from lensshift.core.units import within_half_a_turn
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.learned.chain import LEAST_DENSITY
from lensshift.reconstruction.problem import Problem

# Of what would see a pixel without gaps: from here on the errors of the solver hold (measured).
LEAST_SEEN = 0.5
_NOTHING = 1e-9  # of the taps of a frame: rounding
_TINY = 1e-12


def share_seen(A: LinearOperator, used: Mask) -> Floats:
    """Return the share [row col] of what would see an HR pixel that is used.

    Parameters
    ----------
    used : [frame row col]
    """
    if used.all():
        return np.ones(A.in_shape)
    seen, whole = (A.adjoint(one.astype(np.float32)) for one in (used, np.ones_like(used)))
    return np.where(whole > _NOTHING, seen / np.maximum(whole, _NOTHING), 1.0)


def with_gaps(problem: Problem, found: Estimate, std: Floats) -> tuple[Estimate, Floats]:
    """Return an estimate and its std as `beside_gaps`, which `notes` tell the share of."""
    share = share_seen(problem.model.operator, problem.weight > 0)
    if not (unseen := float(np.mean(share < LEAST_SEEN))):
        return found, std
    image, std = beside_gaps(found.image, std, share)
    return replace(found, image=image, notes=dict(found.notes) | {"unseen": unseen}), std


def beside_gaps(image: Array, std: Floats, share: Floats) -> tuple[Array, Floats]:
    """Return a picture and its std, of the nearest pixel that was seen where none was.

        std^2 = std_n^2 + max_(h <= r) D(h),   D(h) = mean |x(p) - x(p + h)|^2

    n the nearest pixel of which half was seen, r the distance to it, p and p + h such pixels, along
    rows and columns. The picture stays where frames count more than nothing does in the chain.

    Parameters
    ----------
    image : [row col], real or complex
    std : [row col]; of phasors [2 row col], along and across them
    share : [row col] of `share_seen`
    """
    unseen = share < LEAST_SEEN
    if unseen.all() or not unseen.any():
        return image, std
    away_px, nearest = distance_transform_edt(unseen, return_indices=True)
    at = tuple(nearest)
    filled = np.where(share < LEAST_DENSITY, image[at], image)
    if image.dtype.kind != "c":
        differ = _differences(image, unseen, away_px)
        return filled, np.where(unseen, np.hypot(std[at], differ), std)
    size = np.maximum(np.abs(filled), _TINY)
    along, across = std[0][at], std[1][at]
    of_size = _differences(np.abs(image), unseen, away_px)
    of_phase = size * _differences(np.angle(image), unseen, away_px, phase=True)
    wider = np.stack([np.hypot(along, of_size), np.hypot(across, of_phase)])
    return filled, np.where(unseen, wider, std)


def _differences(
    values: Array, unseen: Mask, away_px: Floats, *, phase: bool = False
) -> NDArray[np.float64]:
    """Return [row col] the rms difference of seen pixels that are as far apart as told."""
    farthest = min(int(np.ceil(away_px.max())), max(values.shape) - 1)
    square = np.zeros(farthest + 1)
    for lag in range(1, farthest + 1):
        total = count = 0.0
        for axis in (0, 1):
            x, seen = np.moveaxis(values, axis, 0), np.moveaxis(~unseen, axis, 0)
            both = seen[lag:] & seen[:-lag]
            apart = (x[lag:] - x[:-lag])[both]
            apart = within_half_a_turn(apart) if phase else apart
            total, count = total + float(np.sum(apart**2)), count + apart.size
        square[lag] = total / count if count else 0.0
    grown = np.sqrt(np.maximum.accumulate(square))
    return np.asarray(np.interp(away_px, np.arange(farthest + 1), grown))
