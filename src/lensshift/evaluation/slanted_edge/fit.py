"""The maximum-likelihood edge: everything that is read off it, with draws for the intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.evaluation.slanted_edge.edge_model import Matrix, SplineBasis, Vector
from lensshift.evaluation.slanted_edge.likelihood import EdgeLikelihood
from lensshift.evaluation.slanted_edge.noise_model import NoiseModel
from lensshift.evaluation.slanted_edge.posterior import (
    Posterior,
    find_posterior,
    starting_point,
)
from lensshift.evaluation.slanted_edge.prepare import UprightEdge, learn_noise, take_samples
from lensshift.evaluation.slanted_edge.samples import distance_px, level_columns

DRAWS = 256  # draws of the whole edge
_ESF_HALF_WIDTH = 6.0  # of the printed profiles, in units of the edge's width
_ESF_STEP = 0.1
_RESIDUAL_STEP_PX = 0.02


@dataclass(frozen=True, slots=True)
class EdgeFit:
    """One edge with draws: the last axis of every `..._draws` counts them.

    Parameters
    ----------
    edge, noise, light : the region, its noise, and the order of its uneven light
    posterior : of the parameters
    parameters, parameter_draws : [p], [p k]
    level, level_draws : [q], [q k] factors of the level columns
    contrast : height of the edge, spline included, in units of the first guess
    frequency_cpp, modulation, modulation_draws : [f], [f], [f k]
    normal_px, esf, esf_draws : [d], [d], [d k] from 0 (dark) to 1 (bright)
    lsf, lsf_draws : [d], [d k] per pixel
    residual : [n] pixels minus model, in units of the contrast
    """

    edge: UprightEdge
    noise: NoiseModel
    light: int
    posterior: Posterior
    parameters: Vector
    parameter_draws: Matrix
    level: Vector
    level_draws: Matrix
    contrast: float
    frequency_cpp: Vector
    modulation: Vector
    modulation_draws: Matrix
    normal_px: Vector
    esf: Vector
    esf_draws: Matrix
    lsf: Vector
    lsf_draws: Matrix
    residual: Vector


def fit_edge(
    edge: UprightEdge,
    frequency_cpp: Vector,
    *,
    aperture_px: float,
    tilt: bool | None,
    seed: int,
    noise_covariance: Matrix | None = None,
) -> EdgeFit:
    """Fit an upright edge.

    Parameters
    ----------
    edge : the region
    frequency_cpp : [f] where the MTF is wanted, the first at 0
    aperture_px : side of the pixel of the base model
    tilt : whether the illumination may be uneven, None to let the plateaus tell
    seed : of the draws
    noise_covariance : of the noise, None to let the plateaus tell
    """
    noise, light = learn_noise(edge, tilt, noise_covariance)
    samples = take_samples(edge, noise, aperture_px, light)
    likelihood = EdgeLikelihood(samples, edge.basis, aperture_px, edge.unit_px)
    log_sigma = float(np.clip(np.log(edge.line.sigma_px / edge.unit_px), -2.0, 1.5))
    start, steps = starting_point(edge.geometry, log_sigma, noise.dark_sigma, edge.half_length_px)
    posterior = find_posterior(likelihood, start, steps, seed)
    parameters, levels, coefficients = _whole_draws(likelihood, posterior, seed)
    curves = _Curves(likelihood, edge.basis, frequency_cpp, edge.unit_px)
    modulation, esf, lsf = curves.of(parameters, levels, coefficients)
    return EdgeFit(
        edge=edge,
        noise=noise,
        light=light,
        posterior=posterior,
        parameters=parameters[:, 0],
        parameter_draws=parameters[:, 1:],
        level=levels[:, 0],
        level_draws=levels[:, 1:],
        contrast=float(levels[1, 0] + edge.basis.area_px @ coefficients[:, 0]),
        frequency_cpp=frequency_cpp,
        modulation=modulation[:, 0],
        modulation_draws=modulation[:, 1:],
        normal_px=curves.normal_px,
        esf=esf[:, 0],
        esf_draws=esf[:, 1:],
        lsf=lsf[:, 0],
        lsf_draws=lsf[:, 1:],
        residual=_residual(
            likelihood, edge, light, (parameters[:, 0], levels[:, 0], coefficients[:, 0])
        ),
    )


def _whole_draws(
    likelihood: EdgeLikelihood, posterior: Posterior, seed: int
) -> tuple[Matrix, Matrix, Matrix]:
    """Return parameters, levels and coefficients: column 0 the optimum, the others draws."""
    rng = np.random.default_rng(seed)
    # Systematic resampling: as many draws from each proposal as its weight says.
    places = (np.arange(DRAWS) + rng.random()) / DRAWS
    chosen = np.minimum(
        np.searchsorted(np.cumsum(posterior.weights), places), posterior.weights.size - 1
    )
    kept, counts = np.unique(chosen, return_counts=True)
    _, best = likelihood.conditional(posterior.best)
    if best is None:
        raise ValueError("expected an edge that a Gaussian or a spline describes; the fit failed")
    parts = [(posterior.best[:, None], best.levels[:, None], best.coefficients[:, None])]
    for index, count in zip(kept, counts, strict=True):
        parameters, conditional = posterior.draws[index], posterior.conditionals[index]
        if conditional is not None:
            drawn = conditional.draw(int(count), rng)
            parts.append((np.tile(parameters[:, None], count), *drawn))
    whole = [np.hstack(columns) for columns in zip(*parts, strict=True)]
    return whole[0], whole[1], whole[2]


class _Curves:
    """Turns draws of the edge into MTF, ESF and LSF."""

    def __init__(
        self,
        likelihood: EdgeLikelihood,
        basis: SplineBasis,
        frequency_cpp: Vector,
        unit_px: float,
    ) -> None:
        self._likelihood, self._frequency_cpp = likelihood, frequency_cpp
        reach = round(_ESF_HALF_WIDTH / _ESF_STEP)
        self.normal_px: Vector = np.asarray(
            np.arange(-reach, reach + 1) * _ESF_STEP * unit_px, dtype=np.float64
        )
        self._transforms = basis.transforms(frequency_cpp)
        self._integrals, self._values = (
            basis.integrals(self.normal_px),
            basis.values(self.normal_px),
        )

    def of(
        self, parameters: Matrix, levels: Matrix, coefficients: Matrix
    ) -> tuple[Matrix, Matrix, Matrix]:
        """Return MTF [f k], ESF [d k] and LSF [d k]."""
        base = np.empty((self._frequency_cpp.size, levels.shape[1]))
        esf = np.empty((self.normal_px.size, levels.shape[1]))
        lsf = np.empty_like(esf)
        last: tuple[Vector, Vector, Vector] | None = None
        for k in range(levels.shape[1]):
            if last is None or not np.array_equal(parameters[:, k], parameters[:, k - 1]):
                last = self._base(parameters[:, k])
            base[:, k], esf[:, k], lsf[:, k] = last
        transform = levels[1] * base + self._transforms @ coefficients
        contrast = transform[0].real
        esf = (levels[1] * esf + self._integrals @ coefficients) / contrast
        lsf = (levels[1] * lsf + self._values @ coefficients) / contrast
        return np.abs(transform / contrast), esf, lsf

    def _base(self, parameters: Vector) -> tuple[Vector, Vector, Vector]:
        likelihood = self._likelihood
        base = likelihood.base_transform(self._frequency_cpp, parameters)
        response = likelihood.base_response(self.normal_px, parameters)
        half_px = 0.5 * _ESF_STEP * likelihood.unit_px
        ahead = likelihood.base_response(self.normal_px + half_px, parameters)
        behind = likelihood.base_response(self.normal_px - half_px, parameters)
        return base, response, (ahead - behind) / (2.0 * half_px)


def _residual(
    likelihood: EdgeLikelihood,
    edge: UprightEdge,
    light: int,
    best: tuple[Vector, Vector, Vector],
) -> Vector:
    """Return all pixels minus the model; the spline is interpolated from a fine grid."""
    parameters, levels, coefficients = best
    normal_px = distance_px(
        edge.across_px, edge.along_px, parameters[: likelihood.geometry_size], edge.half_length_px
    )
    reach_px = edge.basis.reach_px
    grid_px = np.linspace(-reach_px, reach_px, round(2.0 * reach_px / _RESIDUAL_STEP_PX))
    response = likelihood.base_response(normal_px, parameters)
    spline = np.interp(normal_px, grid_px, edge.basis.integrals(grid_px) @ coefficients)
    columns = level_columns(response, edge.light_columns(light))
    return np.asarray(edge.scaled - columns @ levels - spline)
