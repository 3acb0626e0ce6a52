"""Pictures of a burst by the learned solver: real ones, and phasors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Floats
from lensshift.core.order import median
from lensshift.forward.model import ForwardModel
from lensshift.reconstruction.learned.chain import TINY, Chain, Picture, Single
from lensshift.reconstruction.learned.kernels import COMPILED, Kernels
from lensshift.reconstruction.learned.network import learned_weights
from lensshift.reconstruction.learned.priors import BrightnessPrior, LearnedPrior, PhasorPrior
from lensshift.reconstruction.learned.turn import turn_of

# So that two std hold 95.45 % of the truth on mosaics of seeds that no test and no report uses
# (training/validate.py --calibrate); the likelihood alone makes std too wide, by tails.
STD_SCALE = {"brightness": 0.87, "square": 1.01}
# Larger pictures are solved in tiles, so that memory is bounded. Nothing reaches farther than the
# halo but what is far below the noise (tests/reconstruction/test_learned.py).
TILE_HR_PX, HALO_HR_PX = 640, 32

# How far real frames may be from the places of the plan for the weights of the square, LR pixels;
# training draws them so (training/bursts.py).
SQUARE_REACH_PX = 0.06

Region = tuple[slice, slice]
OnStage = Callable[[int, float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What the solver found, in the units of the frames.

    Parameters
    ----------
    image : [row col] estimate, real or complex
    std : [row col] standard deviation of its error; of phasors [3 row col]: that along the
        phasor, that across it, and the correlation of the two, which `finished` leaves out
    weight : [frame row col] 0 .. 1, how much of each LR pixel was believed in the end
    change : rms change of the picture in the last stage over the std of what it began with; inside
        this module all of these have an axis [burst] in front
    """

    image: NDArray[np.inexact[Any]]
    std: Floats
    weight: Single
    change: Any


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """A burst y = A x + n whose picture is wanted.

    Parameters
    ----------
    model : how an HR image becomes the frames; its gain and bias are 1 and 0
    y : [frame row col] real, or complex for phasors
    sigma : [frame row col] noise of each LR pixel, of each component if it has two; infinite where
        a pixel must not be used
    blur_px : standard deviation of the pixel response in LR pixels
    on_stage : called with the number of the stage and the misfit in units of the noise
    general : take the weights of all geometries, also where there are some for this one alone
    alike : believe all pixels alike, also those that contradict
    """

    model: ForwardModel
    y: NDArray[np.inexact[Any]]
    sigma: Floats
    blur_px: float
    on_stage: OnStage | None = None
    general: bool = False
    alike: bool = False

    @property
    def of_phasors(self) -> bool:
        """Whether the picture is one of phasors."""
        return self.y.dtype.kind == "c"

    @property
    def weights(self) -> str:
        """Which weights are for it."""
        if self.of_phasors:
            return "phasor"
        return "brightness" if self.general or not on_the_square(self.model) else "square"

    @property
    def geometry(self) -> tuple[Any, ...]:
        """What bursts have to share to be solved together."""
        model = self.model
        places = [taps.position_hr_px.tobytes() for taps in (model.rows, model.cols)]
        places += [of.tobytes() for of in (model.spot_px2, model.skew_px3) if of is not None]
        kinds = (self.of_phasors, self.general, self.alike, self.blur_px, model.scale, model.blur)
        return (self.y.shape, *kinds, *places)

    def unit(self) -> tuple[float, complex | float, float]:
        """Return the mean noise; by what and after what is taken off y is in units of it.

        Phasors are turned by their mean as well, and keep their level.
        """
        used = np.isfinite(self.sigma)
        unit = float(np.mean(self.sigma[used]))
        if not self.of_phasors:
            return unit, 1 / unit, median(self.y[used])
        middle = np.sum(self.y[used])
        turn = np.conj(middle) / abs(middle) if abs(middle) > 0 else 1.0
        return unit, turn / unit, 0.0


Solve = Callable[[Asked], Solution]
SolveTogether = Callable[[Sequence[Asked]], list[Solution]]


def solve(
    model: ForwardModel,
    y: NDArray[np.inexact[Any]],
    sigma: Floats,
    *,
    blur_px: float,
    general: bool = False,
    on: Kernels = COMPILED,
) -> Solution:
    """Return the picture that explains the frames y = A x + n; see `Asked`."""
    return solve_together([Asked(model, y, sigma, blur_px, general=general)], on)[0]


def solve_together(asked: Sequence[Asked], on: Kernels = COMPILED) -> list[Solution]:
    """Return the pictures of several bursts, those of one geometry found at the same time."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for number, one in enumerate(asked):
        groups.setdefault(one.geometry, []).append(number)
    found: dict[int, Solution] = {}
    for numbers in groups.values():
        found |= zip(numbers, _solved([asked[n] for n in numbers], on), strict=True)
    return [found[number] for number in range(len(asked))]


def _solved(asked: Sequence[Asked], on: Kernels) -> list[Solution]:
    """Return the solutions of bursts of one geometry."""
    first, units = asked[0], [one.unit() for one in asked]
    kind = np.complex64 if first.of_phasors else np.float32
    y = [
        np.where(np.isfinite(one.sigma), (one.y - level) * factor, 0.0).astype(kind)
        for one, (_, factor, level) in zip(asked, units, strict=True)
    ]
    sigma = [one.sigma / unit for one, (unit, _, _) in zip(asked, units, strict=True)]

    def on_stage(number: int, misfits: Any) -> None:
        for one, misfit in zip(asked, on.back(misfits), strict=True):
            if one.on_stage is not None:
                one.on_stage(number, float(misfit))

    found = _in_tiles(
        _prior(first.weights), first.model, np.stack(y), np.stack(sigma), first.blur_px,
        on_stage, on, first.alike,
    )  # fmt: skip
    scale = STD_SCALE.get(first.weights, 1.0)
    return [_in_units(found, n, scale, *unit) for n, unit in enumerate(units)]


def _in_units(
    found: Solution, n: int, scale: float, unit: float, factor: Any, level: float
) -> Solution:
    """Return the solution of burst n in the units of its frames."""
    of_phasors = found.image.dtype.kind == "c"
    std = found.std[n] * np.array([unit, unit, 1.0])[:, None, None] if of_phasors else (
        found.std[n, 0] * (scale * unit)
    )  # fmt: skip
    return Solution(
        image=found.image[n] / factor + level,
        std=std,
        weight=found.weight[n],
        change=float(found.change[n]),
    )


def on_the_square(model: ForwardModel) -> bool:
    """Tell whether four frames see a quarter of a pixel around the middle, at twice the resolution.

    That is what lenses that shift are moved for, and has weights of its own. Whole pixels more make
    no difference.
    """
    if model.scale != 2 or model.frames != 4:
        return False
    away = (model.mean_offset_px + 0.25) % 0.5
    away = np.minimum(away, 0.5 - away)
    corners = {tuple(corner) for corner in np.round(2 * (model.mean_offset_px + 0.25)) % 2}
    spread = model.shift_spread_px
    return len(corners) == 4 and bool(np.max(away) + spread <= SQUARE_REACH_PX)


@lru_cache
def _prior(weights: str) -> LearnedPrior:
    kind = PhasorPrior if weights.startswith("phasor") else BrightnessPrior
    return kind(*learned_weights(weights))


def _in_tiles(
    prior: LearnedPrior,
    model: ForwardModel,
    y: Picture,
    sigma: Floats,
    blur_px: float,
    on_stage: Callable[[int, Any], None],
    on: Kernels,
    alike: bool,
) -> Solution:
    """Return the solution of bursts in units of their noise, on their own axis."""
    used = np.isfinite(sigma)
    relative = np.where(used, sigma, 1.0).astype(np.float32)
    weight = used / np.square(relative)
    facts = facts_of(blur_px * model.scale, model.scale, y.shape[1])
    turn, shape = turn_of(model.mean_offset_px), (len(y), *model.hr_shape)
    image = np.empty(shape, np.complex128 if y.dtype.kind == "c" else np.float64)
    spread: list[Floats] = []
    believed, changes = np.empty(y.shape, np.float32), []
    for part, inner in _tiles(model.lr_shape, model.scale):
        frames = (..., *part)
        whole = all(p == slice(0, n) for p, n in zip(part, model.lr_shape, strict=True))
        operator = on.operator(model if whole else model.crop(*part))
        chain = Chain(
            operator, on.there(y[frames]), on.there(relative[frames]), on.there(weight[frames]),
            facts, model.scale, turn, on, alike,
        )  # fmt: skip
        v, s, robust, change = map(on.back, chain.run(prior, on_stage))
        rows, cols = (slice(i.start - p.start, i.stop - p.start)
                      for i, p in zip(inner, part, strict=True))  # fmt: skip
        to, of = (_times(place, model.scale) for place in (inner, (rows, cols)))
        spread = spread or [np.empty(shape) for _ in range(s.shape[1])]
        image[(..., *to)] = v[(..., *of)]
        for place, whole_picture in enumerate(spread):
            whole_picture[(..., *to)] = s[(slice(None), place, *of)]
        believed[(..., *inner)] = robust[..., rows, cols]
        changes.append(change)
    believed /= np.maximum(weight, TINY)
    most = np.max(changes, axis=0)
    return Solution(image, np.stack(spread, axis=1), believed, most)


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


def facts_of(blur_hr_px: float, scale: int, frames: int) -> NDArray[np.float32]:
    """Return what modulates the networks: blur, scale, and samples per HR pixel."""
    samples = frames / scale**2
    return np.array(
        [blur_hr_px - 0.6, scale / 2 - 1, np.log(samples) / 2, 1 / (1 + samples)], np.float32
    )
