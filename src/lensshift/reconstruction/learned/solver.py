"""Pictures of a burst by the learned solver: real ones, and phasors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.forward.model import ForwardModel
from lensshift.reconstruction.learned.chain import (
    TINY,
    Chain,
    Held,
    LearnedPrior,
    Picture,
    Single,
)
from lensshift.reconstruction.learned.network import learned_weights
from lensshift.reconstruction.learned.priors import BrightnessPrior, PhasorPrior
from lensshift.reconstruction.learned.turn import turn_of

# So that two std hold 95.45 % of the truth on mosaics of seeds that no test and no report uses
# (training/validate.py --calibrate); the likelihood alone makes std too wide, by tails.
STD_SCALE = 0.86
# Larger pictures are solved in tiles, so that memory is bounded. Nothing reaches farther than the
# halo but what is far below the noise (tests/reconstruction/test_learned.py).
TILE_HR_PX, HALO_HR_PX = 640, 32

Region = tuple[slice, slice]
OnStage = Callable[[int, float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What the solver found, in the units of the frames.

    Parameters
    ----------
    image : [row col] estimate, real or complex
    std : [row col] standard deviation of its error; of phasors [3 row col]: that along the
        phasor, that across it, and the correlation of the two
    weight : [frame row col] 0 .. 1, how much of each LR pixel was believed in the end
    change : rms change of the picture in the last stage over the std of what it began with
    held : of each tile, what another burst of the same shifts and scene can begin with
    """

    image: NDArray[np.inexact[Any]]
    std: NDArray[np.float64]
    weight: Single
    change: float
    held: tuple[Held, ...] = ()


def solve(
    model: ForwardModel,
    y: NDArray[np.float64],
    sigma: NDArray[np.float64],
    *,
    blur_px: float,
    on_stage: OnStage | None = None,
    held: tuple[Held, ...] | None = None,
) -> Solution:
    """Return the picture that explains the frames y = A x + n.

    Parameters
    ----------
    model : how an HR image becomes the frames; its gain and bias are 1 and 0
    y : [frame row col] real
    sigma : [frame row col] noise of each LR pixel; infinite where a pixel must not be used
    blur_px : standard deviation of the pixel response in LR pixels
    on_stage : called with the number of the stage and the misfit in units of the noise
    held : of an earlier solution, in the units of y: only the last stage is done
    """
    used = np.isfinite(sigma)
    unit, level = float(np.mean(sigma[used])), float(np.median(y[used]))
    known = np.where(used, (y - level) / unit, 0.0).astype(np.float32)
    start = held and tuple(one.moved(1 / unit, -level / unit, np.float32) for one in held)
    found = _in_tiles(_brightness_prior(), model, known, sigma / unit, blur_px, on_stage, start)
    return Solution(
        image=found.image * unit + level,
        std=found.std[0] * (STD_SCALE * unit),
        weight=found.weight,
        change=found.change,
        held=tuple(one.moved(unit, level, np.float64) for one in found.held),
    )


def solve_phasor(
    model: ForwardModel,
    y: NDArray[np.complex128],
    sigma: NDArray[np.float64],
    *,
    blur_px: float,
    on_stage: OnStage | None = None,
    held: tuple[Held, ...] | None = None,
) -> Solution:
    """Return the phasors that explain the frames; see `solve`.

    Parameters
    ----------
    y : [frame row col] complex
    sigma : [frame row col] noise of each component of each LR pixel
    """
    used = np.isfinite(sigma)
    unit, middle = float(np.mean(sigma[used])), np.sum(y[used])
    turn = np.conj(middle) / abs(middle) if abs(middle) > 0 else 1.0
    known = np.where(used, y * (turn / unit), 0.0).astype(np.complex64)
    start = held and tuple(one.moved(turn / unit, 0.0, np.complex64) for one in held)
    found = _in_tiles(_phasor_prior(), model, known, sigma / unit, blur_px, on_stage, start)
    scale = np.array([unit, unit, 1.0])
    return Solution(
        image=found.image * (unit * np.conj(turn)),
        std=found.std * scale[:, None, None],
        weight=found.weight,
        change=found.change,
        held=tuple(one.moved(unit * np.conj(turn), 0.0, np.complex128) for one in found.held),
    )


@lru_cache(maxsize=1)
def _brightness_prior() -> BrightnessPrior:
    return BrightnessPrior(*learned_weights("brightness"))


@lru_cache(maxsize=1)
def _phasor_prior() -> PhasorPrior:
    return PhasorPrior(*learned_weights("phasor"))


def _in_tiles(
    prior: LearnedPrior,
    model: ForwardModel,
    y: Picture,
    sigma: NDArray[np.float64],
    blur_px: float,
    on_stage: OnStage | None,
    held: tuple[Held, ...] | None,
) -> Solution:
    """Return the solution of a burst in units of its noise."""
    used = np.isfinite(sigma)
    relative = np.where(used, sigma, 1.0).astype(np.float32)
    weight = np.where(used, relative**-2, 0).astype(np.float32)
    facts, turn = _facts(blur_px * model.scale, model.scale, len(y)), turn_of(model.mean_offset_px)
    image = np.empty(model.hr_shape, np.complex128 if y.dtype.kind == "c" else np.float64)
    spread: list[NDArray[np.float64]] = []
    believed, changes, kept = np.empty(y.shape, np.float32), [], []
    for number, (part, inner) in enumerate(_tiles(model.lr_shape, model.scale)):
        frames = (slice(None), *part)
        whole = all(p == slice(0, n) for p, n in zip(part, model.lr_shape, strict=True))
        operator = (model if whole else model.crop(*part)).operator
        chain = Chain(
            operator, y[frames], relative[frames], weight[frames], facts, model.scale, turn
        )
        start = None if held is None else held[number]
        v, s, robust, change, half_done = chain.run(prior, on_stage, start)
        kept.append(half_done)
        rows, cols = (slice(i.start - p.start, i.stop - p.start)
                      for i, p in zip(inner, part, strict=True))  # fmt: skip
        to, of = (_times(place, model.scale) for place in (inner, (rows, cols)))
        spread = spread or [np.empty(model.hr_shape) for _ in s]
        image[to] = v[of]
        for whole_picture, tile in zip(spread, s, strict=True):
            whole_picture[to] = tile[of]
        believed[(slice(None), *inner)] = robust[:, rows, cols]
        changes.append(change)
    believed /= np.maximum(weight, TINY)
    return Solution(image, np.stack(spread), believed, max(changes), tuple(kept))


def _tiles(lr_shape: tuple[int, int], scale: int) -> list[tuple[Region, Region]]:
    """Return the parts of a large burst with their halo, and what each is to fill, in LR pixels."""
    tile, halo = TILE_HR_PX // scale, -(-HALO_HR_PX // scale)
    lines: list[list[tuple[slice, slice]]] = []
    for size in lr_shape:
        count = 1 if size <= tile + 2 * halo else -(-size // tile)
        ends = [size * n // count for n in range(count + 1)]
        lines.append([
            (slice(max(a - halo, 0), min(b + halo, size)), slice(a, b))
            for a, b in pairwise(ends)
        ])  # fmt: skip
    return [((r[0], c[0]), (r[1], c[1])) for r in lines[0] for c in lines[1]]


def _times(region: Region, scale: int) -> Region:
    rows, cols = (slice(part.start * scale, part.stop * scale) for part in region)
    return rows, cols


def _facts(blur_hr_px: float, scale: int, frames: int) -> Single:
    samples = frames / scale**2
    return np.array(
        [blur_hr_px - 0.6, scale / 2 - 1, np.log(samples) / 2, 1 / (1 + samples)], np.float32
    )
