"""Line spread functions with tails, as real lenses have them: intervals that cover."""

import numpy as np
import pytest
from line_spreads import SEEN, UNSEEN, Edge, gauss, halo

from lensshift.evaluation.slanted_edge import EdgeResult, measure_edge

pytestmark = pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")


def measured(
    edge: Edge, seed: int, noise: float = 0.01, shape: tuple[int, int] = (61, 66)
) -> EdgeResult:
    rng = np.random.default_rng(seed)
    image = edge.image(shape, rng.uniform(-0.5, 0.5))
    return measure_edge(1000.0 + 2e4 * (image + noise * rng.standard_normal(shape)), 1.0)


@pytest.mark.parametrize(
    "name", ["diffraction 0.9 c/px", "halo gaussian 6 px", "ghost 7 px", "coma 1.5 px", "defocus"]
)
def test_tails_are_neither_plateau_nor_noise(name: str) -> None:
    inside = []
    for seed in range(2):
        edge = Edge(UNSEEN[name], 4.0 + 5.0 * seed)
        found, true_cpp = measured(edge, seed), edge.mtf50_cpp()
        assert abs(found.mtf50_lpmm.value / true_cpp - 1.0) < 0.02
        inside.append(found.mtf50_lpmm.low <= true_cpp <= found.mtf50_lpmm.high)
        low_cpp = np.array([0.1, 0.3])
        curve = np.abs(edge.transfer(low_cpp))
        band = [np.interp(low_cpp, found.mtf.frequency_lpmm, v) for v in (found.low, found.high)]
        inside += list((band[0] <= curve) & (curve <= band[1]))
        assert found.noise == pytest.approx(0.01, rel=0.15)
    assert np.mean(inside) >= 5 / 6


def test_little_noise_makes_narrow_intervals_that_hold() -> None:
    for name in ("diffraction 1.2 c/px", "halo 5 px"):
        edge = Edge(SEEN[name], 6.0)
        found, true_cpp = measured(edge, 1, noise=0.002), edge.mtf50_cpp()
        half = found.mtf50_lpmm
        assert half.high - half.low < 0.02 * true_cpp
        assert abs(half.value - true_cpp) < half.high - half.low


def test_uneven_light_is_told_from_scattered_light() -> None:
    shape = (61, 66)
    fall = 1.0 + 0.2 * (np.arange(shape[1]) / shape[1] - 0.5) + 0.1 * np.arange(61)[:, None] / 61
    for transfer, light in ((gauss(0.5), fall), (halo(0.1, 5.0), 1.0)):
        edge, rng = Edge(transfer, 7.0), np.random.default_rng(4)
        image = light * (0.2 + edge.image(shape)) + 0.005 * rng.standard_normal(shape)
        found = measure_edge(image, 1.0)
        assert abs(found.mtf50_lpmm.value / edge.mtf50_cpp() - 1.0) < 0.02
