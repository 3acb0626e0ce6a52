"""Light that drifts or flickers between frames: how much brighter one is than the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import shift

from lensshift.core.arrays import Array, Floats, Shifts
from lensshift.core.errors import warn_quality

_SIDE_PX, _MOST, _LEAST = 4, 8, 8  # blocks: least side, most along an axis, least in all
_DARK = 0.2  # of the light of most blocks: below, a ratio is noise
_ROUNDING = 1e-9
_SURE = 3.0  # how far gains are off on average, in standard errors of each
_OF_NORMAL, _OF_MEDIAN = 1.4826, 1.2533  # sigma over a median deviation; error of a median over it


def light_allowed_for(
    frames: Array, offset_px: Shifts, asked: bool | None, names: Sequence[int] | Array
) -> tuple[Floats, bool]:
    """Return gains [frame 1 1] to divide frames by, and whether each may have its own light.

    Warns of gains that nobody asked for (None), unlike those that are asked for (True).
    """
    gain = None if asked is False else gains_of_light(frames, offset_px)
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
    return (
        f"the light of the frames differs: that of frame {names[bright]} is "
        f"{100 * (gain[bright] / gain[dark] - 1):.1f} % more than that of frame {names[dark]}"
    )


def gains_of_light(frames: Array, offset_px: Shifts) -> Floats | None:
    """Return how bright frames are over most of them [frame]; None if they may all be alike.

        gain_k = median over blocks b of  mean_b(frame k) / median_j mean_b(frame j)

    Light changes all blocks alike; what moves, and shifts that are not quite right, change few, or
    some up and others down, which is in the error of the median.

    Parameters
    ----------
    frames : [frame row col]; complex ones by their modulus
    offset_px : [frame 2] roughly, as from `phase_shifts`
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
    total = np.add.reduceat(still[:, : rows[-1], : cols[-1]], rows[:-1], axis=1)
    total = np.add.reduceat(total, cols[:-1], axis=2)
    mean = (total / np.outer(np.diff(rows), np.diff(cols))).reshape(len(frames), -1)
    usual = np.median(mean, axis=0)
    lit = usual > _DARK * np.median(usual)
    ratio = mean[:, lit] / usual[lit]
    if ratio.shape[1] < _LEAST:
        return None
    gain = np.median(ratio, axis=1)
    spread = _OF_NORMAL * np.median(np.abs(ratio - gain[:, None]), axis=1)
    error = _OF_MEDIAN * spread / ratio.shape[1] ** 0.5
    off = np.mean(((gain - 1.0) / np.maximum(error, _ROUNDING)) ** 2) ** 0.5
    return np.asarray(gain) if off > _SURE else None


def _edges(size: int, margin: int) -> list[int]:
    """Return the borders of blocks along an axis, without its margins where there is room."""
    margin = margin if size > 2 * margin + _SIDE_PX else 0
    count = min(max((size - 2 * margin) // _SIDE_PX, 1), _MOST)
    return [int(n) for n in np.linspace(margin, size - margin, count + 1)]
