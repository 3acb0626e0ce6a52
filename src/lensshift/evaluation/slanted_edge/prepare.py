"""From frames to samples: find the edge, turn it upright, scale it, learn the noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Mask
from lensshift.evaluation.slanted_edge import noise_model
from lensshift.evaluation.slanted_edge.bending import FreeResponse, bend_edge
from lensshift.evaluation.slanted_edge.edge_model import Matrix, SplineBasis, Vector, core_slopes
from lensshift.evaluation.slanted_edge.gathering import (
    EdgeSamples,
    distance_px,
    nodes_for,
    splines_for,
)
from lensshift.evaluation.slanted_edge.geometry import EdgeLine, find_edge
from lensshift.evaluation.slanted_edge.noise_model import NoiseModel
from lensshift.evaluation.slanted_edge.result import Region

_FEWEST_PIXELS = 64
_SHARED = 0.1  # of the variance: less is not worth a weight
# In units of the edge's own width:
_HALF_WIDTH, _NEAR_WIDTH = 6.0, 3.5  # where plateaus begin, to a first look; where at least
_LARGEST_REACH = 32.0  # of the splines: a ghost farther away is taken for part of the plateau
_SLOPES = 9.0  # squared deviations: three
_MOST_TAKEN = 0.5  # of the noise, by a free ESF: where it takes more, pixels are too few to say


@dataclass(frozen=True, slots=True)
class Pixels:
    """The valid pixels of a region in all frames."""

    places: NDArray[np.intp]  # [n 3] frame, row, column within the region
    row_px: Vector  # [n] where each looks at the reference frame, from the region's centre
    col_px: Vector
    values: Vector  # [n]

    def without(self, out: Mask) -> Pixels:
        """Return the pixels but those out [n]."""
        kept = ~out
        return Pixels(self.places[kept], self.row_px[kept], self.col_px[kept], self.values[kept])


@dataclass(frozen=True)
class UprightEdge:
    """A region turned so that its edge runs along the second axis, bright at positive x."""

    pixels: Pixels  # the region
    line: EdgeLine  # the first guess, in the region's own axes
    vertical: bool  # whether the edge is nearer to the columns than to the rows
    start_angle_rad: float  # of the first guess, which is the origin of `across_px`
    sign: float  # +1 if columns (rows) count towards the bright side, else -1
    # angle of the edge against the columns (rows) in the turned axes, position, bends
    geometry: Vector
    across_px: Vector  # [n] turned coordinates, from the middle of the edge
    along_px: Vector
    scaled: Vector  # [n] pixels, dark plateau 0 and bright plateau 1
    unit_px: float  # width by which spline and prior are scaled, at least 1

    @cached_property
    def half_length_px(self) -> float:
        """Half the extent of the region along the edge."""
        return max(float(np.max(np.abs(self.along_px))), 1.0)

    @cached_property
    def normal_px(self) -> Vector:
        """Signed distance of every pixel from the first guess."""
        return distance_px(self.across_px, self.along_px, self.geometry, self.half_length_px)

    @cached_property
    def rounding(self) -> noise_model.Rounding:
        """How the pixels are rounded."""
        return noise_model.rounding_of(self.scaled, self.free_response.of(self.scaled)[0])

    @cached_property
    def basis(self) -> SplineBasis:
        """Splines that suit the width of the edge and reach as far as the region."""
        reach_px = float(np.max(np.abs(self.normal_px)))
        units = np.clip(reach_px / self.unit_px, _HALF_WIDTH, _LARGEST_REACH)
        return splines_for(float(units), self.unit_px)

    @cached_property
    def free_response(self) -> FreeResponse:
        """What tells ESF and LSF from the pixels alone."""
        return self.response_without(None)

    def without(self, out: Mask) -> UprightEdge:
        """Return the edge of the pixels but those out [n]."""
        kept = {name: getattr(self, name)[~out] for name in ("across_px", "along_px", "scaled")}
        return replace(self, pixels=self.pixels.without(out), **kept)

    def response_without(self, out: Mask | None) -> FreeResponse:
        """Return `free_response` as the pixels but those out [n] tell it."""
        normal_px, used = self.normal_px, None if out is None else ~out
        nodes = nodes_for(self.basis, self.unit_px, 1.0, float(np.max(np.abs(normal_px))))
        return FreeResponse(normal_px, self.basis, nodes, used)

    def plateaus(self) -> list[Mask]:
        """Return the masks of the dark and the bright plateau."""
        sides = self._sides(_HALF_WIDTH + 1.0)
        if min(int(side.sum()) for side in sides) >= 40:
            return sides
        return self._sides(_NEAR_WIDTH)  # a narrow region: nearer to the edge

    def slopes_across(self) -> bool:
        """Tell whether the plateaus seem to slope, under uneven light or by a wide response."""
        for side in self._sides(_NEAR_WIDTH):
            if not side.any():
                continue
            place_px, values = (x[side] - x[side].mean() for x in (self.normal_px, self.scaled))
            squares = float(place_px @ place_px)
            slope = float(place_px @ values) / squares if squares > 0.0 else 0.0
            rest = values - slope * place_px
            noise = max(float(np.mean(rest**2)), noise_model.NOISELESS**2)
            if slope**2 * squares > _SLOPES * noise:
                return True
        return False

    def _sides(self, units: float) -> list[Mask]:
        """Return the masks of the pixels farther from the edge, dark and bright."""
        away_px = units * self.unit_px
        return [self.normal_px < -away_px, self.normal_px > away_px]


def turn_upright(
    pixels: Pixels, aperture_px: float, most_bends: int, out: Mask | None = None
) -> UprightEdge:
    """Find the edge of a region, but for pixels `out` [n], turned upright; or a `ValueError`."""
    told = np.ones(pixels.values.size, dtype=bool) if out is None else ~out
    line = find_edge(pixels.col_px[told], pixels.row_px[told], pixels.values[told], aperture_px)
    cosine, sine = np.cos(line.angle_rad), np.sin(line.angle_rad)
    vertical = bool(abs(cosine) >= abs(sine))
    x_px, y_px = (pixels.col_px, pixels.row_px) if vertical else (pixels.row_px, pixels.col_px)
    if not vertical:
        cosine, sine = sine, cosine
    sign = float(np.sign(cosine))
    angle_rad = float(np.arctan2(sine, abs(cosine)))
    across_px = np.asarray(sign * x_px - line.position_px / np.cos(angle_rad))
    scaled = (pixels.values - line.low) / (line.high - line.low)
    geometry, unit_px = np.array([angle_rad, 0.0]), max(1.0, line.sigma_px)
    if most_bends:
        half_length_px = max(float(np.max(np.abs(y_px))), 1.0)
        basis = splines_for(_HALF_WIDTH, unit_px)
        seen = across_px[told], y_px[told], scaled[told]
        geometry = bend_edge(*seen, geometry, basis, half_length_px, most_bends)
    places_px = geometry, across_px, y_px
    return UprightEdge(pixels, line, vertical, angle_rad, sign, *places_px, scaled, unit_px)


def learn_noise(
    edge: UprightEdge, tilt: bool | None, covariance: Matrix | None = None
) -> tuple[NoiseModel, int]:
    """Return noise and order of uneven light (even, plane, bowl), as told or of the plateaus."""
    sides, places = edge.plateaus(), edge.pixels.places
    step_sigma = edge.rounding.sigma
    # A free ESF first: a ghost or a halo on a plateau is neither noise nor uneven light. It takes
    # what changes across the edge; what changes along it tells uneven light.
    response = edge.free_response
    free, slope = response.of(edge.scaled)
    rest = edge.scaled - free
    place = edge.along_px / edge.half_length_px
    along = np.column_stack([place, place**2 - 1.0 / 3.0])
    moves = along * slope[:, None]  # the first guess of the edge is turned a little, and bent
    both = np.hstack([along, along * free[:, None], moves])
    factors = noise_model.few_factors(both, rest)
    even = rest - both @ factors
    bowl = even + both[:, 1::2] @ factors[1::2]
    if tilt is not None:
        order = int(tilt)
    elif noise_model.plateau_tilt_matters(bowl, places, sides, along[:, 1:], step_sigma):
        order = 2
    else:
        order = int(noise_model.plateau_tilt_matters(rest, places, sides, along[:, :1], step_sigma))
    if covariance is not None:
        return noise_model.noise_of_covariance(covariance, edge.line.high - edge.line.low), order
    scatter = np.sqrt(1.0 - _share_taken(response, sides))
    left = (even if order else rest) / scatter
    noise = noise_model.estimate_noise(left, places, sides)
    terms = both if order else moves
    taken = terms @ noise_model.few_factors(terms, rest)
    if order:  # the free ESF took some of the light, which shows where it is steep
        free = response.of(edge.scaled - taken)[0]
    near = (edge.scaled - taken - free) / scatter
    return noise_model.with_edge(noise, near, free, edge.normal_px, places), order


def _share_taken(response: FreeResponse, sides: list[Mask]) -> float:
    """Return the share of the noise of the plateaus that a free ESF follows, by a random probe."""
    plateaus = sides[0] | sides[1]
    if not plateaus.any():
        return 0.0
    probe = np.random.default_rng(0).choice([-1.0, 1.0], plateaus.size)
    followed = probe * response.of(probe)[0]
    return float(np.clip(np.mean(followed[plateaus]), 0.0, _MOST_TAKEN))


def take_samples(
    edge: UprightEdge, noise: NoiseModel, aperture_px: float, light: int
) -> EdgeSamples:
    """Return the samples of a region, whitened, with so many orders of uneven light."""
    relative, normal_px, rounding = np.ones(edge.scaled.size), edge.normal_px, edge.rounding
    if noise.dark_sigma != noise.bright_sigma or noise.near is not None:
        angle_rad = float(edge.geometry[0])
        response = core_slopes(normal_px, angle_rad, edge.line.sigma_px, aperture_px)[0]
        relative = noise.relative_sigma(response, normal_px)
    # By themselves, and with what they share with pixels of the same value.
    own = np.maximum((noise.dark_sigma * relative) ** 2, rounding.sigma**2)
    share = rounding.shared(np.sqrt(own)) / np.maximum(own, np.finfo(float).tiny)
    rounded = bool(np.max(share) > _SHARED)
    if rounded:
        relative = np.sqrt(own * (1.0 + share) / own.min())
    plain = noise.is_plain and not rounded
    whitener = None if plain else noise.whitener(edge.pixels.places, relative, normal_px)
    unlike = float(np.mean(1.0 / (1.0 + share))) if rounded else 1.0
    places_px = edge.across_px, edge.along_px, edge.half_length_px
    return EdgeSamples(*places_px, light, edge.scaled, whitener, unlike)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeFrames:
    """Frames of one scene."""

    values: NDArray[np.float64]  # [frame row col], NaN where invalid
    offset_px: NDArray[np.float64]  # [frame 2] how far the content moved in each
    pitch_mm: tuple[float, float]  # (row, col)
    scale: int  # pixels per LR pixel

    @property
    def first(self) -> NDArray[np.float64]:
        """The first frame [row col]."""
        return np.asarray(self.values[0])

    def pixels(self, region: Region) -> Pixels:
        """Return the valid pixels of a region from its centre; `ValueError` if they are too few."""
        part = self.values[(slice(None), *region.slices)]
        frame, row, col = np.nonzero(np.isfinite(part))
        if frame.size < _FEWEST_PIXELS:
            raise ValueError(
                f"expected at least {_FEWEST_PIXELS} valid pixels around an edge, got "
                f"{frame.size} in {region}"
            )
        rows, cols = part.shape[1:]
        row_px = row - (rows - 1) / 2.0 - self.offset_px[frame, 0]
        col_px = col - (cols - 1) / 2.0 - self.offset_px[frame, 1]
        places = np.column_stack([frame, row, col])
        return Pixels(places, row_px, col_px, part[frame, row, col])

    def normal_pitch_mm(self, slope_rad: float, vertical: bool) -> float:
        """Return the length of a pixel along the normal of an edge, upright if `vertical`."""
        row_mm, col_mm = self.pitch_mm
        across_mm, along_mm = (col_mm, row_mm) if vertical else (row_mm, col_mm)
        return float(1.0 / np.hypot(np.cos(slope_rad) / across_mm, np.sin(slope_rad) / along_mm))

    def frequency_lpmm(self, wanted: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Return the frequencies of the curve: those wanted, or 0 to 1 cycles per pixel."""
        if wanted is None:
            return np.asarray(np.arange(101) * 0.01 / min(self.pitch_mm))
        rising = wanted.ndim == 1 and wanted.size > 1 and bool(np.all(np.diff(wanted) > 0))
        if not rising or not np.all(np.isfinite(wanted)) or wanted[0] < 0:
            raise ValueError("expected frequency_lpmm [f] rising from 0 or above, and finite")
        return wanted


def take_frames(
    image: ArrayLike,
    pitch_mm: float | tuple[float, float],
    *,
    offset_px: ArrayLike | None,
    valid: ArrayLike | None,
    scale: int,
) -> EdgeFrames:
    """Check the input of a measurement: ValueError for wrong shapes, complex pixels, no pitch."""
    given = np.asarray(image)
    if given.dtype.kind not in "buif" or given.ndim not in (2, 3) or given.size == 0:
        raise ValueError(
            "expected a real image [row col] or frames [frame row col], got "
            f"{given.dtype} of shape {given.shape}"
        )
    values = given.astype(np.float64).reshape((-1, *given.shape[-2:]))
    values[~np.isfinite(values)] = np.nan
    if valid is not None:
        mask = np.asarray(valid, dtype=bool)
        if mask.shape not in (given.shape, given.shape[-2:]):
            raise ValueError(f"expected a mask of shape {given.shape}, got {mask.shape}")
        values[~np.broadcast_to(mask, values.shape)] = np.nan
    offsets = np.zeros((len(values), 2)) if offset_px is None else np.asarray(offset_px, float)
    if offset_px is None and len(values) > 1:
        raise ValueError(f"expected offset_px [frame 2] with {len(values)} frames, got none")
    if offsets.shape != (len(values), 2) or not np.all(np.isfinite(offsets)):
        raise ValueError(
            f"expected finite offset_px of shape {(len(values), 2)}, got {offsets.shape}"
        )
    pair = np.broadcast_to(np.asarray(pitch_mm, dtype=np.float64), (2,))
    if not np.all(np.isfinite(pair) & (pair > 0)):
        raise ValueError(f"expected a positive pitch_mm, got {pitch_mm}")
    if not 1 <= int(scale) <= 64:
        raise ValueError(f"expected a scale from 1 to 64, got {scale}")
    return EdgeFrames(values, offsets, (float(pair[0]), float(pair[1])), int(scale))
