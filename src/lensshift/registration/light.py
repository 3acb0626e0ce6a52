"""Light that drifts or flickers between frames: how much brighter one is than the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import shift

from lensshift.core.arrays import Array, Floats, Shifts
from lensshift.core.errors import warn_quality
from lensshift.core.gaussian import MAD_TO_SIGMA, MEDIAN_ERROR
from lensshift.registration.likelihood import USUAL_SHIFT_PX
from lensshift.registration.robust_fit import HUBER_SIGMAS

_SIDE_PX, _MOST, _LEAST = 4, 8, 8  # blocks: least side, most along an axis, least in all
_DARK = 0.2  # of the light of most blocks: below, a ratio is noise
_ROUNDING = 1e-9
_PASSES = 8  # of reweighting
_SURE = 3.0  # how far gains are off on average, in standard errors of each


def light_allowed_for(
    frames: Array, offset_px: Shifts, asked: bool | None, names: Sequence[int] | Array
) -> tuple[Floats, bool]:
    """Return gains [frame 1 1] to divide frames by, and whether each may have its own light.

    Of frames whose shifts are still to be found. Warns of gains that nobody asked for (None),
    unlike those that are asked for (True).
    """
    gain = None if asked is False else gains_of_light(frames, offset_px, USUAL_SHIFT_PX)
    if gain is None:
        return np.ones((len(frames), 1, 1)), bool(asked)
    if asked is None:
        warn_quality(
            f"{light_said(gain, names)}. Allowed for by a factor and a constant of each frame; "
            "photometric=False (--no-photometric) would not",
            4,
        )
    return gain[:, None, None], True


def light_said(gain: Floats | None, names: Sequence[int] | Array | None = None) -> str:
    """Say which frames differ most in light, "" if none does (None)."""
    if gain is None:
        return ""
    names = range(len(gain)) if names is None else names
    dark, bright = (int(pick(gain)) for pick in (np.argmin, np.argmax))
    percent = 100 * (gain[bright] / gain[dark] - 1)
    return (
        f"the light of the frames differs: that of frame {names[bright]} is "
        f"{percent:{'.1f' if percent >= 0.1 else '.1g'}} % more than that of frame {names[dark]}"
    )


def gains_of_light(
    frames: Array, offset_px: Shifts, sigma_px: float | Shifts = 0.0
) -> Floats | None:
    """Return how bright frames are over most of them [frame]; None if they may all be alike.

        mean_b(frame k) / median_j mean_b(frame j) = gain_k + slope_b . e_k + rest,  blocks b

    Light changes all blocks alike; what moves changes few. A shift that is off by e_k changes some
    up and others down, or all alike where the scene is one slope: there it may be either.

    Parameters
    ----------
    frames : [frame row col]; complex ones by their modulus
    offset_px : [frame 2] roughly, as from `phase_shifts`
    sigma_px : by how much they may be off, [frame 2] or for all
    """
    light = np.abs(frames)
    apart_px = offset_px - offset_px.mean(axis=0)
    still = np.stack([
        shift(one, -moved, order=1, mode="nearest")
        for one, moved in zip(light, apart_px, strict=True)
    ])  # fmt: skip
    rows, cols = (
        _edges(size, int(np.ceil(most)))
        for size, most in zip(light.shape[1:], np.abs(apart_px).max(axis=0), strict=True)
    )
    mean = _means(still, rows, cols)
    usual = np.median(mean, axis=0)
    lit = usual > _DARK * np.median(usual)
    ratio = mean[:, lit] / usual[lit]
    if ratio.shape[1] < _LEAST:
        return None
    slopes = _means(np.stack(np.gradient(still.mean(axis=0))), rows, cols)[:, lit] / usual[lit]
    known_px = np.broadcast_to(sigma_px, offset_px.shape)
    found = [_gain(one, slopes.T, known) for one, known in zip(ratio, known_px, strict=True)]
    gain, error = np.array(found).T
    off = np.mean(((gain - 1.0) / np.maximum(error, _ROUNDING)) ** 2) ** 0.5
    return np.asarray(gain) if off > _SURE else None


def _gain(ratio: Floats, slopes: Floats, sigma_px: Floats) -> tuple[float, float]:
    """Return the median of ratios [block] beside what a shift explains, and its standard error."""
    design = np.column_stack([np.ones(len(ratio)), slopes * sigma_px])  # e in units of sigma
    rest = ratio - np.median(ratio)
    for _ in range(_PASSES):
        spread = max(MAD_TO_SIGMA * float(np.median(np.abs(rest))), _ROUNDING)
        weight = np.minimum(1.0, HUBER_SIGMAS * spread / np.maximum(np.abs(rest), _ROUNDING))
        normal = (weight[:, None] * design).T @ design + spread**2 * np.diag([0.0, 1.0, 1.0])
        found = np.linalg.solve(normal, design.T @ (weight * ratio))
        beside = ratio - design[:, 1:] @ found[1:]
        rest = beside - np.median(beside)
    error = MEDIAN_ERROR * spread * float(np.linalg.inv(normal)[0, 0]) ** 0.5
    return float(np.median(beside)), error


def _means(values: Array, rows: list[int], cols: list[int]) -> Array:
    """Return the means of blocks [image block]."""
    total = np.add.reduceat(values[:, : rows[-1], : cols[-1]], rows[:-1], axis=1)
    total = np.add.reduceat(total, cols[:-1], axis=2)
    return np.asarray((total / np.outer(np.diff(rows), np.diff(cols))).reshape(len(values), -1))


def _edges(size: int, margin: int) -> list[int]:
    """Return the borders of blocks along an axis, without its margins where there is room."""
    margin = margin if size > 2 * margin + _SIDE_PX else 0
    count = min(max((size - 2 * margin) // _SIDE_PX, 1), _MOST)
    return [int(n) for n in np.linspace(margin, size - margin, count + 1)]
