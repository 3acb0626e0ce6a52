"""The maximum-likelihood edge: everything that is read off it, with draws for the intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import sici

from lensshift.evaluation.slanted_edge import posterior, prepare
from lensshift.evaluation.slanted_edge.edge_model import Matrix, Vector
from lensshift.evaluation.slanted_edge.gathering import EdgeSamples, gather, nodes_for
from lensshift.evaluation.slanted_edge.likelihood import EdgeLikelihood
from lensshift.evaluation.slanted_edge.lsf_prior import PLACE
from lensshift.evaluation.slanted_edge.noise_model import NoiseModel
from lensshift.evaluation.slanted_edge.prepare import UprightEdge
from lensshift.evaluation.slanted_edge.result import Profile

DRAWS = 256  # draws of the whole edge
_ESF_HALF_WIDTH = 6.0  # of the printed profiles, in units of the edge's width
_ESF_STEP = 0.1
_MOST_PLACES = 8
_SEEN = 0.05  # of the pixels lie beyond what counts as the ends of the region
_LIGHT_SPREAD = 0.1  # of the contrast: by how much light changes to the ends of a region
_WORSE = 0.5  # of the log posterior
_SETTLED_PX = 3e-3  # a move whose square changes no pixel
_SPARE_PX = 4.0  # by which the edge may move until pixels leave the nodes


_Draws = tuple[Matrix, Matrix, Matrix]  # parameters, levels and coefficients [... k]


@dataclass(frozen=True, slots=True)
class EdgeFit:
    """One edge: column 0 of every table is the optimum, the others are draws."""

    edge: UprightEdge  # the region
    noise: NoiseModel
    geometry: Matrix  # [g k] angle, position, bends
    dark: float  # level of the edge in units of the first guess
    contrast: float  # its height, spline included
    transform: NDArray[np.complex128]  # [f k] of the LSF, 1 at frequency 0
    normal_px: Vector  # [d]
    esf: Matrix  # [d k] from 0 (dark) to 1 (bright)
    lsf: Matrix  # [d k] per pixel
    residual: Vector  # [n] pixels minus model, in units of the contrast
    whole: Profile  # the LSF of the optimum over all of the region


@dataclass(frozen=True, slots=True)
class LikelySettings:
    """Options of the default method; see `measure_edges`."""

    aperture_px: float
    most_bends: int = 4
    tilt: bool | None = None
    noise_covariance: Matrix | None = None
    jpeg_steps: Matrix | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.aperture_px) and 0.0 <= self.aperture_px <= 64.0):
            raise ValueError(f"expected an aperture_px from 0 to 64, got {self.aperture_px}")
        if self.most_bends not in range(9):
            raise ValueError(f"expected whole most_bends from 0 to 8, got {self.most_bends}")
        if self.tilt not in (None, True, False):
            raise ValueError(f"expected tilt True, False or None, got {self.tilt!r}")
        if self.seed != int(self.seed) or self.seed < 0:
            raise ValueError(f"expected a whole seed from 0, got {self.seed}")


def fit_edge(edge: UprightEdge, frequency_cpp: Vector, asked: LikelySettings) -> EdgeFit:
    """Fit an upright edge at frequencies [f], the first 0; what is None, the plateaus tell."""
    noise, light = prepare.learn_noise(edge, asked.tilt, asked.noise_covariance)
    lights = [light]
    if asked.tilt is None and not light and edge.slopes_across():
        lights.append(1)  # or a tail of the response, which the evidence tells
    sigma = max(noise.dark_sigma, edge.rounding.sigma)
    starts = [edge.geometry]
    if edge.geometry.size > 2:  # bends of an edge that is nearly upright may be the pixels
        straight = np.zeros_like(edge.geometry)
        straight[0] = edge.start_angle_rad
        starts.append(straight)
    side_px, seed = asked.aperture_px, asked.seed
    samples = [prepare.take_samples(edge, noise, side_px, one) for one in lights]
    placed = [_placed(edge, s, sigma, side_px, one) for s in samples for one in starts]
    # Minus the log of the flat priors of the levels: each is worth its spread.
    spread = float(np.log(_LIGHT_SPREAD))
    _, likelihood, best = min(placed, key=lambda one: one[0] + spread * one[1].level_count)
    drawn = posterior.drawn_around(likelihood, best, seed)
    draws = parameters, levels, coefficients = _whole_draws(likelihood, drawn, seed)
    ends_px = np.quantile(edge.normal_px, (_SEEN, 1.0 - _SEEN))
    # The optimum follows the tail's law beyond the region, half of the draws only in part.
    shares = np.random.default_rng(seed + 1).uniform(-1.0, 1.0, parameters.shape[1] - 1)
    missing = np.append(0.0, np.maximum(shares, 0.0))
    normal_px, *told = _curves(likelihood, frequency_cpp, ends_px, draws, missing)
    told.append(_moved(likelihood, parameters, levels))
    transform, esf, lsf, geometry = (_widened(one, drawn.widening) for one in told)
    level, coefficient = levels[:, 0], coefficients[:, 0]  # of the optimum
    height = float(level[likelihood.gathered.response] + likelihood.basis.area_px @ coefficient)
    left, dark = edge.scaled - likelihood.model_of(drawn.best, level, coefficient), float(level[0])
    rise = _slope(likelihood, drawn.best, level, coefficient) / height
    whole = Profile(likelihood.gathered.nodes.place_px, rise)
    return EdgeFit(edge, noise, geometry, dark, height, transform, normal_px, esf, lsf, left, whole)


def _placed(
    edge: UprightEdge, samples: EdgeSamples, noise: float, aperture_px: float, geometry: Vector
) -> tuple[float, EdgeLikelihood, Vector]:
    """Return the value, the likelihood about the most likely place of the edge, and its optimum.

    The edge is turned by Gauss-Newton steps: to first order, it moves its pixels by its LSF. A step
    after which the fit is worse, or that goes back, is taken half as far.
    """
    basis, unit_px = edge.basis, edge.unit_px
    farthest_px = float(np.max(np.abs(edge.normal_px))) + _SPARE_PX
    nodes = nodes_for(basis, unit_px, aperture_px, farthest_px)
    log_sigma = float(np.clip(np.log(edge.line.sigma_px / unit_px), -2.0, 1.5))
    parameters = posterior.starting_point(log_sigma, noise)
    slope_px = max(edge.line.sigma_px, 0.3 * aperture_px)
    slope = np.exp(-0.5 * (nodes.place_px / slope_px) ** 2) / (np.sqrt(2.0 * np.pi) * slope_px)
    found: tuple[float, EdgeLikelihood, Vector]
    least, step, step_px = np.inf, np.zeros_like(geometry), np.zeros_like(geometry)
    in_px, directions = np.ones_like(geometry), np.diag(posterior.TYPICAL_STEPS)
    in_px[:2] = samples.half_length_px, 0.0  # the base moves to any order
    for k in range(_MOST_PLACES):
        gathered = gather(samples, nodes, geometry, slope)
        likelihood = EdgeLikelihood(gathered, basis, aperture_px, unit_px)
        best, value, rounder = posterior.descended(likelihood, parameters, directions)
        if value < least + _WORSE:
            levels, coefficients = _known(likelihood, best)
            wanted = _moved(likelihood, best[:, None], levels[:, None])[:, 0]
            found, least, parameters = (value, likelihood, best), value, best
            directions = rounder
            back = best.copy()
            back[PLACE] = 0.0  # the nodes follow the base, next time
            slope = _slope(likelihood, back, levels, coefficients)
            if k == 0:  # the splines follow it once; an uneven shape would draw them on and on
                parameters = back
            else:
                wanted = np.concatenate([wanted[:1], geometry[1:2], wanted[2:]])
            here, last_px, step = geometry, step_px, wanted - geometry
            step_px = step * in_px
            if step_px @ last_px < 0.0:
                step, step_px = 0.5 * step, 0.5 * step_px
        else:
            step, step_px = 0.5 * step, 0.5 * step_px
        if k and np.max(np.abs(step_px)) < _SETTLED_PX:
            break
        geometry = here + step
    return found


def _moved(likelihood: EdgeLikelihood, parameters: Matrix, levels: Matrix) -> Matrix:
    """Return the geometries [g k] that parameters and levels mean."""
    gathered = likelihood.gathered
    turned = levels[gathered.moves]
    place_px = parameters[PLACE] * likelihood.unit_px
    return np.asarray(gathered.geometry[:, None] + np.vstack([turned[:1], place_px, turned[1:]]))


def _known(likelihood: EdgeLikelihood, parameters: Vector) -> tuple[Vector, Vector]:
    """Return the most likely levels (of fixed columns first) and coefficients."""
    found = likelihood.solved(parameters)
    if found is None:
        raise ValueError("expected an edge that a Gaussian or a spline describes; the fit failed")
    return found.levels, likelihood.coefficients(found)


def _slope(
    likelihood: EdgeLikelihood, parameters: Vector, levels: Vector, coefficients: Vector
) -> Vector:
    """Return the LSF at the nodes, times the contrast."""
    nodes, response = likelihood.gathered.nodes, likelihood.gathered.response
    half_px = 0.5 * _ESF_STEP * likelihood.unit_px
    ahead = likelihood.base.response(nodes.place_px + half_px, parameters)
    behind = likelihood.base.response(nodes.place_px - half_px, parameters)
    base = (ahead - behind) / (2.0 * half_px)
    return np.asarray(levels[response] * base + nodes.values @ coefficients)


def _whole_draws(likelihood: EdgeLikelihood, drawn: posterior.Posterior, seed: int) -> _Draws:
    """Return parameters, levels and coefficients: column 0 the optimum, the others draws."""
    rng = np.random.default_rng(seed)
    # Systematic resampling: as many draws from each proposal as its weight says.
    places = (np.arange(DRAWS) + rng.random()) / DRAWS
    chosen = np.searchsorted(np.cumsum(drawn.weights), places)
    chosen = np.minimum(chosen, drawn.weights.size - 1)
    chosen = chosen[[drawn.found[k] is not None for k in chosen]]
    kept, counts = np.unique(chosen, return_counts=True)
    points = [one for k in kept if (one := drawn.found[k]) is not None]
    draws = drawn.draws[chosen].T, *likelihood.drawn(points, counts.tolist(), rng)
    optimum = drawn.best, *_known(likelihood, drawn.best)
    whole = [np.column_stack(both) for both in zip(optimum, draws, strict=True)]
    return whole[0], whole[1], whole[2]


def _widened(table: NDArray[Any], factor: float) -> NDArray[Any]:
    """Return a table [n k] whose draws, all columns but the first, lie farther from their mean."""
    draws = table[:, 1:]
    middle = draws.mean(axis=1, keepdims=True)
    return np.column_stack([table[:, 0], middle + factor * (draws - middle)])


def _beyond(frequency_cpp: Vector, end_px: float) -> Vector:
    """Return the transform of light that falls as 1 / x^2 beyond a distance, 1 at frequency 0.

    integral from 1 of cos(z t) / t^2 dt = cos z + z (Si(z) - pi / 2),   z = 2 pi f end
    """
    turn = 2.0 * np.pi * frequency_cpp * end_px
    return np.asarray(np.cos(turn) + turn * (sici(turn)[0] - 0.5 * np.pi))


def _curves(
    likelihood: EdgeLikelihood, frequency_cpp: Vector, ends_px: Vector, draws: _Draws,
    missing: Vector,
) -> tuple[Vector, NDArray[np.complex128], Matrix, Matrix]:  # fmt: skip
    """Return places [d], OTF [f k], ESF and LSF [d k]; `missing` [k] of far light is none."""
    parameters, levels, coefficients = draws
    base, basis, factor = likelihood.base, likelihood.basis, levels[likelihood.gathered.response]
    reach = round(_ESF_HALF_WIDTH / _ESF_STEP)
    half_steps = np.arange(-2 * reach - 1.0, 2 * reach + 2.0)
    half_steps_px: Vector = np.asarray(half_steps * 0.5 * _ESF_STEP * likelihood.unit_px)
    normal_px = half_steps_px[1::2]
    other = np.any(parameters[:, 1:] != parameters[:, :-1], axis=0)
    number = np.concatenate([[0], np.cumsum(other)])  # of the parameters in each draw
    unlike = parameters[:, np.concatenate([[True], other])]
    places_px = np.concatenate([half_steps_px, ends_px])
    response = np.column_stack([base.response(places_px, one) for one in unlike.T])
    response, ends = response[:-2, number], response[-2:, number]
    far = missing * np.stack([ends[0], 1.0 - ends[1]])
    beyond = np.stack([_beyond(frequency_cpp, abs(end)) for end in ends_px.tolist()])
    even, odd = basis.transforms(frequency_cpp)
    transform = factor * (base.transforms(frequency_cpp, unlike)[:, number] - beyond.T @ far)
    transform += even @ coefficients[: even.shape[1]] + 1j * (odd @ coefficients[even.shape[1] :])
    contrast = transform[0].real
    steps_px = half_steps_px[2::2] - half_steps_px[:-2:2]
    rise = (response[2::2] - response[:-2:2]) / steps_px[:, None]
    esf = (factor * response[1::2] + basis.integrals(normal_px) @ coefficients) / contrast
    lsf = (factor * rise + basis.values(normal_px) @ coefficients) / contrast
    return normal_px, transform / contrast, esf, lsf
