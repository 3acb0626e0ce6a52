"""The likelihood of an edge: its derivatives against differences, its products against matrices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse
from scipy.special import ndtr

from lensshift.evaluation.slanted_edge.design import EdgeDesign
from lensshift.evaluation.slanted_edge.edge_model import (
    SplineBasis,
    edge_response,
    edge_response_slopes,
)
from lensshift.evaluation.slanted_edge.likelihood import IMPOSSIBLE, EdgeLikelihood
from lensshift.evaluation.slanted_edge.samples import EdgeSamples, FarSums, level_columns

Floats = NDArray[np.float64]
BASIS = SplineBasis.covering(3.0, 0.25)


def samples_of(
    *, bends: int = 0, tilted: bool = False, taps: int = 1, noise: float = 0.02, seed: int = 0
) -> EdgeSamples:
    """Return the pixels of a 13 x 17 image of a blurred edge, whitened by `taps` neighbours."""
    rng = np.random.default_rng(seed)
    row, col = (
        axis.ravel() - (size - 1) / 2
        for axis, size in zip(np.mgrid[:13, :17], (13, 17), strict=True)
    )
    normal_px = col * np.cos(0.15) + row * np.sin(0.15) - 0.2
    values = ndtr(normal_px / 0.6) + noise * rng.standard_normal(normal_px.size)
    values += 0.05 * ndtr((normal_px - 0.4) / 0.3) - 0.05 * ndtr((normal_px + 0.4) / 0.3)
    diagonals = [rng.uniform(0.8, 1.2, values.size)]
    diagonals += [rng.uniform(-0.3, 0.3, values.size) for _ in range(1, taps)]
    whitener = sparse.diags_array(diagonals, offsets=list(range(taps)), shape=(values.size,) * 2)
    levels = 6 if tilted else 2
    none = np.zeros(levels)
    tilt_columns = np.column_stack([normal_px / 8.0, row / 6.0]) if tilted else None
    return EdgeSamples(
        across_px=col,
        along_px=row,
        half_length_px=6.0,
        bends=bends,
        tilt_columns=tilt_columns,
        values=whitener @ values,
        whitener=whitener.tocsr(),
        far=FarSums(np.diag(none), none, none, 0.0, 0.0),
        squares=float(np.sum((whitener @ values) ** 2)),
        count=values.size,
    )


@given(
    angle=st.floats(-0.7, 0.7),
    sigma_px=st.floats(0.1, 3.0),
    aperture_px=st.sampled_from([0.0, 0.7, 1.0, 2.0]),
    distance_px=st.floats(-6.0, 6.0),
)
def test_slopes_of_the_response(
    angle: float, sigma_px: float, aperture_px: float, distance_px: float
) -> None:
    slopes = edge_response_slopes(np.array([distance_px]), angle, sigma_px, aperture_px)[:, 0]
    step = 1e-5

    def at(distance: float = 0.0, turn: float = 0.0, stretch: float = 0.0) -> float:
        moved = np.array([distance_px + distance])
        width = sigma_px * np.exp(stretch)
        return float(edge_response(moved, angle + turn, width, aperture_px)[0])

    assert slopes[0] == pytest.approx(at(), abs=1e-12)
    moves = ({"distance": step}, {"turn": step}, {"stretch": step})
    numeric = [(at(**m) - at(**{k: -v for k, v in m.items()})) / (2 * step) for m in moves]
    smallest = abs(np.tan(angle)) > 0.021 or aperture_px == 0.0  # away from the kink of the side
    kept = [0, 1, 2] if smallest else [0, 2]
    assert slopes[1:][kept] == pytest.approx(np.array(numeric)[kept], abs=2e-6)


@pytest.mark.parametrize(("tilted", "taps"), [(False, 1), (False, 3), (True, 1), (True, 5)])
def test_products_are_those_of_the_matrices(tilted: bool, taps: int) -> None:
    samples = samples_of(bends=2, tilted=tilted, taps=taps)
    geometry = np.array([0.2, -0.3, 0.1, -0.05])
    found = EdgeDesign(samples, BASIS, geometry, 0.5, 1.0).products()
    normal_px = samples.normal_px(geometry)
    assert normal_px.min() < BASIS.knot_px[0] < BASIS.knot_px[-1] < normal_px.max()
    response = edge_response(normal_px, 0.2, 0.5, 1.0)
    columns = samples.whitener @ level_columns(response, samples.tilt_columns)
    splines = samples.whitener @ BASIS.integrals(normal_px)
    for name, expected in (
        ("xx", columns.T @ columns),
        ("xy", columns.T @ samples.values),
        ("zz", splines.T @ splines),
        ("zx", splines.T @ columns),
        ("zy", splines.T @ samples.values),
    ):
        assert getattr(found, name) == pytest.approx(expected, abs=1e-5)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 1000),
    bends=st.integers(0, 3),
    tilted=st.booleans(),
    taps=st.sampled_from([1, 2, 4]),
    noise=st.sampled_from([0.003, 0.02, 0.1]),
    aperture_px=st.sampled_from([0.0, 1.0]),
)
def test_gradient_is_the_limit_of_differences(
    seed: int, bends: int, tilted: bool, taps: int, noise: float, aperture_px: float
) -> None:
    samples = samples_of(bends=bends, tilted=tilted, taps=taps, noise=noise, seed=seed)
    likelihood = EdgeLikelihood(samples, BASIS, aperture_px, 1.2)
    rng = np.random.default_rng(seed)
    middle = [0.15, 0.2, *[0.0] * bends, np.log(0.5), np.log(0.05), -0.5, 0.0, 1.0, np.log(noise)]
    spread = np.array([0.02, 0.1, *[0.05] * bends, 0.3, 0.5, 0.2, 0.3, 1.0, 0.3])
    point = middle + spread * rng.uniform(-1.0, 1.0, spread.size)
    value, gradient = likelihood.with_gradient(point)
    assert gradient is not None
    assert value == likelihood.conditional(point)[0]
    numeric = []
    for step in np.diag(1e-4 * spread):
        rise = likelihood.conditional(point + step)[0] - likelihood.conditional(point - step)[0]
        numeric.append(rise / (2.0 * step.sum()))
    scaled = gradient * spread
    assert scaled == pytest.approx(np.array(numeric) * spread, rel=1e-4, abs=1e-3)


def test_value_is_that_of_dense_matrices() -> None:
    """Restricted likelihood from its definition: the density of contrasts that levels leave."""
    samples = samples_of(taps=2)
    likelihood = EdgeLikelihood(samples, BASIS, 1.0, 1.0)
    first = np.array([0.15, 0.2, -0.5, -3.0, -0.5, 0.0, 1.0, np.log(0.02)])
    second = first + np.array([0.01, -0.05, 0.1, 0.4, 0.1, -0.2, 0.5, 0.1])
    got = likelihood.conditional(second)[0] - likelihood.conditional(first)[0]
    assert got == pytest.approx(
        dense_value(samples, second) - dense_value(samples, first), rel=1e-4
    )


def dense_value(samples: EdgeSamples, parameters: Floats) -> float:
    angle, _, log_sigma, log_amplitude, log_length, log_tail, logit, log_noise = parameters
    normal_px = samples.normal_px(parameters[:2])
    columns = level_columns(edge_response(normal_px, angle, np.exp(log_sigma), 1.0), None)
    x, z = samples.whitener @ columns, samples.whitener @ BASIS.integrals(normal_px)
    knots = BASIS.knot_px
    envelope = np.exp(log_amplitude) / (1.0 + (knots / np.exp(log_tail)) ** 2)
    apart = np.subtract.outer(knots, knots), np.add.outer(knots, knots)
    near, mirrored = (np.exp(-0.5 * (lag / np.exp(log_length)) ** 2) for lag in apart)
    prior = np.outer(envelope, envelope) * (near + mirrored / (1.0 + np.exp(-logit)))
    prior += (1e-10 + 1e-8 * np.exp(2 * log_amplitude)) * np.eye(knots.size)
    variance = np.exp(2.0 * log_noise) + 1e-8
    whole = z @ prior @ z.T + variance * np.eye(len(z))
    precision = np.linalg.inv(whole)
    inner = x.T @ precision @ x
    projected = precision - precision @ x @ np.linalg.solve(inner, x.T @ precision)
    value = samples.values @ projected @ samples.values
    value += np.linalg.slogdet(whole)[1] + np.linalg.slogdet(inner)[1]
    means = np.log([0.4, 0.05, 0.6, 1.0, np.exp(2.0), 0.01])
    spreads = np.array([1.0, 1.5, 0.35, 0.6, 2.0, 3.0])
    return float(0.5 * value + 0.5 * np.sum(((parameters[2:] - means) / spreads) ** 2))


@pytest.mark.parametrize(("index", "value"), [(0, 1.0), (2, 9.0), (-1, 2.0), (1, np.nan)])
def test_out_of_bounds_is_impossible(index: int, value: float) -> None:
    likelihood = EdgeLikelihood(samples_of(), BASIS, 1.0, 1.0)
    point = np.array([0.15, 0.2, -0.5, -3.0, -0.5, 0.0, 1.0, -4.0])
    point[index] = value
    assert likelihood.with_gradient(point) == (IMPOSSIBLE, None)
    assert likelihood.conditional(point) == (IMPOSSIBLE, None)
